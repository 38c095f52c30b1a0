"""`RtdeReceiver` against a controller that `struct` alone plays, on real sockets."""

from __future__ import annotations

import contextlib
import random
import select
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import examples
from decor_tools import corner_lines, view_at
from hypothesis import given, settings
from hypothesis import strategies as st
from polling import until
from rtde_server import TYPES, RtdeServer, message, text_message

from sero_mj.base.errors import DeclarationError
from sero_mj.cli import main
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.receive import connecting, receiving_thread
from sero_mj.data.receive.report import describe, report
from sero_mj.data.receive.source import make_source
from sero_mj.data.record.replay import Replay
from sero_mj.extensions.rtde import receiver as rtde
from sero_mj.extensions.rtde.receiver import STRUCTURE, VARIABLES, RtdeReceiver
from sero_mj.load import load_scene
from sero_mj.viewer.decor.status import Status
from sero_mj.viewer.decor.toggles import Toggles

OLD = {name: kind for name, kind in TYPES.items() if name != "actual_current_as_torque"}
SIX = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
SCENE = """
[robots.arm]
dh_convention = "standard"
dh_params_deg = [[90, 0, 0, 0.16], [0, -0.43, 0, 0], [0, -0.39, 0, 0], [90, 0, 0, 0.13],
                 [-90, 0, 0, 0.1], [0, 0, 0, 0.1]]
show_arrows = true
[sources.ur]
kind = "rtde"
host = "127.0.0.1"
port = {port}
[doubles.target]
of = "arm"
[routes]
"arm.joint_angles" = "ur.joint_angles"
"arm.torques" = "ur.torques"
"arm.commanded_torques" = "ur.commanded_torques"
"target.joint_angles" = "ur.commanded_angles"
"""
PEER = """
import sys
import time
import rtde_receive
if len(sys.argv) > 1:
    robot = rtde_receive.RTDEReceiveInterface(sys.argv[1], 125.0, sys.argv[2].split(","))
    end = time.monotonic() + 10
    while robot.getTimestamp() != 3.0 and time.monotonic() < end:  # before, it has anything
        time.sleep(0.002)
    print(*robot.getActualQ(), *robot.getTargetMoment(), *robot.getActualTCPForce(), sep=",")
    print(robot.getRobotMode(), robot.getSafetyMode(), robot.getTimestamp(), flush=True)
    sys.stdin.readline()
    robot.disconnect()
"""


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Attempts to connect follow each other quickly."""
    monkeypatch.setattr(receiving_thread, "MIN_PAUSE", 0.002)
    monkeypatch.setattr(receiving_thread, "MAX_PAUSE", 0.02)


@pytest.fixture
def server() -> Iterator[RtdeServer]:
    with RtdeServer() as server:
        yield server


def receiver_of(server: RtdeServer, **fields: Any) -> RtdeReceiver:
    return RtdeReceiver(host="127.0.0.1", port=server.port, **fields)


def give(receiver: RtdeReceiver, server: RtdeServer, *messages: bytes) -> None:
    """Sends messages and waits until they are dealt with."""
    before = receiver.counters.received
    server.send(*messages)
    assert until(lambda: receiver.counters.received == before + len(messages))


# ---- what comes


def test_every_variable_is_in_its_event(server: RtdeServer) -> None:
    values = {
        name: [100.0 * k + x for x in SIX]
        for k, (name, kind, _) in enumerate(VARIABLES)
        if kind == "VECTOR6D"
    }
    with receiver_of(server) as receiver:
        assert server.started.wait(5.0)
        give(receiver, server, server.package(timestamp=5.5, **values))
        packet = receiver.latest()
        assert packet is not None
        got = {event: array.ravel().tolist() for event, array in packet.values.items()}
        assert got == {
            "timestamp": [5.5],
            "joint_angles": values["actual_q"],
            "joint_velocities": values["actual_qd"],
            "currents": values["actual_current"],
            "torques": values["actual_current_as_torque"],
            "commanded_torques": values["target_moment"],
            "commanded_angles": values["target_q"],
            "tcp_force": values["actual_TCP_force"][:3],
            "tcp_moment": values["actual_TCP_force"][3:],
            "robot_mode": [7],
            "safety_mode": [1],
            "torques_are_commanded": [0],
            "package_number": [1],
        }
        assert receiver.about == f"UR RTDE of 127.0.0.1:{server.port}, 500 Hz"
        assert receiver.trouble == ""
    assert [kind for kind, _ in server.asked] == ["V", "v", "O", "S"]  # questions, no command
    assert server.rate == 500.0


@pytest.mark.parametrize(
    ("major", "asked", "rate"), [(5, 0, 500), (3, 0, 125), (3, 250, 125), (10, 50, 50)]
)
def test_rate_is_limited_by_the_controller_version(major: int, asked: float, rate: float) -> None:
    with (
        RtdeServer(version=(major, 1, 0, 0)) as server,
        receiver_of(server, frequency=float(asked)) as receiver,
    ):
        assert server.started.wait(5.0)
        give(receiver, server, server.package())
        assert server.rate == rate
        assert receiver.about.endswith(f", {rate} Hz")


def test_controller_without_torques_shows_the_commanded_ones(
    caplog: pytest.LogCaptureFixture,
) -> None:
    told = "torques are commanded, not measured"
    with RtdeServer(version=(5, 11, 6, 0), types=OLD) as server, receiver_of(server) as receiver:
        for _ in range(2):  # and once more when it has connected again
            assert until(lambda: server.started.is_set() and server.recipe != [])
            give(receiver, server, server.package(target_moment=SIX))
            packet = receiver.latest()
            assert packet is not None
            assert packet.values["torques"].tolist() == [*SIX]
            assert packet.values["torques_are_commanded"] == 1
            assert receiver.about.endswith(f"500 Hz, {told}")
            assert report(receiver)["controller"] == f"robot running, safety: normal, {told}"
            server.drop()
            assert until(lambda: not server.started.is_set())
    said = [text for text in caplog.messages if "actual_current_as_torque" in text]
    assert said == [
        "source 'rtde': controller 5.11.6 does not measure torques "
        "(actual_current_as_torque requires PolyScope 5.23 or 10.11); the commanded torques "
        "(target_moment) are shown instead"
    ]


def test_missing_variables_are_reported_and_count_as_no_data(
    caplog: pytest.LogCaptureFixture,
) -> None:
    types = {**OLD, "actual_current": "VECTOR6INT32", "actual_TCP_force": "IN_USE"}
    del types["target_moment"], types["safety_mode"]
    with RtdeServer(types=types) as server, receiver_of(server) as receiver:
        assert until(lambda: server.connections == 2) and server.started.wait(5.0)
        give(receiver, server, server.package(actual_q=SIX))
        packet = receiver.latest()
        assert packet is not None
        values = packet.values
        assert values["joint_angles"].tolist() == [*SIX]
        for event in ("currents", "torques", "commanded_torques", "tcp_force", "tcp_moment"):
            assert np.isnan(values[event]).all(), event
        assert (values["torques_are_commanded"], values["safety_mode"]) == (0, -128)
        assert report(receiver)["controller"] == "robot running"
        assert receiver.link_faults(*receiver.link_state(values)) == []
    for text in (
        "the controller has no target_moment",
        "the controller has no safety_mode",
        "actual_current is of type VECTOR6INT32; expected VECTOR6D",
        "actual_TCP_force is in use by another client",
    ):
        assert f"source 'rtde': {text}" in caplog.messages


def test_packages_omitted_by_the_controller_are_lost(server: RtdeServer) -> None:
    with receiver_of(server) as receiver:
        assert server.started.wait(5.0)
        times = [1.0, 1.002, 1.004, 1.010, 1.0115, 1.0145, 1.016]
        give(receiver, server, *(server.package(timestamp=t) for t in times))
        assert (receiver.counters.lost, receiver.receive_trigger) == (2, len(times))


@pytest.mark.parametrize(("rate", "cycles"), [(500, (1,)), (400, (1, 2, 1, 1)), (125, (4,))])
def test_rates_between_those_of_the_cycle_lose_nothing(
    rate: float, cycles: tuple[int, ...]
) -> None:
    packages = rtde._Packages(1, frozenset(), float(rate), 500.0)
    stamp, numbers = 7000.0, []
    for k in range(200):
        stamp += 0.002 * cycles[k % len(cycles)]
        packet = packages.packet(b"\1" + struct.pack(">d", stamp) + bytes(packages._length - 9), 0)
        numbers.append(struct.unpack(">I", packet[-4:])[0])
    assert numbers == list(range(1, 201))


def test_ur_rtde_reads_the_same_from_the_same_controller() -> None:
    try:
        subprocess.run([sys.executable, "-c", PEER], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("ur_rtde is not installed")
    host = f"127.{random.randint(1, 254)}.{random.randint(1, 254)}.7"  # its port is fixed
    names = "timestamp,actual_q,target_moment,actual_TCP_force,robot_mode,safety_mode"
    with RtdeServer(host=host, port=30004) as server:
        values = {"actual_q": SIX, "target_moment": SIX[::-1], "actual_TCP_force": SIX}
        process = subprocess.Popen(
            [sys.executable, "-c", PEER, host, names],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert process.stdin is not None and process.stdout is not None
        try:
            while not select.select([process.stdout], [], [], 0.008)[0]:
                server.send(server.package(timestamp=3.0, **values))
            numbers = [float(x) for x in process.stdout.readline().split(",")]
            modes = process.stdout.readline().split()
        finally:
            process.kill()
            process.communicate()
        assert numbers == [*SIX, *SIX[::-1], *SIX]
        assert modes == ["7", "1", "3.0"]
    with RtdeServer(host=host, port=30004) as server, RtdeReceiver(host=host) as receiver:
        assert server.started.wait(5.0)
        give(receiver, server, server.package(timestamp=3.0, **values))
        packet = receiver.latest()
        assert packet is not None
        ours = [packet.values[event] for event in ("joint_angles", "commanded_torques")]
        assert np.concatenate(ours).tolist() == numbers[:12]


# ---- what goes wrong


@pytest.mark.parametrize(
    ("answers", "trouble", "counted"),
    [
        ({"V": b"HTTP/1.1 400 Bad Request\r\n"},
         "an RTDE message is invalid: 18516 bytes of type 84", 1),
        ({"V": bytes(3)}, "an RTDE message is invalid: 0 bytes of type 0", 1),
        ({"V": b"\xff\xffU"}, "an RTDE message is invalid: 65535 bytes of type 85", 1),
        ({"V": message("V", b"\0")}, "the robot does not accept version 2 of RTDE", 0),
        ({"V": message("v", bytes(16))}, "the robot answers request V with v", 1),
        ({"v": message("v", bytes(3))}, "the robot sends an invalid controller version", 1),
        ({"O": message("O", b"\1DOUBLE")}, "the robot sends 1 types for 10 variables", 1),
        ({"O": message("O", b"")}, "the robot sends 1 types for 10 variables", 0),
        ({"O": message("O", b"\0" + b",".join([b"NOT_FOUND"] * 10))},
         "the robot has none of the required variables", 0),
        ({"S": message("S", b"\0")}, "the robot does not start to send data", 0),
        ({"S": message("S", b"\1") + message("S", b"\1")},
         "the robot sends a message of type S between data packages", 1),
    ],
)  # fmt: skip
def test_protocol_errors_are_reported_and_retried(
    answers: dict[str, bytes], trouble: str, counted: int
) -> None:
    with RtdeServer(answers=answers) as server, receiver_of(server) as receiver:
        assert until(lambda: receiver.trouble != "" and server.connections > 1)
        assert receiver.trouble == f"127.0.0.1:{server.port}: {trouble}"
        assert (receiver.counters.received > 0) == bool(counted)
        assert receiver.counters.malformed == receiver.counters.received
        assert receiver.latest() is None
        told = {row[0]: row for row in describe(report(receiver))}
        assert told["state"][1:] == ("silent", f"no valid packet yet: {receiver.trouble}")
        answers.clear()
        assert until(lambda: receiver.trouble == "")
        give(receiver, server, server.package(actual_q=SIX))
        assert receiver.latest() is not None


def test_texts_are_logged_once(server: RtdeServer, caplog: pytest.LogCaptureFixture) -> None:
    server.answers["hello"] = text_message("SafetySetup has not been confirmed yet")
    with receiver_of(server) as receiver:
        assert server.started.wait(5.0)
        server.send(text_message("later"), message("M"), message("M", b"\xffcut off"))
        server.send(text_message("later"))
        give(receiver, server, server.package())
    said = [text.partition("controller: ")[2] for text in caplog.messages]
    assert [text.strip("\xff\ufffd") for text in said] == [
        "SafetySetup has not been confirmed yet", "later", "", "cut off",
    ]  # fmt: skip


def test_unexpected_data_packages_are_counted(server: RtdeServer) -> None:
    with receiver_of(server) as receiver:
        assert server.started.wait(5.0)
        good = server.package(actual_q=SIX)
        size = receiver.size
        give(receiver, server, good, server.package(recipe=2), message("U", good[3:-8]),
             message("U", b"\1" + bytes(size - 1)), message("U"), good)  # fmt: skip
        assert (receiver.counters.wrong_size, receiver.receive_trigger) == (4, 2)
        assert receiver.counters.last_fault == "0 bytes are not a data package of the agreed recipe"
        nan = server.package(actual_q=[float("nan")] * 6)
        give(receiver, server, nan)
        assert receiver.counters.not_finite == 1


def test_stalled_peer_is_disconnected(server: RtdeServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connecting, "PATIENCE", 0.05)
    with receiver_of(server) as receiver:
        server.answers["v"] = b""
        assert until(lambda: receiver.trouble.endswith(": the robot does not answer request v"))
        del server.answers["v"]
        assert until(lambda: receiver.trouble.endswith(": the robot sends nothing for 0.05 s"))
        assert receiver.counters.received == 0


def test_peer_that_closes_at_once_is_reported(server: RtdeServer) -> None:
    server.answers["V"] = lambda _: server.drop() or b""
    with receiver_of(server) as receiver:
        told = f"127.0.0.1:{server.port}: the peer closed the connection"
        assert until(lambda: receiver.trouble == told and server.connections > 2)


def test_peer_that_disconnects_is_connected_again(server: RtdeServer) -> None:
    with receiver_of(server) as receiver:
        for k in range(3):
            assert until(lambda k=k: server.connections == k + 1) and server.started.wait(5.0)
            give(receiver, server, server.package(timestamp=1.0), server.package(timestamp=1.002))
            server.drop()
        assert until(lambda: server.connections == 4) and server.started.wait(5.0)
        assert until(lambda: receiver.counters.restarts == 3)
        assert (receiver.counters.received, receiver.counters.lost) == (6, 0)


def test_receiver_waits_for_a_controller_that_is_off(caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    with RtdeReceiver(host="127.0.0.1", port=port) as receiver:
        assert until(lambda: receiver.trouble != "")
        assert receiver.trouble == f"127.0.0.1:{port}: Connection refused"
        with RtdeServer(port=port) as server:
            assert server.started.wait(5.0)
            give(receiver, server, server.package())
    texts = [text for text in caplog.messages if "refused" in text]
    assert texts == [f"source 'rtde': 127.0.0.1:{port}: Connection refused; trying again"]
    with RtdeReceiver(host="no.such.host.invalid") as receiver:
        assert until(lambda: receiver.trouble.startswith("no.such.host.invalid:30004: "))
    with RtdeReceiver(host="a..b", debug_level=0) as receiver:
        assert until(lambda: receiver.trouble == "a..b:30004: not an address")


@settings(max_examples=examples(80))
@given(st.lists(st.binary(max_size=3000), max_size=3))
def test_random_bytes_end_a_connection_and_nothing_else(chunks: list[bytes]) -> None:
    with RtdeServer() as server, receiver_of(server, debug_level=0) as receiver:

        def send(text: bytes) -> None:
            with contextlib.suppress(OSError):  # it has gone, and comes again
                server.send(text)

        def is_well() -> bool:
            if server.started.is_set():
                send(server.package(actual_q=SIX))
            packet = receiver.latest()
            return packet is not None and packet.values["joint_angles"].tolist() == [*SIX]

        for chunk in chunks:
            # A header in front of half of them, so that they get further.
            size = len(chunk) + 3
            send(chunk if len(chunk) % 2 else struct.pack(">HB", size, ord("U")) + chunk)
        server.drop()  # else it may wait for the rest of a message
        assert until(is_well)


# ---- in a scene


@pytest.mark.parametrize(
    ("fields", "key", "reason"),
    [
        ({}, "host", "is required"),
        ({"host": ""}, "host", "found ''; expected an address such as 192.168.0.3"),
        ({"host": "a b"}, "host", "found 'a b'; expected an address such as 192.168.0.3"),
        (
            {"host": "a", "structure": "7F"},
            "structure",
            "found '7F'; RTDE determines this",
        ),
        (
            {"host": "a", "sequence": ""},
            "sequence",
            "found ''; RTDE determines this",
        ),
        ({"host": "a", "frequency": 501.0}, "frequency", "found 501; expected"),
        ({"host": "a", "port": 0}, "port", "found 0; expected"),
    ],
)
def test_fields_are_checked(fields: dict[str, Any], key: str, reason: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        make_source("ur", {"kind": "rtde", **fields})
    (problem,) = caught.value.problems
    assert problem.key == key
    assert problem.message.startswith(reason)


def test_robot_is_mirrored_recorded_and_replayed(tmp_path: Path) -> None:
    file, recording = tmp_path / "ur.toml", tmp_path / "ur.mcap"
    with RtdeServer(types=OLD) as server:
        file.write_text(SCENE.format(port=server.port))
        scene = load_scene(file)
        with Mirror(scene) as mirror:
            source = mirror.sources["ur"]
            assert isinstance(source, RtdeReceiver)
            awaited = Status(mirror.world)._awaited(mirror.data, Toggles(mirror.world), view_at())
            assert awaited is not None
            assert [text.decode() for text in awaited.texts[0]] == [
                f"no packet yet on UR RTDE of 127.0.0.1:{server.port}",
                "  expected: data packages",
            ]
            mirror.advance()  # while nothing is there
            assert until(lambda: server.connections == 2) and server.started.wait(5.0)
            target = [angle + 0.1 for angle in SIX]
            with record_sources(mirror.sources, recording, scene=scene):
                good = server.package(actual_q=SIX, target_q=target, target_moment=SIX)
                give(source, server, message("U", good[3:-1]))
                give(source, server, good)
            mirror.advance()
            check(mirror, target)
            idle = server.package(robot_mode=5, safety_mode=3)
            give(source, server, idle)
            mirror.advance()
            assert corner_lines(mirror) == [
                "ur: 1 of 3 packets not applied",
                f"  invalid data package, {len(good) - 4} bytes",
                "ur: robot idle, safety: protective stop",
            ]
    scene.sources["ur"] = Replay(name="ur", file=recording)
    with Mirror(scene) as again:
        again.advance(1e3)
        check(again, target)
        assert again.sources["ur"].counters.wrong_size == 1
        assert report(again.sources["ur"])["controller"].endswith("commanded, not measured")


def check(mirror: Mirror, target: list[float]) -> None:
    world, data = mirror.world, mirror.data
    np.testing.assert_array_equal(data.qpos[world.robots["arm"].qpos], SIX)
    np.testing.assert_array_equal(data.userdata[world.slots["arm.torques"]], SIX)
    np.testing.assert_array_equal(data.userdata[world.slots["target.joint_angles"]], target)


def test_status_reports_the_state_of_the_controller(tmp_path: Path, capsys: Any) -> None:
    def answer(_: bytes) -> bytes:
        return message("S", b"\1") + server.package(robot_mode=5)

    with RtdeServer(answers={"S": answer}) as server:
        file = tmp_path / "ur.toml"
        file.write_text(SCENE.format(port=server.port))
        with pytest.raises(SystemExit) as ended:
            main(["status", str(file), "--duration", "0.5"])
    assert ended.value.code == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[0][:3] == ["ur:", "UR", "RTDE"]
    assert ["controller", "robot", "idle,", "safety:", "normal"] in lines


def test_only_requests_are_sent() -> None:
    text = Path(rtde.__file__).read_text()
    assert text.count("sendall(") == 1
    assert "connection.request(" in text
    assert {kind for kind in "IUP" if f"ord('{kind}')" in text} == set()


def test_structure_equals_that_of_the_variables() -> None:
    assert RtdeReceiver(host="a").structure == STRUCTURE
    sizes = {"DOUBLE": 8, "VECTOR6D": 48, "INT32": 4}
    assert RtdeReceiver(host="a").size == sum(sizes[kind] for _, kind, _ in VARIABLES) + 5
