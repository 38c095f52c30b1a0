"""Kind `rtde` of controllers: clients of RTDE, written from its layout, hold a UR5e."""

from __future__ import annotations

import json
import math
import os
import random
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from polling import until
from rtde_server import message
from scipy.spatial.transform import Rotation

from sero_mj import SerialRobot
from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.extensions.rtde.receiver import RtdeReceiver
from sero_mj.extensions.rtde.robot import (
    COMMANDED,
    NOBODY,
    SILENT,
    STARTED,
    RtdeClient,
    RtdeRobot,
)
from sero_mj.extensions.rtde.server import RtdeServer
from sero_mj.extensions.rtde.variables import OUTPUTS
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.control.robot_model import RobotModel
from sero_mj.simulate.external_control.commanded_motion import HOLDS, SERVOS, CommandedMotion
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

HOME = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]
SCENARIO = """
[robots.ur]
model = "ur5e"
joint_angles = [0, -1.57, 1.57, -1.57, -1.57, 0]
[controllers.ur]
kind = "rtde"
port = 0
dashboard_port = 0
script_port = 0
clock = "lockstep"
interface = "position"
command = ["{python}", "client.py", "{{port}}", "{mode}"]
[run]
duration = {duration}
"""
# What a client does that knows nothing but UR's guide.
PEER = """
import json, math, os, socket, struct, sys, time
def message(kind, payload=b""):
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload
class Client:
    def __init__(self, port, host="127.0.0.1"):
        deadline = time.monotonic() + 10
        while True:
            try:
                self.peer = socket.create_connection((host, port), 10)
                break
            except ConnectionRefusedError:  # the run has not begun
                assert time.monotonic() < deadline
                time.sleep(0.01)
        self.peer.settimeout(10)
        self.peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.buffer = b""
    def read(self):
        while len(self.buffer) < 3 or len(self.buffer) < self.buffer[0] << 8 | self.buffer[1]:
            more = self.peer.recv(4096)
            if not more:
                raise EOFError
            self.buffer += more
        size = self.buffer[0] << 8 | self.buffer[1]
        kind, payload = chr(self.buffer[2]), self.buffer[3:size]
        self.buffer = self.buffer[size:]
        return kind, payload
    def ask(self, kind, payload=b""):
        self.peer.sendall(message(kind, payload))
        while True:
            found, answer = self.read()
            if found == kind:
                return answer
    def begin(self, outputs, inputs=(), rate=500.0):
        assert self.ask("V", struct.pack(">H", 2)) == b"\\1"
        self.inputs = [self.ask("I", ",".join(names).encode()) for names in inputs]
        self.types = self.ask("O", struct.pack(">d", rate) + ",".join(outputs).encode())
        codes = {"DOUBLE": "d", "VECTOR6D": "6d", "INT32": "i", "UINT32": "I", "UINT64": "Q"}
        self.form = ">B" + "".join(codes.get(t, "") for t in self.types[1:].decode().split(","))
        return self.ask("S") == b"\\1"
    def package(self):
        kind, payload = self.read()
        while kind == "M":
            kind, payload = self.read()
        assert kind == "U" and payload[0] == 1, (kind, payload)
        return struct.unpack(self.form, payload)[1:]
    def send(self, recipe, form, *numbers):
        self.peer.sendall(message("U", struct.pack(">B" + form, recipe, *numbers)))
"""
CLIENT = (
    PEER
    + """
mode, port = sys.argv[2], int(sys.argv[1])
first = 24 if mode == "registers" else 0
six = [f"input_double_register_{first + k}" for k in range(6)]
client = Client(port)
recipes = [six, ["input_int_register_0", *six]]
outputs = ["timestamp", "actual_q", "actual_TCP_pose", "target_q", "actual_current",
           "actual_current_as_torque", "actual_TCP_force", "target_moment", "actual_qd",
           "robot_mode", "safety_mode", "runtime_state", "output_int_register_0"]
assert client.begin(outputs, recipes, 125.0 if mode == "slow" else 500.0)
rows, home = [], None
def servo(q):
    if mode.startswith("servo"):
        client.send(2, "i6d", 11, *q)
        client.send(2, "i6d", 0, *[0.0] * 6)
    else:
        client.send(1, "6d", *q)
while True:
    try:
        row = client.package()
    except (EOFError, ConnectionError):
        break
    rows.append(row)
    home = home or row[1:7]
    t, q = row[0], list(home)
    count = len(rows)
    if count == 295:
        json.dump(rows, open("rows.part", "w"))
        os.replace("rows.part", "rows.json")
    if mode in ("ramp", "servo", "slow", "registers", "ends", "fails", "reconnect", "again"):
        q[0] += 0.5 * t
    if mode == "torque":
        q = [3.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    if count > 20:
        if mode == "nan":
            q[2] = math.nan
        if mode == "far":
            q[1] = 7.0
        if mode == "jump":
            q[1] += 0.4
        if mode == "size":
            client.send(1, "5d", *q[:5])
        if mode == "recipe":
            client.send(9, "6d", *q)
    if mode == "ends" and count > 50:
        sys.exit(0)
    if mode == "fails" and count > 50:
        sys.exit("no more")
    if mode == "sleeps" and count == 50:
        time.sleep(0.6)
    if mode == "mute" and count > 50 or mode == "reads":
        continue
    if mode == "reconnect" and count == 50:
        client.peer.close()
        client = Client(port)
        assert client.begin(outputs, recipes)
        mode, home = "again", None
        continue
    if mode == "bits" and count == 30:
        other = Client(port)
        assert other.begin(["timestamp", "actual_digital_output_bits", "nonsense", "actual_q"],
                           [six, ["nonsense"], ["standard_digital_output_mask",
                                                "standard_digital_output"]]) is False
        told = [other.types.decode("latin1"), *[a.decode("latin1") for a in other.inputs]]
        other.send(1, "BB", 0x0f, 0x05)
        assert other.begin(["actual_digital_output_bits", "input_double_register_0"])
        servo(q)
        told.append(other.package()[0])
        json.dump(told, open("told.json", "w"))
        other.peer.close()
        continue
    try:
        servo(q)
        if mode == "garbage" and count == 50:
            for junk in (b"GET / HTTP/1.1\\r\\n\\r\\n", b"\\xff\\xff\\x55" + b"x" * 70000,
                         b"\\0\\2V", b"\\0\\5V\\0", message("S"), message("O", b"1234")):
                other = socket.create_connection(("127.0.0.1", port))
                other.sendall(junk)
                keep = other if junk == b"\\0\\5V\\0" else None
    except OSError:
        break
"""
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "client.py").write_text(CLIENT)
    (tmp_path / "peer.py").write_text(PEER)
    return tmp_path


