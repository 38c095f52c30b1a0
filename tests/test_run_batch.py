"""Batched runs: each equals the same run alone, whatever differs or fails."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import raises_with, sampled

from sero_mj import SerialRobot
from sero_mj.base.errors import DeclarationError, SimulationError, UsageError
from sero_mj.base.paths import find_scenario
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.surroundings import Object
from sero_mj.simulate.control.compiler import Compiler
from sero_mj.simulate.control.controller import Sensed, Target
from sero_mj.simulate.external_loads import Push, PushRows
from sero_mj.simulate.physics import Physics
from sero_mj.simulate.run_batch import batch_key
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

HOME = [0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0]
SOFT: dict[str, Any] = {"kind": "joint_impedance", "stiffness": 300.0}
STIFF: dict[str, Any] = {"kind": "joint_impedance", "stiffness": 1500.0, "damping": 0.3}
SLOW: dict[str, Any] = {
    **STIFF,
    "torque_limits": [100.0] * 5 + [38.0] * 2,
    "torque_rate_limits": 500.0,
}
NOISE = {"lwr": {"angles": {"noise": 1e-4}, "torques": {"noise": 0.1, "delay": 2}}}
PUSH = {"push": {"kind": "force", "at": "lwr/flange", "force": [0, 30, -40], "begin": 0.05}}
WIGGLE = {
    "push": {
        "kind": "force", "at": "lwr/link4", "force": [30, 0, 0], "torque": [0, 2, 0], "begin": 0.02,
        "end": 0.1, "profile": "half_sine", "expressed_in": "lwr/flange",
    }
}  # fmt: skip
LOAD = {"load": {"kind": "payload", "robot": "lwr", "mass": 4.0, "begin": 0.04, "end": 0.12}}
BIAS = {"f": {"kind": "sensor", "signal": "angles", "bias": 0.02, "begin": 0.05, "end": 0.1}}
LATE = {"f": {"kind": "sensor", "signal": "torques", "delay_ms": 3.0, "begin": 0.03}}
DRY = {
    "f": {
        "kind": "friction", "viscous": 3.0, "added_coulomb": 2.0, "joints": ["A2", "A4"],
        "begin": 0.04, "end": 0.1,
    },
    "g": {"kind": "friction", "coulomb": 0.0, "joints": ["A1", "A2"], "begin": 0.07},
}  # fmt: skip
WEAK = {"f": {"kind": "controller", "gain": 0.5, "joints": ["A2"], "begin": 0.05}}
SWING = {"lwr": {"kind": "sine", "amplitude_deg": 5.0, "frequency": 2.0}}


def scenario(**fields: Any) -> Scenario:
    robot = SerialRobot.from_model("lwr", joint_angles=HOME, **fields.pop("robot", {}))
    controller = fields.pop("controller", SOFT)
    given = {"controllers": {"lwr": controller}, "duration": 0.15, **fields}
    return Scenario(Scene(robots=[robot], floor=False), **given)


def run_alone(one: Scenario, compiler: Compiler, steps: int | None = None) -> Simulation:
    made = Simulation(one, compiler=compiler)
    try:
        made.advance(steps or made.steps)
    except SimulationError as error:
        made.error = error
    return made


def check(scenarios: list[Scenario], steps: int | None = None) -> list[Simulation]:
    """Runs scenarios in a batch and compares each with a run alone."""
    assert len({batch_key(one) for one in scenarios}) == 1
    compiler = Compiler()
    together = Simulation.together(scenarios, compiler)
    runs = [run for run in together if isinstance(run, Simulation)]
    assert len(runs) == len(scenarios)
    runs[0].advance(steps or runs[0].steps)
    for run, one in zip(runs, scenarios, strict=True):
        alone = run_alone(one, compiler, steps)
        assert run.step == alone.step
        assert str(run.error) == str(alone.error)
        assert [*run.log.signals] == [*alone.log.signals]
        for event, values in alone.log.signals.items():
            np.testing.assert_allclose(
                run.log.signals[event], values, rtol=0, atol=1e-8, err_msg=event
            )
        assert run.findings() == alone.findings()
    return runs


@pytest.mark.parametrize(
    "shared",
    [
        {},
        {"elastic": True},
        {"torque_control": True},
        {"elastic": True, "torque_control": True},
        {"drive_delay": 0.002, "timestep": 0.002, "physics_timestep": 0.001},
    ],
    ids=["plain", "elastic", "loop", "elastic loop", "late drives"],
)
def test_differences_between_runs_stay_in_their_run(shared: dict[str, Any]) -> None:
    differing: list[dict[str, Any]] = [
        {},
        {"controller": STIFF, "targets": SWING, "seed": 3},
        {"controller": SLOW, "disturbances": PUSH},
        {"disturbances": LOAD, "faults": LATE},
        {"sensors": NOISE, "faults": BIAS},
        {"sensors": NOISE, "seed": 5, "disturbances": WIGGLE, "faults": WEAK},
        {"sensors": {"lwr": {"velocity_filter": 300.0}}, "observer_gain": 100.0},
        {"targets": SWING, "faults": DRY, "disturbances": PUSH},
    ]
    runs = check([scenario(**shared, **each) for each in differing])
    ends = np.array([run.log.of("lwr", "actual_angles")[-1] for run in runs])
    assert len(np.unique(ends.round(9), axis=0)) >= 5


@pytest.mark.parametrize(
    "controllers",
    [
        [{"kind": "gravity_compensation", "damping": d} for d in (0.0, 5.0)],
        [{"kind": "torque", "torques": t} for t in (0.0, [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0])],
        [{"kind": "joint_position", "stiffness": k} for k in (5000.0, 9000.0)],
        [{**SOFT, "feed_forward": on} for on in (True, False)],
        [{"kind": "cartesian_impedance", "damping": d} for d in (0.3, 0.7)],
        [
            {"kind": "cartesian_impedance", "axes": "flange", "stiffness": [k] * 3 + [50, 60, 70]}
            for k in (500, 1500)
        ],
        [SOFT, {"kind": "cartesian_impedance"}, {"kind": "gravity_compensation"}],
    ],
    ids=["gravity", "torque", "position", "feed-forward", "Cartesian", "in flange", "mixed"],
)
def test_controllers_of_all_kinds_can_be_batched(controllers: list[dict[str, Any]]) -> None:
    check([scenario(controller=each, disturbances=PUSH) for each in controllers])


def test_cartesian_controllers_of_elastic_joints_behind_a_torque_loop() -> None:
    kind = {"kind": "cartesian_impedance"}
    each = [{**kind, "nullspace_stiffness": k, "nullspace_damping": 0.5} for k in (5.0, 20.0)]
    drives: dict[str, Any] = {"elastic": True, "torque_control": True, "targets": SWING}
    check([scenario(controller=one, disturbances=PUSH, **drives) for one in each])


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "steps"),
    sampled(
        [["hit_hand_grasp", 60], ["table_contact", 1300], ["biped_stand", 60], ["justin_push", 30]],
        2,
    ),
)
def test_mounted_robots_and_contacts_can_be_batched(name: str, steps: int) -> None:
    file = find_scenario(name)
    runs = check([read_scenario(file, {"run.seed": seed}) for seed in (1, 2)], steps)
    if name in ("biped_stand", "table_contact"):
        forces = [v for e, v in runs[1].log.signals.items() if e.endswith("contact_force")]
        assert max(np.abs(force).max() for force in forces) > 1.0


def test_batched_pushes_equal_those_of_mujoco_bit_for_bit() -> None:
    rng = np.random.default_rng(0)
    given: list[dict[str, Any]] = [
        {"frame": "lwr/flange"},
        {"frame": "lwr/link4", "at": [0.1, -0.05, 0.2], "torque": [1.0, -2.0, 0.5]},
        {"frame": "lwr/link6", "expressed_in": "lwr/flange"},
        {"frame": "lwr/link2", "at": [0.0, 0.1, 0.0], "expressed_in": "lwr/link3"},
    ]
    world = Compiler().world(scenario().scene)
    rows = Physics(world.physics_model(), 3)
    model, data = rows.model, mujoco.MjData(rows.model)
    rows.qpos[:] = rng.uniform(-1.0, 1.0, rows.qpos.shape)
    force, torques, expected = rng.standard_normal(3), np.zeros((2, 3, model.nv)), None
    torques, expected = torques
    pushes = [
        (row, Push(world, **{"force": force, "torque": np.zeros(3), "expressed_in": "world",
                             "at": np.zeros(3), **each}))
        for row, each in ((2, given[0]), (0, given[1]), (0, given[2]), (2, given[3]))
    ]  # fmt: skip
    PushRows(rows, pushes).write(torques)
    for row, push in pushes:
        data.qpos[:] = rows.qpos[row]
        mujoco.mj_forward(model, data)
        push.apply(model, data, expected[row])
    assert np.array_equal(torques, expected)
    assert (np.abs(torques).max(axis=1) > 0.1).tolist() == [True, False, True]


def test_pushes_and_carried_objects_can_begin_at_different_times() -> None:
    weight = Object(name="weight", shape="sphere", size=[0.05], frame={"xyz": [0.5, 0.0, 0.1]})
    robot = SerialRobot.from_model("lwr", joint_angles=HOME)
    scene = Scene(robots=[robot], objects=[weight], floor=False)

    def carrying(begin: float, **others: Any) -> Scenario:
        load = {**LOAD["load"], "object": "weight", "begin": begin}
        controllers = {"lwr": SOFT}
        return Scenario(
            scene, controllers=controllers, duration=0.15, disturbances={"load": load, **others}
        )

    runs = check([carrying(0.02), carrying(0.06, **PUSH), carrying(0.04, **WIGGLE)])
    frames = np.array([run.log.signals["weight_frame"][-1] for run in runs])
    assert np.ptp(frames[:, :3, 3], axis=0).max() > 1e-3


def test_equal_and_different_target_motions_can_be_batched() -> None:
    fast = {"lwr": {"kind": "sine", "amplitude_deg": 5.0, "frequency": 4.0}}
    check([scenario(targets=SWING), scenario(targets=SWING, controller=STIFF)])
    check([scenario(targets=SWING), scenario(targets=fast), scenario()])


class Broken:
    """Commands values that are not torques from a step on."""

    def __init__(self, torque: float, at: float = 0.05) -> None:
        self.torque, self.at = torque, at

    def torques(self, sensed: Sensed, target: Target, out: np.ndarray) -> None:
        out[:] = 0.0
        if sensed.time >= self.at:
            out[3] = self.torque


def test_failing_run_ends_alone() -> None:
    free: dict[str, Any] = {"runaway_speed": 0.0, "robot": {"torque_limits": None}}
    broken = [Broken(np.nan), Broken(1e30), Broken(1e8, at=0.1)]
    runs = check([scenario(**free), *(scenario(**free, controller=each) for each in broken)])
    assert runs[0].error is None and runs[0].is_done
    assert [run.is_done for run in runs[1:]] == [False, False, False]
    asked, motor, moved = (run.error for run in runs[1:])
    assert (asked.joint, asked.time) == ("lwr/A3", pytest.approx(0.05))
    assert asked.reason == "the controller requested nan Nm; expected a finite number"
    assert motor.reason.startswith("found a motor torque of 1e+30 Nm; expected ")
    assert (motor.joint, motor.problem.found) == ("lwr/A3", 1e30)
    assert moved.problem.reason == "the motion is unstable: found an acceleration of"
    assert abs(moved.problem.found) > 1e10 and moved.problem.of == "rad/s2"
    assert moved.problem.expected == "lower gains, or a timestep below 0.001 s"


def test_runaway_joint_ends_its_run_alone() -> None:
    off = {"f": {"kind": "controller", "gain": -1.0, "joints": ["A2", "A4"], "begin": 0.02}}
    runs = check([scenario(duration=0.6, disturbances=PUSH), scenario(duration=0.6, faults=off)])
    assert runs[0].error is None
    problem = runs[1].error.problem
    assert problem.of == "rad/s, more than 3 times its velocity limit, 1.963 rad/s"
    assert problem.found > 3 * np.deg2rad(112.5)


@pytest.mark.filterwarnings("ignore:overflow")
def test_torques_that_are_not_finite_end_their_run_in_a_joint_evaluation() -> None:
    wrong = {"f": {"kind": "sensor", "signal": "angles", "bias": 1e153, "begin": 0.05}}
    runs = check([scenario(), scenario(faults=wrong), scenario(controller=STIFF)])
    assert [run.error is None for run in runs] == [True, False, True]


def test_invalid_run_is_reported_alone() -> None:
    shaking = {"kind": "joint_position", "stiffness": 1e6}
    scenarios = [scenario(controller=each) for each in (SOFT, shaking, STIFF)]
    first, second, third = Simulation.together(scenarios)
    assert isinstance(second, DeclarationError)
    assert second.problems[0].key == "controllers.lwr.stiffness"
    assert isinstance(first, Simulation) and isinstance(third, Simulation)
    third.advance(third.steps)
    alone = run_alone(scenarios[2], Compiler())
    np.testing.assert_allclose(third.rows, alone.rows, rtol=0, atol=1e-9)
    assert first.is_done


def test_runs_that_cannot_be_batched_have_different_keys() -> None:
    strong = {"f": {"kind": "controller", "gain": 1.5, "begin": 0.05}}
    same: list[dict[str, Any]] = [{}, {"seed": 4}, {"disturbances": PUSH}, {"faults": DRY}]
    others: list[dict[str, Any]] = [{"timestep": 0.002}, {"duration": 0.2}, {"faults": strong}]
    assert len({batch_key(scenario(**fields)) for fields in same}) == 1
    assert len({batch_key(scenario(**fields)) for fields in [{}, *others]}) == 4


def test_batching_does_not_change_a_controller() -> None:
    compiler = Compiler()
    first, second = Simulation.together([scenario(), scenario()], compiler)
    assert isinstance(first, Simulation)
    assert isinstance(second, Simulation)
    stiff = scenario(controller=STIFF).controllers["lwr"]
    with raises_with(
        UsageError,
        reason=(
            "lwr shares its controller with other runs of the batch; run it in its own "
            "Simulation to change the controller"
        ),
    ):
        first.use_controller("lwr", stiff)
    # Alone, the run takes the gains over: the same gains from the start are the same run.
    alone = Simulation(scenario(), compiler=compiler)
    alone.use_controller("lwr", stiff)
    alone.advance(20)
    np.testing.assert_array_equal(
        alone.rows[:21], run_alone(scenario(controller=STIFF), compiler, 20).rows[:21]
    )
