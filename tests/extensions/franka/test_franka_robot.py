"""Kind `franka` of controllers: clients written from libfranka-common's headers hold an FR3.

pylibfranka 0.21.3 holds it as well.
"""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from conftest import ROOT
from polling import until

from sero_mj import SerialRobot
from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.extensions.franka.client import FrankaClient
from sero_mj.extensions.franka.model import urdf_of
from sero_mj.extensions.franka.motion import Desired
from sero_mj.extensions.franka.receiver import ERRORS, FrankaReceiver
from sero_mj.extensions.franka.robot import FrankaRobot
from sero_mj.simulate.control.robot_model import RobotModel
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

HOME = [0.0, -0.785398, 0.0, -2.35619, 0.0, 1.5708, 0.785398]
CLIENT = ROOT / "tests" / "franka_client.py"
SCENARIO = """
[robots.arm]
model = "fr3"
{more}
[controllers.arm]
kind = "franka"
clock = "lockstep"
port = 0
command = ["{python}", "{client}", "{{port}}", "{mode}", "{version}", "{found}"]
[run]
duration = {duration}
"""


def simulated(
    folder: Path,
    mode: str,
    duration: float = 0.7,
    version: int = 10,
    more: str = "",
    **settings: Any,
) -> tuple[Simulation, dict[str, Any]]:
    """A run, and what its client has seen."""
    file, found = folder / "scenario.toml", folder / "found.json"
    found.unlink(missing_ok=True)
    file.write_text(
        SCENARIO.format(
            python=sys.executable, client=CLIENT, mode=mode, version=version, found=found,
            duration=duration, more=more,
        )
    )  # fmt: skip
    over = {"controllers.arm.version": version}
    over |= {f"controllers.arm.{key}": value for key, value in settings.items()}
    simulation = Simulation(read_scenario(file, over))
    controller = simulation.controlled[0].controller.controller
    assert isinstance(controller, FrankaRobot)
    for _ in simulation.run():
        if simulation.step == simulation.steps:  # before it is closed
            deadline = time.monotonic() + 10.0
            while not found.exists() and mode not in ("dies", "watches"):
                assert time.monotonic() < deadline, controller._link._program.why()
                time.sleep(0.01)
    return simulation, json.loads(found.read_text()) if found.exists() else {}


def signal_of(simulation: Simulation, name: str) -> np.ndarray:
    return simulation.log.signals[f"arm_{name}"]


def states(simulation: Simulation) -> np.ndarray:
    return signal_of(simulation, "franka_state").ravel()


@pytest.mark.parametrize("version", [10, 5, 7])
def test_torque_client_runs_in_lockstep_and_is_reproducible(tmp_path: Path, version: int) -> None:
    simulation, found = simulated(tmp_path, "torques", version=version)
    assert found == {"greeting": [0, version, 0], "status": 0}
    modes = states(simulation)
    assert modes[[1, 499, 500, -1]].tolist() == [2, 2, 1, 1]
    assert signal_of(simulation, "command_success_rate")[2:500].min() == 1.0
    assert not signal_of(simulation, "command_age").any()
    moved = signal_of(simulation, "joint_angles")[-1] - HOME
    np.testing.assert_allclose(moved[[0, 3]], 0.2, atol=0.02)
    assert abs(moved[[1, 2, 4, 5, 6]]).max() < 0.03
    again, _ = simulated(tmp_path, "torques", version=version)
    angles = signal_of(simulation, "joint_angles")
    assert np.array_equal(signal_of(again, "joint_angles"), angles)


def test_motions_begin_where_the_last_one_ended(tmp_path: Path) -> None:
    simulation, found = simulated(tmp_path, "twice", duration=0.6)
    assert found["status"] == [0, 0]
    modes = states(simulation)
    assert modes[[1, 199, 200, 201, 399, 400]].tolist() == [2, 2, 1, 2, 2, 1]
    moved = signal_of(simulation, "joint_angles")[-1] - HOME
    assert abs(moved).max() < 0.12


@pytest.mark.parametrize(("mode", "expected"), [("positions", 0.1), ("velocities", 0.05)])
def test_joint_motions_are_followed_by_the_robot_s_own_control(
    tmp_path: Path, mode: str, expected: float
) -> None:
    simulation, found = simulated(tmp_path, mode)
    assert (found["begun"], found["status"]) == (1, 0)
    moved = signal_of(simulation, "joint_angles")[-1] - HOME
    np.testing.assert_allclose(moved, [expected, *[0.0] * 6], atol=2e-3)
    desired = signal_of(simulation, "target_angles")
    np.testing.assert_allclose(desired[-1] - HOME, [expected, *[0.0] * 6], atol=2e-4)


