"""Kind `fri` of controllers: clients of FRI 1.0, written from its layout, hold the LWR."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sero_mj import SerialRobot
from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.extensions.fri.client import FriClient
from sero_mj.extensions.fri.lwr_fri import LwrFri
from sero_mj.extensions.fri.receiver import FriLayout
from sero_mj.extensions.fri.robot import FriRobot
from sero_mj.simulate.control.robot_model import RobotModel
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

HOME = [0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0]
SCENARIO = """
[robots.lwr]
model = "lwr"
joint_angles = [0, 0.6, 0, -1.2, 0, 1.2, 0]
[controllers.lwr]
kind = "fri"
port = 0
command = ["{python}", "client.py", "{{port}}", "{mode}"]
[run]
duration = {duration}
"""
# Offsets of tFriMsrData: state 144, joint angles 216, commanded 292, offset 320; of tFriCmdData:
# flags 140, angles 144, frame 172, torques 220, wrench 248, stiffness 272, damping 300.
CLIENT = """
import socket, struct, sys
mode = sys.argv[2]
peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
peer.bind(("127.0.0.1", int(sys.argv[1])))
count, kept = 0, []
def floats(packet, at, n=7):
    return list(struct.unpack_from(f"<{n}f", packet, at))
while True:
    packet, robot = peer.recvfrom(2000)
    counter, _, size, number = struct.unpack_from("<4H", packet)
    assert (len(packet), size, number) == (916, 916, 0x2006)
    state, quality = struct.unpack_from("<2H", packet, 144)
    count += 1
    answer = bytearray(376)
    struct.pack_into("<4H", answer, 0, count & 0xFFFF, counter, 376, 0x1005)
    angles = [a + b for a, b in zip(floats(packet, 292), floats(packet, 320))]
    flags = 0x1
    if mode == "no mirror":
        angles = [0.0] * 7
    if state == 2:
        if mode == "ramp":
            angles[0] += 1e-4
        if mode == "jump":
            angles[2] += 0.1
        if mode == "nan":
            angles[3] = float("nan")
        if mode == "torque":
            flags |= 0x4 | 0x10 | 0x20
            angles = floats(packet, 216)
            struct.pack_into("<7f", answer, 220, 1.0, *[0.0] * 6)
            struct.pack_into("<7f", answer, 272, *[0.0] * 7)
            struct.pack_into("<7f", answer, 300, *[0.7] * 7)
        if mode == "flange":
            flags |= 0x100
            frame = floats(packet, 348, 12)
            frame[11] += 0.05
            struct.pack_into("<12f", answer, 172, *frame)
    struct.pack_into("<I", answer, 140, flags)
    struct.pack_into("<7f", answer, 144, *angles)
    if mode == "ends" and count > 500:
        sys.exit(4)
    if mode == "sleeps" and 400 < count < 470:
        continue
    if mode == "lossy" and count % 10 < 3:
        continue
    if mode == "garbage" and count % 5 == 0:
        peer.sendto(b"?" * 376, robot)
        peer.sendto(b"?", robot)
    peer.sendto(answer, robot)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("fri")
    (found / "client.py").write_text(CLIENT)
    return found


def simulated(folder: Path, mode: str, duration: float = 0.6, **settings: Any) -> Simulation:
    file = folder / "scenario.toml"
    file.write_text(SCENARIO.format(python=sys.executable, mode=mode, duration=duration))
    over = {f"controllers.lwr.{key}": value for key, value in settings.items()}
    simulation = Simulation(read_scenario(file, over))
    for _ in simulation.run():
        pass
    return simulation


def states(simulation: Simulation) -> np.ndarray:
    return simulation.log.signals["lwr_fri_state"].ravel()


def angles(simulation: Simulation) -> np.ndarray:
    return simulation.log.signals["lwr_joint_angles"]


@pytest.mark.parametrize("control", ["position", "joint_impedance"])
def test_client_starts_commanding_and_moves_the_robot(folder: Path, control: str) -> None:
    simulation = simulated(folder, "ramp", control=control)
    found = states(simulation)
    assert found[[1, 199, 202, -1]].tolist() == [1, 1, 2, 2]
    quality = simulation.log.signals["lwr_fri_quality"].ravel()
    assert quality[[1, 60, 85, 199]].tolist() == [0, 1, 2, 3]
    moved = angles(simulation)[-1] - HOME
    assert 0.02 < moved[0] < 0.042  # 0.1 rad/s for 0.4 s, less what it lags behind
    assert abs(moved[1:]).max() < 2e-3
    again = simulated(folder, "ramp", control=control)
    assert np.array_equal(angles(again), angles(simulation))


def test_torques_act_where_the_stiffness_is_taken_away(folder: Path) -> None:
    simulation = simulated(folder, "torque", duration=0.5)
    speeds = simulation.log.signals["lwr_joint_velocities"][[205, 250], 0]
    assert speeds[1] > speeds[0] > 0.0
    commanded = simulation.log.signals["lwr_commanded_torques"][250]
    model = simulation.robot_model(simulation.controlled[0].robot)
    model.update(angles(simulation)[249], np.zeros(7))
    assert (commanded - model.gravity())[0] == pytest.approx(1.0, abs=0.05)


