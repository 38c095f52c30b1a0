"""Environments: dm_env's conformance tests, and rewards and episodes by a second computation."""

from __future__ import annotations

from typing import Any, ClassVar

import dm_env
import numpy as np
import pytest
from absl.testing import absltest
from conftest import raises_with, sampled
from dm_env import test_utils

import sero_mj
from sero_mj.base.errors import DeclarationError, SimulationError, UnknownName
from sero_mj.extensions.learning.environment import Environment
from sero_mj.extensions.learning.make import ScenarioSettings, list_environments
from sero_mj.extensions.learning.tasks import Expectations, closeness
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

SHORT = {"time_limit": 0.2}
# One of each kind of robot and scenario, for the quick tests.
SOME = ("lwr/reach", "puma560/hold", "hand_guiding", "table_contact", "haptic_torque")


class Conformance(test_utils.EnvironmentTestMixin):
    """Runs past the end of an episode."""

    name = "lwr/reach"
    options: ClassVar[dict[str, Any]] = SHORT

    def make_object_under_test(self) -> dm_env.Environment:
        return sero_mj.make_environment(self.name, **self.options)

    def make_action_sequence(self) -> Any:
        rng, spec = np.random.default_rng(3), self.environment.action_spec()
        for _ in range(25):
            yield 0.5 * rng.uniform(spec.minimum, spec.maximum)


class TestReach(Conformance, absltest.TestCase):
    pass


class TestReachPose(Conformance, absltest.TestCase):
    options: ClassVar[dict[str, Any]] = {**SHORT, "target": "pose", "action": "impedance"}


class TestHold(Conformance, absltest.TestCase):
    name = "lwr/hold"


class TestScenario(Conformance, absltest.TestCase):
    name = "impedance_push"
    options: ClassVar[dict[str, Any]] = {
        "overrides": {"run.duration": 4.6},
        "control_timestep": 0.2,
    }


def play(environment: Any, steps: int, scale: float = 0.2, seed: int = 0) -> list[dm_env.TimeStep]:
    """Returns the time steps of a reset and of this number of random actions."""
    rng, spec = np.random.default_rng(seed), environment.action_spec()
    found = [environment.reset()]
    for _ in range(steps):
        found.append(environment.step(scale * rng.uniform(spec.minimum, spec.maximum)))
    return found


def same(a: list[dm_env.TimeStep], b: list[dm_env.TimeStep]) -> bool:
    """Returns whether both are equal bit for bit."""
    return all(
        x.step_type == y.step_type
        and x.reward == y.reward
        and all(
            x.observation[key].tobytes() == y.observation[key].tobytes() for key in x.observation
        )
        for x, y in zip(a, b, strict=True)
    )


def craig(dh: np.ndarray, angles: np.ndarray, base: np.ndarray, flange: np.ndarray) -> np.ndarray:
    """Returns T_world_flange from Craig's rows alpha, a, theta, d, written out again."""
    T = base.copy()
    for (alpha, a, theta, d), q in zip(dh, angles, strict=True):
        ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta + q), np.sin(theta + q)
        T = T @ np.array([[ct, -st, 0, a], [st * ca, ct * ca, -sa, -sa * d],
                          [st * sa, ct * sa, ca, ca * d], [0, 0, 0, 1]])  # fmt: skip
    return np.asarray(T @ flange)


def test_reward_of_reach_is_that_of_the_distance_by_dh() -> None:
    environment = sero_mj.make_environment("lwr/reach", seed=5, action="impedance")
    robot = SerialRobot.from_model("lwr")
    for step in play(environment, 20, scale=1.0)[1:]:
        # The sensors are perfect here, so observations equal the actual values.
        flange = craig(robot.dh_params, step.observation["joint_angles"], robot.base_frame,
                       robot.flange_frame)  # fmt: skip
        distance = np.linalg.norm(flange[:3, 3] - step.observation["target_position"])
        expected = 1.0 / (1.0 + 9.0 * (max(distance - 0.005, 0.0) / 0.3) ** 2)
        assert step.reward == pytest.approx(expected, abs=1e-9)
        np.testing.assert_allclose(step.observation["flange_position"], flange[:3, 3], atol=1e-9)