def made(folder: Path, mode: str, duration: float = 0.4, more: str = "", **over: Any) -> Simulation:
    file = folder / "scenario.toml"
    text = SCENARIO.format(python=sys.executable, mode=mode, duration=duration)
    file.write_text(text + more)
    over = {f"controllers.ur.{key}": value for key, value in over.items()}
    return Simulation(read_scenario(file, over))


def simulated(folder: Path, mode: str, *args: Any, **over: Any) -> Simulation:
    simulation = made(folder, mode, *args, **over)
    for _ in simulation.run():
        pass
    return simulation


def robot_of(simulation: Simulation) -> RtdeRobot:
    robot = simulation.controlled[0].controller.controller
    assert isinstance(robot, RtdeRobot)
    return robot


def logged(simulation: Simulation, key: str) -> np.ndarray:
    return simulation.log.signals[f"ur_{key}"]


def rows_of(folder: Path) -> np.ndarray:
    file = folder / "rows.json"
    assert until(file.exists)
    return np.array(json.loads(file.read_text()))


@pytest.mark.parametrize(
    ("mode", "settings"),
    [
        ("ramp", {}),
        ("slow", {}),
        ("registers", {"first_register": 24}),
        ("servo", {"interface": "ur_rtde"}),
    ],
)
def test_client_moves_the_robot_and_reads_its_position(
    folder: Path, mode: str, settings: dict[str, Any]
) -> None:
    simulation = simulated(folder, mode, **settings)
    moved = logged(simulation, "joint_angles")[-1] - HOME
    assert moved[0] == pytest.approx(0.5 * 0.4, abs=0.02)  # less what it lags behind
    assert np.abs(moved[1:]).max() < 1e-3
    assert logged(simulation, "rtde_state").ravel()[[0, 100, -1]].tolist() == [0, 3, 3]
    assert logged(simulation, "command_age").max() < (0.0081 if mode == "slow" else 0.0021)
    robot = robot_of(simulation)
    assert robot.wrong == robot.silent == 0
    again = simulated(folder, mode, **settings)
    np.testing.assert_array_equal(logged(again, "joint_angles"), logged(simulation, "joint_angles"))