@pytest.mark.thorough
def test_violations_end_the_motion_by_a_reflex_until_the_client_recovers(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    _, found = simulated(tmp_path, "violations", duration=8.0, patience=0.1)
    reflex, input_error = 8, 10
    errors = {
        "jump": "controller_torque_discontinuity",
        "range": "tau_J_range_violation",
        "nan": "controller_torque_discontinuity",
        "start": "joint_position_motion_generator_start_pose_invalid",
        "fast": "joint_motion_generator_velocity_limits_violation",
        "sudden": "joint_motion_generator_velocity_discontinuity",
        "beyond": "joint_motion_generator_position_limits_violation",
    }
    not_possible = 5
    for name, error in errors.items():
        status = input_error if name == "nan" else reflex
        number = ERRORS.index(error)
        assert found[name] == [status, [number], 4, not_possible, 0, 1, [], 1], name
    told = [record.getMessage() for record in caplog.records if "motion ends" in record.message]
    assert [text.split(", ")[1].split(":")[0] for text in told] == list(errors.values())
    assert told[0].endswith("fr3_joint1: commanded torque changes by 2000 Nm/s; "
                            "expected up to 1000")  # fmt: skip
    assert told[2].endswith("the commanded torque is not finite or too large")


def test_stalled_client_has_an_error_and_may_continue(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    simulation, found = simulated(tmp_path, "stall", patience=0.3)
    lost = ERRORS.index("communication_constraints_violation")
    assert (found["status"], found["errors"]) == (8, [lost])
    assert (found["recovered"], found["again"]) == (0, 0)
    assert "no command within 0.3 s" in caplog.text
    assert {1.0, 2.0} <= set(states(simulation)[1:].tolist())


def test_motion_is_stopped_on_request(tmp_path: Path) -> None:
    simulation, found = simulated(tmp_path, "stop", duration=0.4)
    assert (found["stopped"], found["status"]) == (0, 2)  # preempted
    assert states(simulation)[[99, -1]].tolist() == [2, 1]


def test_invalid_and_unexpected_datagrams_are_ignored(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    simulation, found = simulated(tmp_path, "garbage", duration=0.4)
    assert (found["status"], found["second"]) == (0, [])
    assert "another client of 127.0.0.1:" in caplog.text
    assert "400 datagrams are not commands" in caplog.text
    assert "200 datagrams came from other senders" in caplog.text
    moved = signal_of(simulation, "joint_angles")[-1] - HOME
    assert 0.1 < moved[0] < 0.21


def test_incomplete_messages_and_other_versions_are_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    simulation, found = simulated(tmp_path, "half", duration=0.6)
    assert (found["other"], found["status"]) == ([1, 10, 0], 0)
    for text in (
        "disconnected within a message",
        "sends an invalid request: ff ff",
        "sends Move of 12 bytes; expected 125",
        "expected version = 9",
    ):
        assert text in caplog.text
    assert states(simulation)[2] == 2


def test_run_continues_without_its_client_and_ends_with_a_failed_program(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    simulation, _ = simulated(tmp_path, "dies", duration=0.5)
    assert states(simulation)[[90, 103, -1]].tolist() == [2, 4, 4]
    assert "communication_constraints_violation: the client disconnected" in caplog.text
    speeds = signal_of(simulation, "joint_velocities")
    assert abs(speeds[-1]).max() < 1e-2  # it has braked
    with pytest.raises(SimulationError, match="has ended with exit status 4"):
        simulated(tmp_path, "fails", duration=0.5)


@pytest.mark.parametrize("version", [10, 9, 4])
def test_requests_are_answered(tmp_path: Path, version: int) -> None:
    base = "base_frame = { xyz = [1.0, 2.0, 0.5], rpy_deg = [0, 0, 90] }"
    _, found = simulated(tmp_path, "requests", 0.1, version, base)
    for name in ("SetCollisionBehavior", "SetJointImpedance", "SetCartesianImpedance", "SetEEToK",
                 "SetNEToEE", "SetLoad", "SetGuidingMode", "StopMove"):  # fmt: skip
        assert found[name] == 0, name
    assert found["wrong"] == [2, 2, 2, 2]
    refused, invalid = (5, 7) if version >= 6 else (3, 5)
    assert (found["Cartesian"], found["unknown"]) == (refused, invalid)
    assert found.get("async", refused) == refused
    assert found["nothing"] == 5
    if version == 4:
        assert found["GetCartesianLimit"] == [1, 154]
    if version <= 9:
        assert found["LoadModelLibrary"] == 1
    robot = SerialRobot.from_model("fr3")
    pose = robot.fwd_kin_base_to_flange(np.array(found["q"]))
    pose[:3, 3] += 0.1 * pose[:3, 2]
    np.testing.assert_allclose(np.reshape(found["O_T_EE"], (4, 4)).T, pose, atol=1e-5)
    assert (found["m_load"], found["EE_T_K"][14]) == (0.5, pytest.approx(0.1))
    if version >= 8:
        status, urdf = found["GetRobotModel"]
        assert (status, urdf) == (0, urdf_of(RobotModel.of(robot.model_copy())))


def test_model_of_clients_equals_that_of_the_robot() -> None:
    robot = SerialRobot.from_model("fr3")
    model = RobotModel.of(robot)
    compiled = mujoco.MjModel.from_xml_string(urdf_of(model))
    data = mujoco.MjData(compiled)
    rng = np.random.default_rng(1)
    for _ in range(5):
        q, dq = np.array(HOME) + rng.uniform(-0.4, 0.4, 7), rng.uniform(-1.0, 1.0, 7)
        model.update(q, dq)
        data.qpos[:], data.qvel[:] = q, dq
        mujoco.mj_forward(compiled, data)
        bias = model.gravity() + model.coriolis()
        np.testing.assert_allclose(data.qfrc_bias, bias, atol=1e-9)
        mass = np.zeros((7, 7))
        mujoco.mj_fullM(compiled, data, mass)
        own = model.mass() - np.diag(model.motor_inertia)
        np.testing.assert_allclose(mass, own, atol=1e-9)


def test_forces_are_those_with_which_the_robot_pushes(tmp_path: Path) -> None:
    push = """
base_frame = { xyz = [0.0, 0.0, 0.0], rpy_deg = [0, 0, 90] }
[disturbances.push]
kind = "force"
at = "arm/flange"
force = [0.0, 20.0, 0.0]
begin = 0.0
end = 2.0
"""
    settings = {"clock": "real_time", "stiffness": 2000.0}
    _, found = simulated(tmp_path, "watches", 1.0, 10, push, **settings)
    np.testing.assert_allclose(found["force"], [-20.0, 0, 0, 0, 0, 0], atol=0.3)
    np.testing.assert_allclose(found["turned"][:3], [-14.14, 14.14, 0.0], atol=0.3)
    model = RobotModel.of(SerialRobot.from_model("fr3"))
    model.update(np.array(found["q"]), np.zeros(7))
    expected = -model.jacobian()[0] * 20.0
    np.testing.assert_allclose(found["tau_ext"], expected, atol=0.3)


def test_our_receiver_decodes_the_logged_robot(tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    file = tmp_path / "scenario.toml"
    file.write_text(
        f'[robots.arm]\nmodel = "panda"\n[controllers.arm]\nkind = "franka"\nport = {port}\n'
        "version = 5\nstiffness = 500\nfirst_patience = 1\n"
        '[disturbances.push]\nkind = "force"\nat = "arm/flange"\nforce = [0, 0, -30]\n'
        "begin = 0.05\nend = 1.0\n[run]\nduration = 0.4\n"
    )
    simulation = Simulation(read_scenario(file))
    with FrankaReceiver(port=port, host="127.0.0.1") as source:
        source.start_history()
        for _ in simulation.run():
            pass
        assert until(lambda: source.receive_trigger > 300)
        packets = source.take_history()
    assert packets is not None
    log, values = simulation.log.signals, packets.values
    # Each step's state is sent before its command, and logged as that of the step before.
    row = int(
        np.flatnonzero((log["arm_joint_angles"] == values["joint_angles"][-1]).all(axis=1))[0]
    )
    rows = slice(row - 200, row + 1)
    assert np.ptp(log["arm_torques"][rows], axis=0).max() > 0.1  # it has been pushed
    for event in ("joint_angles", "joint_velocities", "torques"):
        assert np.array_equal(values[event][-201:], log[f"arm_{event}"][rows]), event
    assert (values["robot_mode"] == 1).all()


def test_real_time_commands_arrive_within_a_millisecond_or_are_counted(tmp_path: Path) -> None:
    simulation, found = simulated(tmp_path, "torques", 0.9, clock="real_time")
    rates = signal_of(simulation, "command_success_rate")
    modes = states(simulation)
    assert (modes == 2).sum() > 100
    if found["status"] == 0:  # else this machine was too busy for it, and that is an error
        assert rates[modes == 2].max() > 0.5
    else:
        assert modes[-1] == 4


def test_run_without_a_client_ends_only_in_lockstep(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    def run(clock: str, port: int) -> Simulation:
        file = tmp_path / "scenario.toml"
        file.write_text(
            f'[robots.arm]\nmodel = "fr3"\n[controllers.arm]\nkind = "franka"\nport = {port}\n'
            f'clock = "{clock}"\nfirst_patience = 0.1\n[run]\nduration = 0.1\n'
        )
        simulation = Simulation(read_scenario(file))
        for _ in simulation.run():
            pass
        return simulation

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SimulationError, match=f"cannot listen on 127.0.0.1:{port}: "):
            run("lockstep", port)
    with pytest.raises(SimulationError, match=f"no client connects to 127.0.0.1:{port} within 0"):
        run("lockstep", port)
    simulation = run("real_time", port)
    assert "within 0.1 s; the robot waits" in caplog.text
    assert abs(signal_of(simulation, "joint_angles")[-1] - HOME).max() < 1e-6


@pytest.mark.thorough
def test_ctrl_c_ends_the_run_and_its_program(tmp_path: Path) -> None:
    file = tmp_path / "scenario.toml"
    text = SCENARIO.format(python=sys.executable, client=CLIENT, mode="watches", version=10,
                           found=tmp_path / "found.json", duration=60, more="")  # fmt: skip
    file.write_text(text)
    command = [sys.executable, "-m", "sero_mj", "simulate", str(file)]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 20.0
        while not (tmp_path / "found.json").exists():
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=10.0)
    assert process.returncode not in (None, 0)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"version": 11}, "version"),
        ({"version": 2}, "version"),
        ({"stiffness": 6000.0}, "stiffness"),
        ({"port": 0}, "port"),
        ({"stiffness": [1.0, 2.0]}, "stiffness"),
        ({"clock": "none"}, "clock"),
    ],
)
def test_invalid_declaration_names_its_key(fields: dict[str, Any], message: str) -> None:
    model = RobotModel.of(SerialRobot.from_model("fr3"))
    with pytest.raises(DeclarationError) as caught:
        FrankaClient(**fields).make(model, 1e-3)
    assert caught.value.problems[0].key.endswith(message)