def test_reward_of_a_pose_includes_its_angle() -> None:
    environment = sero_mj.make_environment("lwr/reach", target="pose", seed=2)
    for step in play(environment, 5)[1:]:
        seen = step.observation
        distance = np.linalg.norm(seen["flange_position"] - seen["target_position"])
        cos = abs(float(seen["flange_quaternion"] @ seen["target_quaternion"]))
        angle = 2.0 * np.arccos(min(cos, 1.0))
        expected = closeness(float(distance), 0.005, 0.3)
        expected *= closeness(angle, np.deg2rad(2.0), np.deg2rad(90.0))
        assert step.reward == pytest.approx(expected, abs=1e-7)
        assert seen["flange_quaternion"][0] >= 0.0


def test_target_can_be_reached_for_a_reward_of_one() -> None:
    environment = sero_mj.make_environment(
        "lwr/reach", seed=1, action="impedance", stiffness=2000.0, time_limit=20.0
    )
    step = environment.reset()
    spec = environment.action_spec()
    goal = environment.task.goal
    while not step.last():
        missing = goal - step.observation["commanded_angles"]
        step = environment.step(np.clip(missing, 0.3 * spec.minimum, 0.3 * spec.maximum))
        if step.reward > 0.999:
            break
    assert step.reward > 0.999


@pytest.mark.parametrize("options", [{}, {"action": "impedance"}])
def test_hold_has_pushes_and_gravity_compensation(options: dict[str, Any]) -> None:
    still = sero_mj.make_environment("lwr/hold", most_force=0.0, **options)
    step = still.reset()
    while not step.last():
        step = still.step(np.zeros(7))
    assert step.reward > 0.999  # nothing moves
    pushed = sero_mj.make_environment("lwr/hold", max_force=60.0, every=0.2, **options)
    step = pushed.reset()
    rewards = []
    while not step.last():
        step = pushed.step(np.zeros(7))
        error = np.abs(step.observation["joint_angles"] - step.observation["hold_angles"]).max()
        assert step.reward == pytest.approx(closeness(float(error), 0.005, 0.3), abs=1e-9)
        rewards.append(step.reward)
    assert min(rewards) < 0.9
    if options:
        assert min(rewards) > 0.1  # springs hold it approximately


@pytest.mark.parametrize("name", ["lwr/reach", "lwr/hold"])
@pytest.mark.parametrize("action", ["torque", "impedance"])
def test_seed_repeats_every_episode_bit_for_bit(name: str, action: str) -> None:
    options = {
        "action": action,
        "time_limit": 0.14,
        "sensors": {"angles": {"noise": 1e-4}, "torques": {"noise": 0.1, "delay": 2}},
    }
    one = sero_mj.make_environment(name, seed=7, **options)
    other = sero_mj.make_environment(name, seed=7, **options)
    first = play(one, 6)
    second = play(one, 6)
    assert same(first, play(other, 6))
    assert not same(first, second)
    # Whatever happened in the previous episode, episode 1 is episode 1.
    fresh = sero_mj.make_environment(name, seed=7, **options)
    fresh.episode = 0
    assert same(second, play(fresh, 6))
    assert not same(first, play(sero_mj.make_environment(name, seed=8, **options), 6))


def test_scenario_repeats_its_episodes_with_rewards_from_its_expectations() -> None:
    options: dict[str, Any] = {"overrides": {"run.duration": 4.6}, "action": "impedance",
                               "stiffness": 800.0}  # fmt: skip
    one = sero_mj.make_environment("impedance_push", **options)
    spec = one.action_spec()
    assert spec.shape == (7,)
    step = one.reset()
    rewards = []
    while not step.last():
        step = one.step(np.zeros(7))
        rewards.append(step.reward)
    held = {outcome.name: outcome.holds for outcome in one.simulation.outcomes()}
    assert held["initial_drift"] and held["peak_torque_share"]
    assert rewards[10] == 1.0 and all(0.0 <= reward <= 1.0 for reward in rewards)
    again = sero_mj.make_environment("impedance_push", **options)
    assert same(play(one, 3), play_after(again, 3))


def play_after(environment: Any, steps: int) -> list[dm_env.TimeStep]:
    """Returns the second episode."""
    play(environment, 5, seed=9)
    return play(environment, steps)