def test_flange_follows_a_commanded_frame(folder: Path) -> None:
    simulation = simulated(folder, "flange", duration=1.0, control="cartesian_impedance")
    model = simulation.robot_model(simulation.controlled[0].robot)
    heights = []
    for row in (angles(simulation)[0], angles(simulation)[-1]):
        model.update(row, np.zeros(7))
        heights.append(model.flange()[2, 3])
    assert heights[1] - heights[0] == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize(
    ("mode", "said"),
    [
        ("jump", "interpolation error: E1 is commanded at 100 rad/s; expected up to 2.23"),
        ("nan", "joint_angles of a command is not finite"),
        ("no mirror", "interpolation error"),
    ],
)
def test_wrong_commands_end_the_command_state(
    folder: Path, mode: str, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    simulation = simulated(folder, mode, duration=0.4)
    assert states(simulation)[-1] == 1
    assert abs(angles(simulation)[-1] - HOME).max() < 2e-3
    assert any(said in record.message for record in caplog.records)
    robot = simulation.controlled[0].controller.controller
    assert isinstance(robot, FriRobot) and robot.error


def test_flags_without_effect_are_reported(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    simulation = simulated(folder, "torque", duration=0.3, control="position")
    assert states(simulation)[-1] == 2
    said = "command flags 0x34 have no effect with control = 'position'"
    assert [record.message for record in caplog.records].count(f"lwr: {said}") == 1


def test_client_that_is_silent_for_a_while_loses_command(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    simulation = simulated(folder, "sleeps", duration=0.8, patience=0.05)
    found = states(simulation)
    assert found[[399, 470, -1]].tolist() == [2, 1, 2]
    assert any("quality unacceptable" in record.message for record in caplog.records)
    assert abs(angles(simulation)[-1] - HOME).max() < 2e-3


def test_lost_answers_cost_quality(folder: Path) -> None:
    simulation = simulated(folder, "lossy", duration=0.3, patience=0.02)
    assert simulation.log.signals["lwr_fri_quality"].max() <= 1  # bad: at most 70 % are answered
    assert states(simulation).max() == 1


def test_invalid_commands_are_counted(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    simulation = simulated(folder, "garbage", duration=0.3)
    assert states(simulation)[-1] == 2
    assert any("packets are not commands" in record.message for record in caplog.records)


def test_end_of_a_client_is_reported(folder: Path) -> None:
    with pytest.raises(SimulationError, match="has ended with exit status 4"):
        simulated(folder, "ends", patience=0.2)


def test_run_without_a_client_ends(folder: Path) -> None:
    (folder / "client.py").write_text(CLIENT)
    with pytest.raises(SimulationError, match=r"no client answers at .* within 0\.2 s"):
        simulated(folder, "lossy", command=["sleep", "10", "{port}"], first_patience=0.2)


def test_measurements_are_accepted_by_our_receiver(folder: Path) -> None:
    simulation = simulated(folder, "ramp", duration=0.3)
    robot = simulation.controlled[0].controller.controller
    assert isinstance(robot, LwrFri)
    values = FriLayout().decode(bytes(robot._measured))
    assert values["joint_angles"] == pytest.approx(angles(simulation)[-2], abs=1e-5)
    model = simulation.robot_model(simulation.controlled[0].robot)
    model.update(values["joint_angles"], np.zeros(7))
    assert values["flange_frame"][0] == pytest.approx(model.flange(), abs=1e-5)
    assert values["jacobian"].reshape(6, 7) == pytest.approx(model.jacobian(), abs=1e-4)
    assert values["mass_matrix"].reshape(7, 7) == pytest.approx(model.mass(), abs=1e-3)
    assert values["gravity_torques"] == pytest.approx(model.gravity(), abs=1e-3)
    assert values["commanded_angles"][0] > 0.005


def test_command_state_holds_in_real_time(folder: Path) -> None:
    simulation = simulated(folder, "ramp", clock="real_time", cycle=0.005)
    assert states(simulation).max() == 2


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"cycle": 0.0005}, "cycle"),
        ({"cycle": 0.0015}, "cycle"),
        ({"cycle": 0.2}, "cycle"),
        ({"control": "torque"}, "control"),
        ({"stiffness": 5000}, "stiffness"),
    ],
)
def test_wrong_declarations_name_their_key(
    folder: Path, settings: dict[str, Any], key: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        simulated(folder, "ramp", **settings)
    assert [problem.key for problem in caught.value.problems] == [f"controllers.lwr.{key}"]


def test_robot_with_six_joints_is_rejected() -> None:
    model = RobotModel.of(SerialRobot.from_model("ur5e"))
    with pytest.raises(DeclarationError, match=r"FRI requires 7 joints, but ur5e has 6$"):
        FriClient().make(model, 1e-3)