def test_client_reads_the_logged_values(folder: Path) -> None:
    more = '[disturbances.push]\nkind = "force"\nat = "ur/flange"\nforce = [0, 0, -20]\n'
    more += "begin = 0.2\nend = 1.0\n"
    simulation = simulated(folder, "ramp", 0.6, more, torque_constants=10.0)
    rows = rows_of(folder)
    assert len(rows) == 295
    np.testing.assert_allclose(rows[:, 0], 0.002 * np.arange(295), atol=1e-9)
    steps = np.round(rows[:, 0] * 1000).astype(int)
    np.testing.assert_array_equal(rows[:, 1:7], logged(simulation, "joint_angles")[steps])
    pose, target, current = rows[:, 7:13], rows[:, 13:19], rows[:, 19:25]
    measured, force = rows[:, 25:31], rows[:, 31:37]
    np.testing.assert_array_equal(measured, logged(simulation, "torques")[steps])
    np.testing.assert_allclose(current * 10.0, measured, atol=1e-12)
    assert np.abs(target[:, 0] - 0.5 * rows[:, 0]).max() < 0.5 * 0.0041
    np.testing.assert_allclose(force[-1], [0, 0, -20, 0, 0, 0], atol=2.0)
    commanded = rows[:, 37:43]
    np.testing.assert_array_equal(commanded[1:], logged(simulation, "commanded_torques")[steps[1:]])
    assert rows[-1, 49:].tolist() == [7, 1, 2, 0]  # running, normal, playing
    # Poses are the flange's in the base, by MuJoCo and scipy.
    world = World(Scene(robots=[SerialRobot.from_model("ur5e")], floor=False))
    data, part = mujoco.MjData(world.model), world.robots["ur5e"]
    data.qpos[part.qpos] = rows[-1, 1:7]
    mujoco.mj_forward(world.model, data)
    np.testing.assert_allclose(pose[-1, :3], data.xpos[part.flange_body], atol=1e-9)
    turned = Rotation.from_rotvec(pose[-1, 3:]).as_matrix()
    np.testing.assert_allclose(turned.ravel(), data.xmat[part.flange_body], atol=1e-9)