def test_actions_are_bounded_and_clipped_by_the_torque_limits() -> None:
    robot = SerialRobot.from_model("lwr")
    environment = sero_mj.make_environment("lwr/reach", start="home")
    spec = environment.action_spec()
    np.testing.assert_array_equal(spec.maximum, robot.torque_limits)
    np.testing.assert_array_equal(spec.minimum, -robot.torque_limits)
    environment.reset()
    environment.step(10.0 * spec.maximum)
    assert (
        np.abs(environment.simulation.log.of("lwr", "commanded_torques")) <= robot.torque_limits
    ).all()
    impedance = sero_mj.make_environment("lwr/reach", action="impedance")
    np.testing.assert_allclose(impedance.action_spec().maximum, 0.02 * robot.velocity_limits)


def test_observations_are_within_their_bounds_at_full_torque() -> None:
    environment = sero_mj.make_environment("lwr/reach", seed=3, time_limit=1.0)
    specs = environment.observation_spec()
    for step in play(environment, 50, scale=1.0):
        for name, spec in specs.items():
            spec.validate(step.observation[name])
    for step in play(environment, 50, scale=1.0)[1:]:
        assert 0.0 <= step.reward <= 1.0


@pytest.mark.parametrize(("bad", "joint"), [(np.nan, "A3"), (np.inf, "A3")])
def test_action_that_is_not_finite_names_the_joint_and_moves_nothing(
    bad: float, joint: str
) -> None:
    environment = sero_mj.make_environment("lwr/reach")
    environment.reset()
    environment.step(np.zeros(7))
    before = environment.data.qpos.copy()
    action = np.zeros(7)
    action[environment.robot.names.index(joint)] = bad
    expected = {"joint": f"lwr/{joint}", "found": bad, "expected": "-100 to 100 Nm"}
    reason = f"found an action of {bad}; expected -100 to 100 Nm"
    with raises_with(SimulationError, time=pytest.approx(0.02), reason=reason, **expected):
        environment.step(action)
    np.testing.assert_array_equal(environment.data.qpos, before)
    assert environment.step(np.zeros(7)).mid()


def test_action_of_another_shape_is_rejected() -> None:
    environment = sero_mj.make_environment("lwr/reach")
    environment.reset()
    with raises_with(key="action", reason="found 6", expected="7 numbers, one per joint"):
        environment.step(np.zeros(6))
    with raises_with(key="action", reason="found one number", expected="7 numbers, one per joint"):
        environment.step(1.0)
    with raises_with(key="action", found="left", expected="7 numbers"):
        environment.step("left")


def test_unstable_motion_ends_the_episode_with_discount_zero() -> None:
    environment = sero_mj.make_environment("lwr/reach")
    environment.reset()
    before = environment.step(np.zeros(7)).observation
    environment.data.qvel[:] = 1e12
    step = environment.step(np.zeros(7))
    assert step.last() and step.discount == 0.0 and step.reward == 0.0
    for name, spec in environment.observation_spec().items():
        spec.validate(step.observation[name])
        np.testing.assert_array_equal(step.observation[name], before[name])
    assert "unstable" in str(environment.error)
    assert environment.step(np.zeros(7)).first()
    assert environment.error is None
    assert environment.step(np.zeros(7)).mid()


def test_episode_ends_at_its_time_limit_with_discount_one() -> None:
    environment = sero_mj.make_environment("lwr/reach", time_limit=0.1, control_timestep=0.05)
    assert environment.reset().first()
    assert environment.step(np.zeros(7)).mid()
    last = environment.step(np.zeros(7))
    assert last.last() and last.discount == 1.0
    assert environment.data.time == pytest.approx(0.1)
    assert environment.step(np.zeros(7)).first()
    assert environment.data.time == 0.0


def test_targets_are_collision_free_and_within_limits() -> None:
    environment = sero_mj.make_environment("lwr/reach")
    limits = environment.robot.position_limits
    seen = []
    for _ in range(20):
        environment.reset()
        goal = environment.task.goal
        assert (goal > limits[:, 0]).all() and (goal < limits[:, 1]).all()
        seen.append(environment.task.target[:3, 3].copy())
        assert seen[-1][2] > 0.0
    assert np.ptp(seen, axis=0).min() > 0.5  # not always in the same corner