@pytest.mark.parametrize(
    ("robot", "timestep", "message"),
    [
        ("fr3", 2e-3, "cycles last 1 ms"),
        ("fr3", 3e-4, "cycles last 1 ms"),
        ("ur5e", 1e-3, "7 joints"),
    ],
)
def test_unsuitable_robots_and_time_steps_are_rejected(
    robot: str, timestep: float, message: str
) -> None:
    model = RobotModel.of(SerialRobot.from_model(robot))
    with pytest.raises(DeclarationError, match=message):
        FrankaClient().make(model, timestep)


def test_missed_commands_extrapolate_and_braking_ends_at_rest() -> None:
    desired = Desired(RobotModel.of(SerialRobot.from_model("fr3")))
    desired.rest_at(np.zeros(7), np.full(7, 0.1))
    desired.accelerations[:] = 2.0
    desired.extrapolate()
    np.testing.assert_allclose(desired.velocities, 0.102)
    np.testing.assert_allclose(desired.angles, 0.102e-3)
    for _ in range(11):
        desired.brake()
    assert not desired.velocities.any()
    np.testing.assert_allclose(desired.angles, 0.102e-3 + 0.102**2 / 20.0, rtol=0.2)


def test_several_steps_of_the_simulation_may_be_a_cycle(tmp_path: Path) -> None:
    over = {"run.timestep": 5e-4}
    file = tmp_path / "scenario.toml"
    found = tmp_path / "found.json"
    file.write_text(SCENARIO.format(python=sys.executable, client=CLIENT, mode="torques",
                    version=10, found=found, duration=0.6, more=""))  # fmt: skip
    simulation = Simulation(read_scenario(file, over))
    for _ in simulation.run():
        pass
    assert states(simulation)[[998, 999]].tolist() == [2, 1]