def test_torques_come_on_top_of_gravity(folder: Path) -> None:
    simulation = simulated(folder, "torque", 0.2, interface="torque")
    speed = logged(simulation, "joint_velocities")[:, 0]
    assert speed[-1] > speed[100] > 0.05
    commanded = logged(simulation, "commanded_torques")[150]
    model = RobotModel.of(SerialRobot.from_model("ur5e"))
    model.update(logged(simulation, "joint_angles")[149], np.zeros(6))
    np.testing.assert_allclose(commanded - model.gravity(), [3, 0, 0, 0, 0, 0], atol=1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("mode", "said"),
    [
        ("nan", "recipe 1 of client 127.0.0.1:"),
        ("far", "shoulder_lift_joint is commanded to 7 rad; expected -6.283 to 6.283"),
        ("jump", "is commanded at"),
        ("size", "found 40 bytes; expected 48"),
        ("recipe", "a data package of unknown recipe 9"),
        ("garbage", "an RTDE message is invalid: 18245 bytes of type 84"),
    ],
)
def test_invalid_commands_are_counted_reported_once_and_ignored(
    folder: Path, mode: str, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    simulation = made(folder, mode)
    robot = robot_of(simulation)
    wrong = 0
    for _ in simulation.run():
        wrong = max(robot.wrong, wrong)
    found = [record.getMessage() for record in caplog.records if said in record.getMessage()]
    assert len(found) == 1
    counted = [m for m in caplog.messages if "messages or commands were rejected" in m]
    assert len(counted) == 1
    assert int(counted[0].split()[1]) >= (4 if mode == "garbage" else 170)
    assert np.abs(logged(simulation, "joint_angles") - HOME).max() < 1e-3


def test_sleeping_client_is_silent_until_it_answers_again(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    simulation = simulated(folder, "sleeps", patience=0.1)
    states = logged(simulation, "rtde_state").ravel()
    assert set(states) == {NOBODY, COMMANDED, SILENT} or set(states) == {
        NOBODY,
        STARTED,
        COMMANDED,
        SILENT,
    }
    assert states[-1] == COMMANDED
    assert "no client answers the package at 0.098 s" in caplog.text
    assert caplog.text.count("answers again") == 1
    assert np.abs(logged(simulation, "joint_angles") - HOME).max() < 1e-3


@pytest.mark.thorough
def test_torques_of_a_silent_client_end(folder: Path) -> None:
    simulation = simulated(folder, "mute", 0.3, patience=0.05, interface="torque")
    assert logged(simulation, "rtde_state").ravel()[-1] == SILENT
    assert np.abs(logged(simulation, "joint_velocities")[-1]).max() < 1e-3


def test_silent_client_is_reported_in_real_time(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    simulation = simulated(folder, "mute", 0.6, clock="real_time", patience=0.1)
    assert logged(simulation, "rtde_state").ravel()[-1] == SILENT
    assert logged(simulation, "command_age").ravel()[-1] > 0.1
    assert caplog.text.count("the robot holds") == 1
    assert np.abs(logged(simulation, "joint_angles")[-1] - HOME).max() < 5e-3


def test_client_can_reconnect(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    simulation = simulated(folder, "reconnect")
    assert caplog.text.count("the commanding client left at") == 1
    assert logged(simulation, "rtde_state").ravel()[-1] == COMMANDED
    angles = logged(simulation, "joint_angles")[:, 0]
    assert angles[-1] > angles[150] > 0.03


def test_robot_holds_its_position_after_the_program_has_ended(folder: Path) -> None:
    simulation = simulated(folder, "ends", 1.0)
    assert logged(simulation, "rtde_state").ravel()[-1] == NOBODY
    angles = logged(simulation, "joint_angles")[:, 0]
    assert angles[-1] == pytest.approx(angles[400], abs=1e-3)
    assert 0.04 < angles[-1] < 0.09


def test_failing_program_ends_the_run(folder: Path) -> None:
    with pytest.raises(SimulationError, match=r"exit status 1; its last output: no more$"):
        simulated(folder, "fails")


def test_inputs_belong_to_one_client_and_others_can_read(folder: Path) -> None:
    simulation = simulated(folder, "bits")
    told = json.loads((folder / "told.json").read_text())
    assert told[0] == "\0DOUBLE,UINT64,NOT_FOUND,VECTOR6D"
    assert told[1] == "\0" + ",".join(["IN_USE"] * 6)
    assert told[2:] == ["\0NOT_FOUND", "\1UINT8,UINT8", 5]
    assert logged(simulation, "rtde_state").ravel()[-1] == COMMANDED


def test_our_own_receiver_reads_the_simulated_robot(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packets: list[Any] = []
    accept = RtdeReceiver.accept

    def noting(self: RtdeReceiver, raw: list[bytes], *args: Any, **more: Any) -> Any:
        packets.extend(raw)
        return accept(self, raw, *args, **more)

    monkeypatch.setattr(RtdeReceiver, "accept", noting)
    port = free_port()
    simulation = made(folder, "ramp", 1.5, port=port, clock="real_time", command=[])
    client = subprocess.Popen([sys.executable, "client.py", str(port), "ramp"], cwd=folder)
    receiver = RtdeReceiver(host="127.0.0.1", port=port)
    try:
        receiver.open()  # which tries again until it listens
        for _ in simulation.run():
            pass
    finally:
        receiver.close()
        client.kill()
        client.wait()
    assert len(packets) > 200
    values = [receiver.layout.decode(packet) for packet in packets]
    steps_of = np.round([value["timestamp"][0] * 1000 for value in values]).astype(int)
    assert (np.diff(steps_of) == 2).all()
    for event, key in (("joint_angles", "joint_angles"), ("torques", "torques")):
        found = np.array([value[event] for value in values])
        np.testing.assert_array_equal(found, logged(simulation, key)[steps_of])
    assert values[-1]["joint_angles"][0] > HOME[0] + 0.1  # the other client moves it
    assert not values[0]["torques_are_commanded"][0]
    assert values[0]["robot_mode"][0] == 7


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])


@pytest.mark.realtime
def test_ur_rtde_holds_the_simulated_robot(folder: Path) -> None:
    pytest.importorskip("rtde_control", reason="ur_rtde is not installed")
    (folder / "client.py").write_text(
        """
import json, sys, time
import rtde_control, rtde_receive
host = sys.argv[1]
receive = rtde_receive.RTDEReceiveInterface(host)
control = rtde_control.RTDEControlInterface(host)
home = receive.getActualQ()
done, q = 0, list(home)
for k in range(200):
    begin = control.initPeriod()
    q[0] += 1e-3
    done += control.servoJ(q, 0.0, 0.0, 0.002, 0.1, 300)
    control.waitPeriod(begin)
stopped = control.servoStop()
time.sleep(0.2)
reached = receive.getActualQ()[0] - home[0]
moved = control.moveJ(home, 1.0, 1.4)
time.sleep(0.2)
back = max(abs(a - b) for a, b in zip(receive.getActualQ(), home))
refused = control.setPayload(1.0, [0.0, 0.0, 0.0])
json.dump([done, stopped, reached, moved, back, refused], open("rows.json", "w"))
control.disconnect()
receive.disconnect()
"""
    )
    host = "127.0.0.47"  # its ports are fixed
    simulation = simulated(
        folder, "", 3.0, clock="real_time", interface="ur_rtde", host=host, port=30004,
        dashboard_port=29999, script_port=30003,
        command=[sys.executable, "client.py", host],
    )  # fmt: skip
    done, stopped, reached, moved, back, refused = json.loads((folder / "rows.json").read_text())
    assert (done, stopped, moved, refused) == (200, True, True, False)
    assert reached == pytest.approx(0.2, abs=2e-3)
    assert back < 2e-3
    assert logged(simulation, "joint_angles")[:, 0].max() < 0.22


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"cycle": 0.0015}, "cycle"),
        ({"cycle": 0.2}, "cycle"),
        ({"interface": "velocity"}, "interface"),
        ({"interface": "ur_rtde", "first_register": 24}, "first_register"),
        ({"first_register": 43}, "first_register"),
        ({"torque_constants": [1, 1, 1, 0, 1, 1]}, "torque_constants"),
        ({"torque_constants": [1, 1]}, "torque_constants"),
        ({"stiffness": 0}, "stiffness"),
        ({"port": 70000}, "port"),
        ({"command": []}, "port"),
    ],
)
def test_wrong_declarations_name_their_key(
    folder: Path, settings: dict[str, Any], key: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        made(folder, "ramp", **settings)
    assert [problem.key for problem in caught.value.problems] == [f"controllers.ur.{key}"]


def test_robot_with_seven_joints_is_rejected() -> None:
    model = RobotModel.of(SerialRobot.from_model("lwr"))
    with pytest.raises(DeclarationError, match=r"RTDE requires 6 joints, but lwr has 7$"):
        RtdeClient().make(model, 1e-3)


@pytest.mark.thorough
def test_port_in_use_and_missing_client_are_reported(folder: Path) -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        pytest.raises(SimulationError, match=r"127\.0\.0\.1:\d+: Address already in use"),
    ):
        simulated(folder, "ramp", port=taken.getsockname()[1])
    with pytest.raises(SimulationError, match=r"no client answers at 127.0.0.1:\d+ within 0.2 s"):
        simulated(folder, "", port=free_port(), command=[], first_patience=0.2)
    with pytest.raises(SimulationError, match=r"needs clock = 'real_time'$"):
        simulated(folder, "reads", first_patience=4.0)


