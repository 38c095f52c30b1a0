"""The simulation loop: physics by a second computation, determinism, faults, and errors."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from test_scenarios import HOME, lwr, ran, scenario

from sero_mj.base.errors import SimulationError
from sero_mj.robots.declared.surroundings import Object
from sero_mj.simulate.disturbances import DeadSensor
from sero_mj.simulate.runs.run_log import MEASURED, event_of
from sero_mj.simulate.simulation import Simulation

PUSH = {"kind": "force", "at": "lwr/flange", "force": [5.0, 10.0, -40.0]}


def test_pushed_spring_yields_as_in_statics() -> None:
    push = {"push": PUSH}
    log = ran(scenario(disturbances=push, duration=4.0)).log
    error = (log.of("lwr", "target_angles") - log.of("lwr", "actual_angles"))[-1]
    robot = lwr()
    jacobian = robot.dh.jacobian(log.of("lwr", "actual_angles")[-1], None, robot.flange_frame)
    expected = -jacobian[:3].T @ np.array(PUSH["force"]) / 800.0
    # Friction can hold each joint off by its own torque.
    friction = np.array([0.5, 0.8, 0.4, 0.3, 0.2, 0.1, 0.05]) / 800.0
    assert (np.abs(error - expected) <= friction + 1e-5).all()
    assert np.abs(expected).max() > 10 * friction.max()


def test_external_torques_equal_those_of_the_push() -> None:
    log = ran(scenario(disturbances={"push": PUSH}, duration=3.0)).log
    robot = lwr()
    jacobian = robot.dh.jacobian(log.of("lwr", "actual_angles")[-1], None, robot.flange_frame)
    expected = jacobian[:3].T @ np.array(PUSH["force"])
    assert log.of("lwr", "external_torques")[-1] == pytest.approx(expected, abs=0.05)


def test_payload_causes_the_torques_of_its_weight() -> None:
    load = {"kind": "payload", "robot": "lwr", "mass": 3.0, "center_of_mass": [0.05, 0, 0.1],
            "begin": 0.5}  # fmt: skip
    log = ran(scenario(disturbances={"load": load}, duration=3.0)).log
    robot, angles = lwr(), log.of("lwr", "actual_angles")[-1]
    reach = robot.flange_frame @ np.array(
        [[1, 0, 0, 0.05], [0, 1, 0, 0], [0, 0, 1, 0.1], [0, 0, 0, 1]]
    )
    jacobian = robot.dh.jacobian(angles, None, reach)
    expected = jacobian[:3].T @ np.array([0.0, 0.0, -3.0 * 9.81])
    assert log.of("lwr", "external_torques")[-1] == pytest.approx(expected, abs=0.05)
    assert np.abs(log.of("lwr", "external_torques")[:490]).max() < 0.05


def test_measured_torque_is_commanded_minus_motor_inertia_and_friction() -> None:
    swing = {"lwr": {"kind": "sine", "amplitude_deg": 8.0, "frequency": 0.7}}
    log = ran(scenario(targets=swing, duration=2.0)).log
    speeds = log.of("lwr", "actual_velocities")
    inertia = np.array([3.19, 3.05, 1.98, 2.05, 0.787, 0.391, 0.394])
    viscous = np.array([1.0, 1.2, 0.9, 0.8, 0.5, 0.3, 0.2])
    coulomb = np.array([0.5, 0.8, 0.4, 0.3, 0.2, 0.1, 0.05])
    taken = inertia * np.diff(speeds, axis=0) / 1e-3 + viscous * speeds[1:]
    left = log.torque_error("lwr")[1:] - taken
    assert (np.abs(left) <= coulomb + 1e-6).all()
    moving = np.abs(speeds[1:]) > 0.05
    assert left[moving] == pytest.approx(
        (np.sign(speeds[1:]) * coulomb)[moving], rel=1e-3, abs=1e-3
    )


def test_table_carries_the_force_of_the_flange() -> None:
    table = Object(name="table", shape="box", size=[0.5, 0.5, 0.4],
                   frame={"xyz": [-0.6, 0.0, 0.2 - 0.2]})  # fmt: skip
    robot = lwr(joint_angles=[0.0, 0.8, 0.0, -1.3, 0.0, 1.04, 0.0])
    down = {"kind": "cartesian_way_points", "relative_to": "start", "times": [1.0],
            "poses": [{"xyz": [0.0, 0.0, 0.15]}]}  # fmt: skip
    log = ran(
        scenario(
            robots=[robot], objects=[table], duration=2.5, timestep=0.0005,
            controllers={"lwr": {"kind": "cartesian_impedance"}}, targets={"lwr": down},
        )
    ).log  # fmt: skip
    force = log.signals["lwr_contact_force"].reshape(-1, 3)
    assert np.abs(force[:500]).max() == 0.0
    assert force[-1, 2] > 20.0
    # At rest, the table's reaction force equals the external torques.
    jacobian = robot.dh.jacobian(log.of("lwr", "actual_angles")[-1], None, robot.flange_frame)
    felt = np.linalg.lstsq(jacobian.T, log.of("lwr", "external_torques")[-1], rcond=None)[0]
    assert felt[:3] == pytest.approx(force[-1], abs=1.0)


# ---- determinism


def noisy(**fields: Any) -> Any:
    sensors = {"lwr": {"torques": {"noise": 0.1}, "velocities": {"noise": 1e-3}}}
    return scenario(sensors=sensors, disturbances={"push": PUSH}, duration=0.6, **fields)


@pytest.mark.slow
def test_same_seed_gives_the_same_run_bit_for_bit_in_any_chunks() -> None:
    whole = ran(noisy()).rows
    again = Simulation(noisy())
    while not again.is_done:
        again.advance(again.step + 7)
    assert np.array_equal(whole, again.rows)
    assert not np.array_equal(whole, ran(noisy(), seed=1).rows)
    assert np.array_equal(ran(noisy(), seed=1).rows, ran(noisy(seed=1)).rows)


def test_two_robots_behave_like_each_alone() -> None:
    other = lwr(name="other", base_frame={"xyz": [0.0, 2.0, 0.0]})
    gains = {"kind": "joint_impedance", "stiffness": 800.0}
    both = ran(
        scenario(
            robots=[lwr(), other], controllers={"lwr": gains, "other": gains},
            disturbances={"push": PUSH}, duration=0.5,
        )
    ).log  # fmt: skip
    alone = ran(scenario(disturbances={"push": PUSH}, duration=0.5)).log
    for signal in MEASURED:
        assert both.of("lwr", signal) == pytest.approx(alone.of("lwr", signal), abs=1e-9)
    still = both.of("other", "joint_angles")
    assert still == pytest.approx(np.tile(HOME, (501, 1)), abs=1e-9)


def test_elastic_joints_measure_the_same_push() -> None:
    stiff = ran(scenario(disturbances={"push": PUSH}, duration=2.0)).log
    elastic = ran(scenario(disturbances={"push": PUSH}, duration=2.0, elastic=True)).log
    assert elastic.of("lwr", "torques")[-1] == pytest.approx(
        stiff.of("lwr", "torques")[-1], abs=1.0
    )
    assert not np.array_equal(elastic.of("lwr", "joint_angles"), stiff.of("lwr", "joint_angles"))


# ---- faults


def found(fault: dict[str, Any], **fields: Any) -> list[tuple[str, str]]:
    swing = {"lwr": {"kind": "sine", "amplitude_deg": 10.0, "frequency": 0.25}}
    simulation = ran(
        scenario(
            faults={"it": {"begin": 1.0, **fault}}, targets=swing, duration=2.0,
            monitor={"torque_error": 0.05, "external_torque": 0.05, "position_error": 0.03},
            runaway_speed=0.0, **fields,
        )
    )  # fmt: skip
    assert all(finding.time > 1.0 for finding in simulation.findings())
    return [(finding.joint, finding.kind) for finding in simulation.findings()]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "finding"),
    [
        ({"kind": "sensor", "joints": ["A3"], "bias": 20.0}, ("A3", "torque_error")),
        ({"kind": "sensor", "joints": ["A2"], "gain": 0.5}, ("A2", "torque_error")),
        ({"kind": "dead_sensor", "joints": ["A2"]}, ("A2", "external_torque")),
        ({"kind": "frozen_sensor", "joints": ["A2"]}, ("A2", "frozen_torque")),
        ({"kind": "controller", "joints": ["A3"]}, ("A3", "torque_error")),
        ({"kind": "controller", "joints": ["A2"], "gain": 0.0}, ("A2", "torque_error")),
        ({"kind": "friction", "joints": ["A1"], "added_coulomb": 40.0}, ("A1", "torque_error")),
        (
            {"kind": "encoder_offset", "joints": ["A2"], "offset_deg": 5.0},
            ("A2", "position_error"),
        ),
        (
            {"kind": "sensor", "signal": "angles", "joints": ["A3"], "bias": 0.2},
            ("A3", "position_error"),
        ),
    ],
)
def test_faults_are_detected_at_their_joint(
    fault: dict[str, Any], finding: tuple[str, str]
) -> None:
    assert finding in found(fault)


def test_nothing_is_detected_without_a_fault() -> None:
    assert found({"kind": "sensor", "bias": 0.0}) == []


def test_delayed_angles_make_a_spring_oscillate() -> None:
    late = {"kind": "sensor", "signal": "angles", "delay_ms": 120.0}
    swung = ran(scenario(faults={"late": late}, disturbances={"push": PUSH}, duration=1.0)).log
    calm = ran(scenario(disturbances={"push": PUSH}, duration=1.0)).log
    speeds = [np.abs(log.of("lwr", "actual_velocities")[-200:]).max() for log in (swung, calm)]
    assert speeds[0] > 3 * speeds[1]


# ---- runs that stop


class Wave:
    """A user controller that fails."""

    def torques(self, sensed: Any, target: Any, out: Any) -> None:
        out[:] = 0.0
        if sensed.time > 0.05:
            out[3] = np.nan


class Counts:
    """A user controller that continues from its last torques."""

    def torques(self, sensed: Any, target: Any, out: Any) -> None:
        out += 0.001


def test_user_controller_finds_its_last_torques() -> None:
    simulation = ran(scenario(controllers={"lwr": Counts()}, duration=0.05))
    asked = simulation.log.of("lwr", "commanded_torques")[1:]
    np.testing.assert_allclose(asked, 0.001 * np.arange(1, 51)[:, None] * np.ones(7), rtol=1e-12)


def test_nan_of_a_user_controller_stops_the_run_with_joint_and_time() -> None:
    simulation = Simulation(scenario(controllers={"lwr": Wave()}, duration=1.0))
    seen = []
    with pytest.raises(SimulationError) as caught:
        for rows in simulation.run(chunk=10):
            seen.append(rows)
    assert (caught.value.joint, caught.value.time) == ("lwr/A3", pytest.approx(0.0505, abs=6e-4))
    assert caught.value.reason == "the controller requested nan Nm; expected a finite number"
    assert simulation.step in (50, 51)
    assert seen[-1][1] == simulation.step + 1
    assert np.isfinite(simulation.log.of("lwr", "joint_angles")).all()
    assert len(simulation.log.times) == simulation.step + 1


def runs_away(share: float) -> str:
    return f"rad/s, more than {share:g} times its velocity limit, 1.963 rad/s"


@pytest.mark.parametrize(("share", "elastic"), [(3.0, False), (2.0, False), (3.0, True)])
def test_runaway_joint_ends_the_run_with_joint_and_time(share: float, elastic: bool) -> None:
    wrong_sign = {"kind": "controller", "joints": ["A3"], "begin": 0.2}
    simulation = Simulation(
        scenario(
            faults={"it": wrong_sign}, targets={"lwr": {"kind": "sine", "amplitude_deg": 10.0,
            "frequency": 0.5}}, duration=2.0, elastic=elastic, runaway_speed=share,
        )
    )  # fmt: skip
    with pytest.raises(SimulationError) as caught:
        simulation.advance(simulation.steps)
    assert (caught.value.joint, caught.value.time) == ("lwr/A3", simulation.time)
    speeds = np.abs(simulation.log.of("lwr", "actual_velocities")[:, 3])
    limit = np.deg2rad(112.5)
    if not elastic:  # for elastic joints, the motor
        assert speeds[-1] > share * limit and (speeds[:-1] <= share * limit).all()
    told = caught.value.problem
    assert told.of == runs_away(share)
    assert told.found > share * limit
    assert elastic or told.found == pytest.approx(speeds[-1], rel=1e-9)


def test_runaway_motor_ends_the_run_while_its_link_is_slow() -> None:
    simulation = Simulation(scenario(duration=0.1, elastic=True))
    joints = simulation.plant.joints
    simulation.plant.data.qvel[joints.motor_dofs][6] = -31.0
    simulation.plant.data.qvel[joints.sensor_dofs[6]] = 31.0  # the spring: the link does not move
    with raises_with(
        SimulationError,
        time=0.001,
        joint="lwr/A6",
        found=pytest.approx(31.0, rel=0.1),
        of=runs_away(3.0),
    ):
        simulation.advance(100)
    assert np.abs(simulation.log.of("lwr", "actual_velocities")).max() < 3 * np.deg2rad(112.5)


def test_joints_without_a_limit_run_away_at_three_times_twenty_rad_per_second() -> None:
    def spun(speed: float, **fields: Any) -> Simulation:
        free = lwr(velocity_limits=None)
        simulation = Simulation(scenario(robots=[free], duration=0.01, **fields))
        simulation.plant.data.qvel[simulation.plant.joints.motor_dofs][6] = speed
        return simulation

    spun(58.0).advance(1)
    with raises_with(
        SimulationError,
        time=0.001,
        joint="lwr/A6",
        found=pytest.approx(64.0, rel=0.1),
        of="rad/s, more than 3 times the default velocity limit, 20 rad/s",
    ):
        spun(64.0).advance(1)
    spun(64.0, runaway_speed=0.0).advance(1)


def test_log_describes_its_columns() -> None:
    simulation = ran(scenario(disturbances={"push": PUSH}, duration=0.01))
    layout = simulation.layout
    assert layout.structure.size == 8 * layout.width
    row = simulation.rows[-1]
    decoded = layout.structure.decode(row.tobytes())
    for signal in (*MEASURED, "commanded_torques", "external_torques"):
        event = event_of("lwr", signal)
        assert decoded[event].tolist() == simulation.log.signals[event][-1].tolist()
    assert decoded["push_force"].tolist() == [[5.0, 10.0, -40.0]]
    assert decoded["time"].tolist() == pytest.approx([0.01])


def test_external_torques_of_several_robots_begin_at_zero() -> None:
    other = lwr(name="other", base_frame={"xyz": [0.0, 2.0, 0.0]})
    gains = {"kind": "joint_impedance", "stiffness": 800.0}
    both = ran(
        scenario(robots=[lwr(), other], controllers={"lwr": gains, "other": gains}, duration=0.1)
    ).log
    for robot in ("lwr", "other"):
        assert np.abs(both.of(robot, "external_torques")).max() < 0.05


# ---- objects of the user are not changed


def test_run_with_elastic_joints_leaves_the_robot_of_the_user_rigid() -> None:
    robot = lwr()
    declared = scenario(robots=[robot], elastic=True, duration=0.01)
    simulation = ran(declared)
    assert simulation.robots["lwr"].elastic_joints
    assert not robot.elastic_joints
    assert declared.scene.robots["lwr"] is robot


def test_one_fault_can_be_in_two_scenarios_with_different_robots() -> None:
    fault = DeadSensor(robot="lwr", joints=["A2"])
    before = fault.model_dump()
    other = lwr(name="other", base_frame={"xyz": [0.0, 2.0, 0.0]})
    second = scenario(robots=[other, lwr()], controllers={}, faults={"it": fault}, duration=0.01)
    first = scenario(faults={"it": fault}, duration=0.01)
    assert fault.model_dump() == before and not fault.__pydantic_private__
    for declared in (second, first):
        torques = ran(declared).log.of("lwr", "torques")
        assert not torques[1:, 1].any() and torques[1:, 3].all()