def test_robot_on_the_floor_starts_there(tmp_path: Any) -> None:
    path = tmp_path / "sits.xml"
    path.write_text("""<mujoco><worldbody><body pos="0 0 0.1"><freejoint/>
      <geom type="box" size="0.2 0.2 0.1" mass="10"/>
      <body pos="0 0 0.2"><joint name="arm" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.05" mass="1"/></body>
    </body></worldbody><actuator><motor joint="arm" ctrlrange="-20 20"/></actuator></mujoco>""")
    with sero_mj.make_environment(f"{path}/reach", seed=1, **SHORT) as environment:
        starts = [float(environment.reset().observation["joint_angles"][0]) for _ in range(3)]
        assert len({*starts}) == 3 and environment.error is None


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("lwr/reech", {}, "no task 'reech' of lwr; did you mean 'reach'?"),
        ("lvr/reach", {}, "no robot model 'lvr'; did you mean 'lwr'?"),
        ("impedance_pish", {}, "no environment 'impedance_pish'; did you mean 'impedance_push'?"),
        ("no.toml", {}, "no.toml: no such file"),
        ("lwr/reach", {"tim_limit": 2}, "tim_limit: unknown option; did you mean 'time_limit'?"),
        ("lwr/reach", {"action": "torqe"}, "did you mean 'torque'?"),
        ("lwr/reach", {"control_timestep": 0.0015}, "control_timestep: found 0.0015 s; expected a "
         "whole number of steps of 0.001 s"),
        ("lwr/reach", {"start": [0.0, 1.0]}, "start: found 2 numbers; expected 7, one per joint"),
        ("lwr/reach", {"start": np.full(7, 2.5)}, "start: joint A2 is to be at 2.5"),
        ("lwr/reach", {"action": "impedance", "stiffness": 9999.0}, "stiffness: found 9999; "
         "expected 0 to 5000 Nm/rad"),
        ("lwr/reach", {"sensors": {"angle": {}}}, "did you mean 'angles'?"),
        ("impedance_push", {"robot": "lvr"}, "no robot 'lvr'; did you mean 'lwr'?"),
        ("impedance_push", {"control_timestep": 0.0013}, "expected a whole number of steps"),
        ("impedance_push", {"time_limit": 3.0}, "time_limit: unknown option; available: "),
    ],
)  # fmt: skip
def test_invalid_arguments_are_rejected(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises((DeclarationError, UnknownName)) as caught:
        sero_mj.make_environment(name, **options)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "name", sampled(sorted(list_environments(), key=lambda name: name not in SOME), 5)
)
def test_every_listed_environment_conforms_to_its_specs(name: str) -> None:
    timestep = 0.5 if name.startswith("justin") else 0.1  # 51 joints take longer
    environment = sero_mj.make_environment(name, control_timestep=timestep, action="impedance")
    step = environment.reset()
    specs, still = environment.observation_spec(), 0.0 * environment.action_spec().minimum
    while not step.last():
        step = environment.step(still)
        assert step.observation.keys() == specs.keys()
        for key, spec in specs.items():
            spec.validate(step.observation[key])
        environment.reward_spec().validate(step.reward)
    assert environment.error is None and step.discount == 1.0


def test_environments_are_those_of_robots_and_scenarios() -> None:
    assert {"lwr/reach", "lwr/hold", "impedance_push", "table_contact"} <= set(list_environments())


def test_push_in_a_scenario_is_observed() -> None:
    environment = sero_mj.make_environment("impedance_push", action="impedance", stiffness=800.0)
    step = environment.reset()
    felt = {}
    while not step.last():
        step = environment.step(np.zeros(7))
        felt[round(environment.simulation.time, 2)] = step.observation["external_torques"]
    assert np.abs(felt[0.9]).max() < 0.1  # the push acts from 1 s to 3 s
    assert np.abs(felt[2.9]).max() > 10.0