@pytest.mark.thorough
def test_interrupt_ends_the_run_and_the_program(folder: Path) -> None:
    (folder / "client.py").write_text(
        "import os, pathlib, time\n"
        "pathlib.Path('pid').write_text(str(os.getpid()))\ntime.sleep(60)\n"
    )
    made(folder, "", 60.0)
    command = [sys.executable, "-m", "sero_mj", "simulate", "scenario.toml"]
    process = subprocess.Popen([*command, "--set", "controllers.ur.first_patience=60"], cwd=folder)
    try:
        file = folder / "pid"
        assert until(lambda: file.exists() and file.read_text(), 20.0)
        os.kill(process.pid, signal.SIGINT)
        process.wait(5)
        assert until(lambda: not Path(f"/proc/{file.read_text()}").exists())
    finally:
        process.kill()
        process.wait()


class FakeRobot:
    """What a server needs, and nothing behind it."""

    is_running = True

    def __init__(self) -> None:
        self.wrong = 0
        self.taken: list[dict[str, Any]] = []

    def value(self, name: str) -> Any:
        vectors = {"VECTOR6D": 6, "VECTOR3D": 3, "VECTOR6INT32": 6}
        return [0] * vectors[OUTPUTS[name]] if OUTPUTS[name] in vectors else 0

    def take(self, peer: Any, values: dict[str, Any]) -> bool:
        self.taken.append(values)
        return True

    def reject(self, why: str) -> None:
        self.wrong += 1

    def take_script(self, text: bytes) -> None:
        pass

    def stop_program(self) -> None:
        pass


