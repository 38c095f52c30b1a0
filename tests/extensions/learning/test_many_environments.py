"""Batched environments equal environments stepped one by one."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import raises_with
from gymnasium.vector import AutoresetMode

import sero_mj
from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.extensions.learning.environment import Environment
from sero_mj.extensions.learning.gymnasium_vector import GymnasiumVector, make_gymnasium_vector
from sero_mj.extensions.learning.make import RobotSettings
from sero_mj.extensions.learning.many import ManyEnvironments
from sero_mj.extensions.learning.tasks import Reach
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.simulate.control.compiler import Compiler
from sero_mj.simulate.control.robot_models import RobotModels
from sero_mj.simulate.scenario import Run, build_entry

# Noise, delays and quantized encoders of sensors.
SENSORS = {
    "angles": {"noise": 1e-3, "resolution": 1e-4},
    "torques": {"noise": 0.1, "delay": 2},
    "velocity_filter": 100.0,
}
# Into the stops and onto the floor.
DOWN = np.array([0.0, 0.4, 0.0, 0.3, 0.0, 0.0, 0.0], np.float32)


def vector(name: str, mode: str, many: int, **options: Any) -> Any:
    return gymnasium.make_vec(
        f"sero_mj/{name}-v0", num_envs=many, vectorization_mode=mode, **options
    )


def compare(
    name: str, actions: np.ndarray, break_at: int | None = None, threads: int = 2, **options: Any
) -> None:
    """Compares both ways with the same actions, (steps, m, n); one motion is made unstable."""
    many = actions.shape[1]
    together = vector(name, "vector_entry_point", many, threads=threads, **options)
    alone = vector(name, "sync", many, **options)
    both = [together, alone]
    assert isinstance(together, GymnasiumVector) and len(together.many.lanes) == threads
    assert together.observation_space == alone.observation_space
    assert together.action_space == alone.action_space
    found = [each.reset(seed=5) for each in both]
    ends = 0
    for k, action in enumerate(actions):
        if k == break_at:
            together.many.lanes[0].plant.physics.batch.bind("qvel")[1] = 1e12
            alone.envs[1].unwrapped.environment.data.qvel[:] = 1e12
        found += [each.step(action) for each in both]
        (seen, *ours, infos), (expected, *theirs, their_infos) = found[-2:]
        assert seen.keys() == expected.keys()
        for key, values in expected.items():
            np.testing.assert_allclose(seen[key], values, rtol=1e-12, atol=1e-12, err_msg=key)
            assert seen[key].dtype == values.dtype
        np.testing.assert_allclose(ours[0], theirs[0], rtol=0, atol=1e-12)
        np.testing.assert_array_equal(ours[1:], theirs[1:])
        assert infos.keys() == their_infos.keys()
        for key in infos.keys() - {"error"}:
            np.testing.assert_array_equal(infos[key], their_infos[key])
        terminated, truncated = ours[1:]
        assert terminated.tolist() == [k == break_at and i == 1 for i in range(many)]
        ends += int(truncated.sum())
    assert ends
    for each in both:
        each.close()


def random_actions(steps: int, many: int, n: int = 7) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (steps, many, n)).astype(np.float32)


# Neighbors differ in what is computed: disturbances, sensors, couplings.
@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("lwr-reach", {}),
        ("lwr-reach", {"action": "impedance", "target": "pose"}),
        ("lwr-reach", {"sensors": SENSORS}),
        ("lwr-reach", {"action": "impedance", "robot": {"elastic_joints": True}}),
        ("lwr-hold", {"max_force": 80.0, "every": 0.05}),
        ("hit_finger-hold", {"action": "impedance", "every": 0.05}),  # coupled joints
        ("scara-reach", {"action": "impedance"}),  # prismatic; without limits
    ],
)
def test_batch_equals_single_environments_across_episodes(
    name: str, options: dict[str, Any]
) -> None:
    n = SerialRobot.from_model(name.partition("-")[0]).n
    compare(name, random_actions(8, 3, n), time_limit=0.08, **options)


def test_unstable_environment_is_terminated_and_restarted_alone() -> None:
    compare("lwr-reach", random_actions(9, 3), 3, threads=1, time_limit=0.12, action="impedance")


def test_measured_torques_are_equal_for_a_robot_on_the_floor() -> None:
    options: dict[str, Any] = {"time_limit": 1.0, "control_timestep": 0.05}
    compare("lwr-reach", np.tile(DOWN, (21, 4, 1)), **options)
    environment = sero_mj.make_environment("lwr/reach", **options)
    many = ManyEnvironments(environment, 4)
    many.reset(5 + np.arange(4))
    batch = many.lanes[0].plant.physics.batch
    touches = False
    for _ in range(20):
        many.step(176.0 * np.tile(DOWN, (4, 1)))
        touches |= bool((batch.bind("nefc") > batch.bind("nf")).any())
    assert touches  # otherwise the test above would prove nothing


def test_seeds_are_consecutive_declared_or_random() -> None:
    make = {"time_limit": 0.1, "threads": 2}
    envs = vector("lwr-reach", "vector_entry_point", 3, **make)
    first = envs.reset(seed=7)[0]["target_position"]
    np.testing.assert_array_equal(envs.reset(seed=[8, 9, 7])[0]["target_position"][2], first[0])
    assert np.abs(envs.reset()[0]["target_position"] - first).max() > 1e-3
    seeded = vector("lwr-reach", "vector_entry_point", 3, seed=7, **make)
    np.testing.assert_array_equal(seeded.reset()[0]["target_position"], first)
    one, other = (vector("lwr-reach", "vector_entry_point", 3, **make) for _ in range(2))
    assert np.abs(one.reset()[0]["target_position"] - other.reset()[0]["target_position"]).max() > 0
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    with raises_with(key="seed", found=2, expected="one seed, or 3 seeds"):
        envs.reset(seed=[1, 2])


def test_invalid_action_moves_no_environment() -> None:
    envs = vector("lwr-reach", "vector_entry_point", 3, threads=2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros((3, 7)))
    envs.reset(seed=1)
    before = [lane.plant.physics.qpos.copy() for lane in envs.many.lanes]
    actions = np.zeros((3, 7))
    actions[2, 1] = np.nan
    expected = {"found": np.nan, "of": "in environment 2", "expected": "-176 to 176 Nm"}
    reason = "found an action of nan in environment 2; expected -176 to 176 Nm"
    with raises_with(SimulationError, time=0.0, joint="lwr/A2", reason=reason, **expected):
        envs.step(actions)
    with raises_with(key="action", reason="found 2 x 7", expected="3 x 7 numbers, one per joint"):
        envs.step(np.zeros((2, 7)))
    for lane, state in zip(envs.many.lanes, before, strict=True):
        np.testing.assert_array_equal(lane.plant.physics.qpos, state)


ALONE = "Use vectorization_mode='sync' to step these environments one by one."


def test_scenarios_are_stepped_one_by_one() -> None:
    envs = gymnasium.make_vec(
        "sero_mj/impedance_push-v0", num_envs=2, control_timestep=0.2, action="impedance"
    )
    assert isinstance(envs, gymnasium.vector.SyncVectorEnv)
    assert envs.reset(seed=1)[0]["torques"].shape == (2, 7)
    with raises_with(
        key="num_envs", reason="found a scenario", expected=f"a robot with a task. {ALONE}"
    ):
        make_gymnasium_vector(2, "impedance_push")


@pytest.mark.parametrize(
    ("many", "options", "message"),
    [
        (0, {}, "num_envs: found 0"),
        (2, {"threads": 0}, "threads: found 0"),
        (2, {"render_mode": "rgb_array"}, "expected None, or vectorization_mode='sync'"),
        (2, {"tim_limit": 1.0}, "tim_limit: unknown option; did you mean 'time_limit'?"),
    ],
)
def test_invalid_arguments_are_rejected(many: int, options: dict[str, Any], message: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        make_gymnasium_vector(many, "lwr/reach", **options)
    assert message in str(caught.value)


def test_runs_that_need_more_than_steps_are_rejected() -> None:
    settings, task = RobotSettings(time_limit=0.1), Reach()
    scenario = settings.make_scenario(SerialRobot.from_model("lwr"), task)
    scenario.run = scenario.run.model_copy(update={"runaway_speed": 3.0})
    with raises_with(key="num_envs", reason="found run.runaway_speed", expected=f"0. {ALONE}"):
        ManyEnvironments(Environment(scenario, "lwr", task, settings), 2)


@pytest.mark.parametrize(
    ("changes", "sensors"),
    [
        ({"torque_control": True}, {}),
        ({"torque_control": True, "elastic": True}, {}),
        ({"drive_delay": 0.003}, SENSORS),
        ({"physics_timestep": 2.5e-4, "torque_control": True, "drive_delay": 5e-4}, SENSORS),
    ],
)
def test_drives_equal_those_of_single_environments_with_different_starts(
    changes: dict[str, Any], sensors: dict[str, Any]
) -> None:
    play_with_restart(
        RobotSettings(time_limit=0.1, action="impedance", stiffness=200.0, sensors=sensors), changes
    )


def play_with_restart(
    settings: RobotSettings, changes: dict[str, Any], faults: dict[str, Any] | None = None
) -> None:
    """Compares three batched environments with three single ones, while one of them restarts."""
    task, robot = Reach(), SerialRobot.from_model("lwr")
    scenario = settings.make_scenario(robot, task)
    scenario.run = Run.model_validate({**scenario.run.model_dump(), **changes})
    scenario.faults = faults or {}

    def environment() -> Environment:
        return Environment(scenario, "lwr", task, settings, random_start=True)

    many, alone = ManyEnvironments(environment(), 3), [environment() for _ in range(3)]
    found = many.reset(np.arange(3))
    expected = []
    for k, each in enumerate(alone):
        each.seed = k
        expected.append(each.reset().observation)
    for k, actions in enumerate(0.01 * random_actions(9, 3).astype(float)):
        for key, values in found.items():
            ours = np.array([each[key] for each in expected])
            np.testing.assert_allclose(values, ours, rtol=1e-9, atol=1e-9, err_msg=f"{key} {k}")
        if k == 2:  # one of them restarts alone
            many.is_over[1] = alone[1]._is_over = True
        found = many.step(actions)[0]
        steps = [each.step(action) for each, action in zip(alone, actions, strict=True)]
        expected = [step.observation for step in steps]


FAULTS = {
    "frozen": {"kind": "frozen_sensor", "signal": "torques", "begin": 0.03, "end": 0.07},
    "offset": {"kind": "encoder_offset", "offset": 0.01, "joints": ["A2"], "begin": 0.02},
    "loud": {"kind": "sensor", "signal": "velocities", "noise": 0.01, "begin": 0.03, "end": 0.08},
    "late": {"kind": "sensor", "signal": "angles", "delay_ms": 3, "begin": 0.05, "end": 0.09},
    "dry": {"kind": "friction", "added_coulomb": 2.0, "joints": ["A4"], "begin": 0.03, "end": 0.06},
    "worn": {"kind": "friction", "coulomb": 0.0, "joints": ["A2"], "begin": 0.08},
    "weak": {"kind": "controller", "gain": 0.5, "joints": ["A4"], "begin": 0.04, "end": 0.08},
}


@pytest.mark.parametrize("sensors", [{}, SENSORS])
def test_faults_begin_and_end_in_each_episode_separately(sensors: dict[str, Any]) -> None:
    settings = RobotSettings(time_limit=0.12, action="impedance", sensors=sensors)
    play_with_restart(settings, {}, {name: build_entry("faults", FAULTS[name]) for name in FAULTS})


@pytest.mark.parametrize("name", ["lwr", "ur5e"])
def test_batched_gravity_masses_and_dynamics_equal_single_ones(name: str) -> None:
    model = Compiler().robot_model(SerialRobot.from_model(name))
    many, n = RobotModels([model], 5), model.n
    angles, velocities, wanted, accelerations = np.random.default_rng(1).uniform(-2, 2, (4, 5, n))
    torques, less, momentum, slope = np.zeros((4, 5, n))
    many.update(angles, velocities)
    many.write_inverse_dynamics(wanted, accelerations, torques, less)
    many.write_momentum(momentum, slope)
    gravity, masses = many.gravity(), many.mass()
    own, own_less, own_momentum, own_slope = np.zeros((4, n))
    for k in range(5):
        model.update(angles[k], velocities[k])
        np.testing.assert_array_equal(gravity[k], model.gravity())
        np.testing.assert_array_equal(masses[k], model.mass())
        model.write_inverse_dynamics(wanted[k], accelerations[k], own, own_less)
        np.testing.assert_array_equal((torques[k], less[k]), (own, own_less))
        model.write_momentum(own_momentum, own_slope)
        np.testing.assert_array_equal((momentum[k], slope[k]), (own_momentum, own_slope))


def test_display_only_parts_are_not_simulated_and_changes_of_the_plant_are() -> None:
    environment = sero_mj.make_environment("lwr/reach", time_limit=0.1)
    environment.plant.attach_payload("lwr", mass=3.0)
    environment.plant.set_friction("lwr", coulomb=0.5)
    environment.model.opt.gravity[:] = [0.0, 0.0, -1.6]
    model, bare = environment.model, environment.world.physics_model()
    touching = (model.geom_contype | model.geom_conaffinity) > 0
    assert bare.ngeom == touching.sum() < model.ngeom
    for name in ("body_mass", "dof_frictionloss", "dof_armature", "jnt_range", "site_pos"):
        np.testing.assert_array_equal(getattr(bare, name), getattr(model, name))
    np.testing.assert_array_equal(bare.geom_solimp, model.geom_solimp[touching])
    np.testing.assert_array_equal(bare.opt.gravity, [0.0, 0.0, -1.6])