def test_robot_file_with_estimated_dynamics_is_accepted(tmp_path: Any) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "robot.toml").write_text(
        'dh_convention = "craig"\n'
        "dh_params = [[0, 0, 0, 0.3], [1.5708, 0, 0, 0], [0, 0.4, 0, 0]]\n"
        "torque_limits = [80, 80, 40]\nelastic_joints = true\n"
        "position_limits_deg = [[-170, 170], [10, 120], [-100, 100]]\n"
    )
    environment = sero_mj.make_environment(f"{folder}/reach", action="impedance")
    for step in play(environment, 10):
        assert step.observation["joint_angles"].shape == (3,)
    assert environment.error is None
    (folder / "robot.toml").write_text(
        'dh_convention = "craig"\ndh_params = [[0, 0, 0, 0.3]]\n'
        "[dynamics]\nmotor_inertias = [0.2]\nviscous_friction = [0.1]\ncoulomb_friction = [0.1]\n"
    )
    with raises_with(
        key="robots.mine.torque_limits",
        reason=(
            'is required for torques as actions; expected one per joint, Nm, or action="impedance"'
        ),
    ):
        sero_mj.make_environment(f"{folder}/reach")


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.parametrize("name", ["lwr/reach", "impedance_push"])
def test_images_show_the_robot_and_change_as_it_moves(name: str) -> None:
    environment = sero_mj.make_environment(name)
    environment.reset()
    first = environment.render(60, 80)
    assert first.shape == (60, 80, 3) and first.dtype == np.uint8 and first.std() > 5
    state = environment.data.qpos.copy()
    np.testing.assert_array_equal(environment.data.qpos, state)  # rendering moves nothing
    for _ in range(20):
        environment.step(0.5 * environment.action_spec().maximum)
    second = environment.render(60, 80)
    assert np.abs(first.astype(int) - second).max() > 50
    assert environment.render(48, 64, "90,-20,3").shape == (48, 64, 3)
    environment.reset()
    assert environment.render(60, 80).shape == (60, 80, 3)
    with raises_with(UnknownName, kind="camera", name="front"):
        environment.render(60, 80, "front")
    environment.close()
    environment.close()


LONG = {"run.duration": 4.6}  # as long as its expectations require


@pytest.mark.thorough
@pytest.mark.gl
def test_image_shows_the_current_state() -> None:
    still = sero_mj.make_environment("impedance_push", overrides=LONG)
    zero = np.zeros(7)
    still.reset()
    first = still.render(60, 80)
    for _ in range(75):
        still.step(zero)
    later = still.render(60, 80)  # under the push, which began at 1 s
    assert still.simulation.time == pytest.approx(1.5)
    fresh = sero_mj.make_environment("impedance_push", overrides=LONG)
    fresh.reset()
    for _ in range(75):
        fresh.step(zero)
    np.testing.assert_array_equal(fresh.render(60, 80), later)
    assert np.abs(later.astype(int) - first).max() > 50
    still.close()
    fresh.close()


def test_controllers_of_the_user_scenario_are_unchanged() -> None:
    scenario = read_scenario("impedance_push", LONG)
    before = dict(scenario.controllers)
    environment = Environment(
        scenario, "lwr", Expectations(), ScenarioSettings(control_timestep=0.05)
    )
    play(environment, 2)
    assert scenario.controllers == before
    assert environment.scenario.controllers != before
    simulation = Simulation(scenario)
    simulation.advance(simulation.steps)  # by its own controller, as before
    again = Simulation(read_scenario("impedance_push", LONG))
    again.advance(again.steps)
    np.testing.assert_array_equal(simulation.rows, again.rows)


def test_changes_of_the_plant_persist_over_episodes() -> None:
    environment = sero_mj.make_environment("lwr/hold", max_force=0.0, time_limit=0.1)
    light = play(environment, 4)[-1].observation["torques"]
    environment.episode = -1
    environment.plant.attach_payload("lwr", mass=5.0, center_of_mass=[0, 0, 0.1])
    heavy = play(environment, 4)[-1].observation["torques"]
    assert np.abs(heavy - light).max() > 1.0


def test_start_beyond_the_limits_is_ignored_with_random_starts() -> None:
    limits = np.deg2rad([[-170, 170]] + [[10, 120]] + [[-170, 170]] * 5)
    environment = sero_mj.make_environment("lwr/reach", robot={"position_limits": limits.tolist()})
    angles = environment.reset().observation["joint_angles"]  # declared: upright, joint 2 at 0
    assert angles[1] > limits[1, 0]