def received(client: socket.socket, count: int) -> bytes:
    """What has come, of which nothing is taken."""
    try:
        return client.recv(count + 1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
    except BlockingIOError:
        return b""


@pytest.mark.thorough
def test_random_bytes_do_not_harm_the_server() -> None:
    chosen = random.Random(4)
    good = [
        message("V", b"\0\2"),
        message("v"),
        message("O", struct.pack(">d", 500.0) + ",".join(OUTPUTS).encode()[:3000]),
        message("O", struct.pack(">d", 125.0) + b"timestamp,actual_q,"),
        message("I", b"input_int_register_0,input_double_register_0"),
        message("S"),
        message("U", struct.pack(">Bid", 1, 3, 0.5)),
        message("U", struct.pack(">Bid", 1, 3, math.nan)),
        message("M", b"\5hello\3you\2"),
        message("P"),
    ]
    robot = FakeRobot()
    server = RtdeServer(robot, 0.002, "ur")
    server.open("127.0.0.1", 0)
    try:
        for turn in range(300):
            sent = bytearray(b"".join(good if turn % 2 else chosen.choices(good, k=8)))
            for _ in range(chosen.randrange(4)):
                sent[chosen.randrange(len(sent))] = chosen.randrange(256)
            with socket.create_connection(("127.0.0.1", server.port)) as client:
                client.sendall(sent[: chosen.randrange(1, len(sent))])
                for cycle in range(4):
                    server.serve(0.01)
                    server.send(cycle)
            assert until(lambda: not (server.serve() or server.peers))
        assert robot.taken
        assert robot.wrong > 30
        with socket.create_connection(("127.0.0.1", server.port)) as client:
            client.sendall(b"".join(good[:2]))
            answer = message("V", b"\1") + message("v", struct.pack(">4I", 5, 23, 0, 0))
            assert until(lambda: server.serve(0.1) and received(client, len(answer)) == answer)
    finally:
        server.close()


def test_client_that_reads_nothing_gets_fewer_packages_without_harm() -> None:
    server = RtdeServer(FakeRobot(), 0.002, "ur")
    server.open("127.0.0.1", 0)
    names = ",".join(name for name, kind in OUTPUTS.items() if kind == "VECTOR6D").encode()
    try:
        with socket.create_connection(("127.0.0.1", server.port)) as client:
            outputs = message("O", struct.pack(">d", 500.0) + names)
            client.sendall(message("V", b"\0\2") + outputs + message("S"))
            assert until(lambda: server.serve(0.1) and server.peers and server.peers[0].is_started)
            (peer,) = server.peers
            assert until(lambda: peer.is_ready)
            assert until(lambda: server.send(0) or peer.skipped > 100, 20.0)

            def has_room() -> bool:
                client.recv(1 << 16)
                before = peer.skipped
                server.send(0)
                return peer.skipped == before

            assert until(has_room)
            assert server.peers == [peer]
    finally:
        server.close()


# ---- motion


def motion() -> CommandedMotion:
    limits = np.tile([-6.0, 6.0], (6, 1))
    return CommandedMotion([f"j{k}" for k in range(6)], limits, np.full(6, 3.0))


def path(moving: CommandedMotion, begin: float, seconds: float) -> np.ndarray:
    rows = []
    for k in range(1, round(seconds * 1000) + 1):
        moving.step(begin + k / 1000, 1e-3)
        rows.append(np.concatenate((moving.angles, moving.velocities)))
    return np.array(rows)


@pytest.mark.parametrize(("speed", "acceleration"), [(0.5, 2.0), (3.0, 1.0)])
def test_move_respects_speed_and_acceleration(speed: float, acceleration: float) -> None:
    moving = motion()
    goal = np.array([1.0, -0.5, 0, 0, 0, 0.2])
    assert moving.move(goal, speed, acceleration, 1.0) == ""
    rows = path(moving, 1.0, 4.0)
    assert moving.mode == HOLDS
    np.testing.assert_array_equal(moving.angles, goal)
    differences = np.diff(rows[:, :6], axis=0) / 1e-3
    assert np.abs(differences).max() == pytest.approx(min(speed, acceleration**0.5), rel=2e-3)
    assert np.abs(np.diff(differences, axis=0)).max() < 1.01 * acceleration * 1e-3
    np.testing.assert_allclose(differences, rows[1:, 6:], atol=acceleration * 1.1e-3)


def test_speeds_are_reached_and_left_by_their_acceleration() -> None:
    moving = motion()
    assert moving.speed(np.array([0.4, 0, 0, 0, 0, -0.2]), 2.0) == ""
    rows = path(moving, 0.0, 0.3)
    assert rows[99, 6] == pytest.approx(0.2)
    np.testing.assert_allclose(rows[-1, 6:], [0.4, 0, 0, 0, 0, -0.2], atol=1e-9)
    moving.stop(4.0)
    rows = path(moving, 0.3, 0.2)
    assert moving.mode == HOLDS
    assert rows[49, 6] == pytest.approx(0.2)
    assert "j1 is commanded at 9 rad/s; expected up to 3" in moving.speed(
        np.array([0.0, 9, 0, 0, 0, 0]), 1.0
    )
    assert "acceleration: found 0" in moving.speed(np.zeros(6), 0.0)


def test_single_angles_are_followed_no_faster_than_joints_may() -> None:
    moving = motion()
    assert moving.servo(np.full(6, 0.29), 0.0, 0.002) == ""
    rows = path(moving, 0.0, 0.2)
    assert moving.mode == SERVOS
    assert np.abs(np.diff(rows[:, 0])).max() <= 3e-3 + 1e-12
    assert rows[-1, 0] == pytest.approx(0.29)
    assert moving.servo(np.full(6, 0.7), 0.2, 0.002)  # 4.1 rad/s for 0.1 s
    assert moving.servo(np.full(6, 0.30), 0.2, 0.002) == ""
    assert moving.servo(np.full(6, 0.31), 0.202, 0.002)  # 5 rad/s
    moving.stop(1.0)
    rows = path(moving, 0.2, 0.2)
    assert moving.mode == HOLDS
    np.testing.assert_allclose(rows[-1], [0.30] * 6 + [0.0] * 6, atol=1e-9)
    assert rows[:, 0].max() <= 0.30 + 1e-9
