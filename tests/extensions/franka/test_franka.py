"""`FrankaReceiver` against a robot that `ctypes` alone plays, on real sockets."""

from __future__ import annotations

import contextlib
import ctypes
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import examples
from decor_tools import corner_lines, view_at
from franka_server import STATES, FrankaServer, answer, state
from hypothesis import given, settings
from hypothesis import strategies as st
from polling import until

from sero_mj.base.errors import DeclarationError
from sero_mj.cli import main
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.receive import connecting, receiving_thread
from sero_mj.data.receive.report import describe, report
from sero_mj.data.receive.source import make_source
from sero_mj.data.record.replay import Replay
from sero_mj.extensions.franka import receiver as franka
from sero_mj.extensions.franka.receiver import ERRORS, FrankaReceiver, state_fields, state_size
from sero_mj.load import load_scene
from sero_mj.viewer.decor.status import Status
from sero_mj.viewer.decor.toggles import Toggles

SEVEN = [0.5, -0.25, 1.0, -2.0, 0.125, 1.5, 0.75]  # exact in float32
SCENE = """
[robots.fr3]
model = "fr3"
show_arrows = true
[sources.fci]
kind = "franka"
host = "127.0.0.1"
port = {port}
[doubles.target]
of = "fr3"
[routes]
"fr3.joint_angles" = "fci.joint_angles"
"fr3.torques" = "fci.torques"
"target.joint_angles" = "fci.commanded_angles"
"""


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Attempts to connect follow each other quickly."""
    monkeypatch.setattr(receiving_thread, "MIN_PAUSE", 0.002)
    monkeypatch.setattr(receiving_thread, "MAX_PAUSE", 0.02)


@pytest.fixture
def server() -> Iterator[FrankaServer]:
    with FrankaServer() as server:
        yield server


def receiver_of(server: FrankaServer, **fields: Any) -> FrankaReceiver:
    return FrankaReceiver(host="127.0.0.1", port=server.port, **fields)


def give(receiver: FrankaReceiver, server: FrankaServer, *datagrams: bytes) -> None:
    """Sends datagrams and waits until they are dealt with."""
    before = receiver.counters.received
    server.send(*datagrams)
    assert until(lambda: receiver.counters.received == before + len(datagrams))


# ---- what comes


@pytest.mark.parametrize("version", STATES)
def test_field_offsets_equal_those_of_a_packed_struct(version: int) -> None:
    made = STATES[version]
    theirs = {name: getattr(made, name).offset for name, *_ in made._fields_}
    assert {name: at for name, (at, _) in state_fields(version).items()} == theirs
    assert state_size(version) == ctypes.sizeof(made)


def test_field_offsets_equal_those_of_the_published_headers() -> None:
    names = ("tau_J", "tau_J_d", "q", "q_d", "dq", "tau_ext_hat_filtered", "O_F_ext_hat_K")
    new, old = state_fields(10), state_fields(9)
    assert [new[name][0] for name in names] == [512, 540, 596, 624, 652, 840, 868]
    assert [old[name][0] for name in names] == [1016, 1072, 1184, 1240, 1296, 1672, 1728]
    assert (new["robot_mode"][0], state_size(10), state_size(9)) == (1372, 1377, 2373)


@pytest.mark.parametrize("version", STATES)
def test_every_version_is_detected_and_every_event_is_decoded(version: int) -> None:
    fields = {
        name: [100.0 * k + x for x in SEVEN]
        for k, name in enumerate(("tau_J", "tau_J_d", "q", "q_d", "dq", "tau_ext_hat_filtered"))
    }
    with FrankaServer(version) as server, receiver_of(server) as receiver:
        assert server.started.wait(5.0)
        flags = [k == 7 for k in range(41 if version >= 5 else 37)]
        wrench = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
        give(
            receiver,
            server,
            server.state(**fields, O_F_ext_hat_K=wrench, errors=flags, reflex_reason=flags[::-1],
                         robot_mode=4, message_id=77),
        )  # fmt: skip
        packet = receiver.latest()
        assert packet is not None
        got = {event: array.ravel().tolist() for event, array in packet.values.items()}
        empty = [0.0] * (41 - len(flags))
        # Franka's external torques and forces are those of the robot on its environment.
        assert got == {
            "message_id": [77],
            "torques": fields["tau_J"],
            "commanded_torques": fields["tau_J_d"],
            "joint_angles": fields["q"],
            "commanded_angles": fields["q_d"],
            "joint_velocities": fields["dq"],
            "external_torques": [-x for x in fields["tau_ext_hat_filtered"]],
            "tcp_force": [-1.0, -2.0, -3.0],
            "tcp_moment": [-4.0, -5.0, -6.0],
            "errors": [float(flag) for flag in flags] + empty,
            "reflex_reasons": [float(flag) for flag in flags[::-1]] + empty,
            "robot_mode": [4],
        }
        where = f"127.0.0.1:{server.port}"
        assert receiver.about == f"Franka FCI of {where}, version {version}"
        assert receiver.trouble == ""
        server.drop()  # and the next time the right version is asked for at once
        assert until(lambda: len(server.asked) == 2 + (version != 10)) and server.started.wait(5.0)
    asked = [struct.unpack("<IIIHH", question) for question in server.asked]
    assert [fields[:4] for fields in asked] == [
        (0, 1, 16, v) for v in ([10] if version != 10 else []) + [version] * 2
    ]


def test_nothing_but_the_question_is_sent(server: FrankaServer) -> None:
    with receiver_of(server) as receiver:
        assert server.started.wait(5.0)
        give(receiver, server, *(server.state() for _ in range(100)))
        server._states.setblocking(False)
        with pytest.raises(BlockingIOError):
            server._states.recv(1)
    assert until(lambda: not server.started.is_set())
    assert [len(question) for question in server.asked] == [16]
    text = Path(franka.__file__).read_text()
    assert (text.count("sendall("), text.count("sendto"), text.count(".send(")) == (1, 0, 0)


def test_missing_states_are_counted_as_lost(server: FrankaServer) -> None:
    with receiver_of(server) as receiver:
        assert server.started.wait(5.0)
        numbers = [1000, 1001, 1004, 1005, 1005]
        give(receiver, server, *(server.state(message_id=number) for number in numbers))
        counters = receiver.counters
        assert (counters.lost, counters.duplicates, receiver.receive_trigger) == (2, 1, 4)


# ---- what goes wrong


@pytest.mark.parametrize(
    ("said", "trouble", "counted"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n", "the robot sends an invalid FCI message", 1),
        (answer(command=1), "the robot sends an invalid FCI message", 1),
        (answer(number=2), "the robot sends an invalid FCI message", 1),
        (struct.pack("<III", 0, 1, 12), "the robot sends an invalid FCI message", 1),
        (struct.pack("<III", 0, 1, 2**31), "the robot sends an invalid FCI message", 1),
        (answer() + b"x", "the robot sends more bytes than one answer", 1),
        (answer(status=2), "the robot rejects the connection with status 2", 0),
        (
            answer(1, version=11),
            "the robot has server version 11; supported versions are 3 to 10",
            0,
        ),
        (answer(1, version=2), "the robot has server version 2; supported versions are 3 to 10", 0),
        (
            answer(0, version=11),
            "the robot has server version 11; supported versions are 3 to 10",
            0,
        ),
        (answer(1, version=10), "the robot has server version 10 and rejects version 10", 0),
        (
            b"",
            "the robot does not answer (the peer closed the connection); "
            "is another client connected?",
            0,
        ),
    ],
)
def test_protocol_errors_are_reported_and_retried(said: bytes, trouble: str, counted: int) -> None:
    with FrankaServer(answers=[said] * 3) as server, receiver_of(server) as receiver:
        seen = set()
        assert until(lambda: seen.add(receiver.trouble) or server.started.is_set())
        assert seen - {""} == {f"127.0.0.1:{server.port}: {trouble}"}
        assert until(lambda: receiver.trouble == "")
        assert receiver.counters.received == receiver.counters.malformed == 3 * counted
        give(receiver, server, server.state(q=SEVEN))
        assert receiver.latest() is not None
        assert server.connections == 4


def test_two_versions_that_refer_to_each_other_cause_no_endless_loop() -> None:
    said = [answer(1, version=9), answer(1, version=10)]
    with FrankaServer(answers=said) as server, receiver_of(server) as receiver:
        told = f"127.0.0.1:{server.port}: the robot has server version 10 and rejects version 9"
        assert until(lambda: receiver.trouble == told or server.started.is_set())
        assert until(server.started.is_set)
        assert [question[12] for question in server.asked] == [10, 9, 9, 10]


def test_invalid_states_are_counted_and_reported(server: FrankaServer) -> None:
    with receiver_of(server) as receiver:
        assert server.started.wait(5.0)
        good = server.state(q=SEVEN)
        give(receiver, server, good, good[:-1], good + b"x", b"", b"x" * 9000, server.state())
        counters = receiver.counters
        assert (counters.wrong_size, receiver.receive_trigger) == (4, 2)
        assert counters.last_fault == (
            "9000 bytes; expected a state of 1377, 2085, 2341, 2373 bytes"
        )
        give(receiver, server, server.state(q=[float("nan")] * 7))
        assert counters.not_finite == 1


def test_packets_of_other_senders_are_ignored(server: FrankaServer) -> None:
    with receiver_of(server) as receiver, socket.socket(type=socket.SOCK_DGRAM) as other:
        assert server.started.wait(5.0)
        other.bind(("127.0.0.2", 0))
        other.sendto(state(q=SEVEN), server.to)
        assert until(lambda: receiver.counters.foreign == 1)
        give(receiver, server, server.state())
        assert (receiver.counters.received, receiver.receive_trigger) == (2, 1)


def test_other_senders_do_not_replace_a_stalled_robot(
    server: FrankaServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connecting, "PATIENCE", 0.05)
    with receiver_of(server), socket.socket(type=socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.2", 0))
        assert server.started.wait(5.0)

        def has_left() -> bool:
            for _ in range(20):
                other.sendto(state(q=SEVEN), server.to)
            return server.connections > 1

        assert until(has_left)


def test_unexpected_tcp_message_ends_the_connection(server: FrankaServer) -> None:
    with receiver_of(server) as receiver:
        server.say(b"move!")
        assert until(lambda: server.connections == 2) and server.started.wait(5.0)
        assert receiver.counters.wrong_size == 1


def test_stalled_robot_is_disconnected(
    server: FrankaServer, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(connecting, "PATIENCE", 0.05)
    server.answers = [answer()[:-1]]

    def is_told(text: str) -> bool:
        return any(text in message for message in caplog.messages)

    with receiver_of(server):
        where = f"127.0.0.1:{server.port}: "
        assert until(
            lambda: is_told(f"{where}the robot does not answer; is another client connected?")
        )
        assert until(lambda: is_told(f"{where}the robot sends no states to UDP port "))
        assert is_told("; is it blocked by a firewall?")
        server.on_start = lambda: server.send(server.state())
        assert until(lambda: is_told(f"{where}the robot sends nothing for 0.05 s"))


def test_robot_that_disconnects_is_connected_again(server: FrankaServer) -> None:
    with receiver_of(server) as receiver:
        for k in range(3):
            assert until(lambda k=k: server.connections == k + 1) and server.started.wait(5.0)
            give(receiver, server, *(server.state(message_id=1000 * k + i) for i in (1, 2)))
            server.drop()
        assert until(lambda: receiver.counters.restarts == 3)
        assert (receiver.counters.received, receiver.counters.lost) == (6, 0)


def test_receiver_waits_for_a_robot_that_is_off(caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    with FrankaReceiver(host="127.0.0.1", port=port) as receiver:
        told = f"127.0.0.1:{port}: Connection refused; is FCI activated in Desk?"
        assert until(lambda: receiver.trouble == told)
        rows = {row[0]: row for row in describe(report(receiver))}
        assert rows["state"][1:] == ("silent", f"no valid packet yet: {told}")
        with FrankaServer(port=port) as server:
            assert server.started.wait(5.0)
            give(receiver, server, server.state())
    texts = [text for text in caplog.messages if "refused" in text]
    assert texts == [f"source 'franka': {told}; trying again"]


@settings(max_examples=examples(80))
@given(
    st.lists(st.binary(max_size=40), max_size=2),
    st.lists(st.one_of(st.binary(max_size=3000), st.sampled_from([1377, 2085, 2341, 2373])),
             max_size=4),
    st.randoms(use_true_random=False),
)  # fmt: skip
def test_random_bytes_end_a_connection_and_nothing_else(
    answers: list[bytes], datagrams: list[bytes | int], random: Any
) -> None:
    # A part of an answer would be waited for.
    answers = [text + b"\xff" * max(12 - len(text), 0) for text in answers]
    with (
        FrankaServer(answers=answers) as server,
        receiver_of(server, debug_level=0) as receiver,
    ):
        assert server.started.wait(5.0)
        sent = [random.randbytes(d) if isinstance(d, int) else d for d in datagrams]
        give(receiver, server, *sent)

        def is_well() -> bool:
            with contextlib.suppress(OSError):
                server.send(server.state(message_id=2**40 + server.connections, q=SEVEN))
            packet = receiver.latest()
            return packet is not None and packet.values["joint_angles"].tolist() == SEVEN

        server.drop()  # numbers may be anything so far; those of a new connection count
        assert until(lambda: server.connections > 1 + len(answers)) and server.started.wait(5.0)
        assert until(is_well)


@settings(max_examples=examples(60))
@given(st.sampled_from([*STATES]), st.data())
def test_decoded_state_equals_its_packet(version: int, data: st.DataObject) -> None:
    width = 32 if version >= 10 else 64
    reals = st.floats(allow_nan=False, allow_infinity=False, width=width)
    given = {
        name: data.draw(st.lists(reals, min_size=7, max_size=7))
        for name in ("tau_J", "q", "q_d", "dq", "tau_ext_hat_filtered")
    }
    number, mode = data.draw(st.integers(0, 2**53)), data.draw(st.integers(0, 255))
    packet = state(version, message_id=number, robot_mode=mode, **given)
    layout = FrankaReceiver(host="a").layout
    rows, lengths = layout.unpack(
        np.frombuffer(packet + b"\xff" * 3, np.uint8)[None], np.array([len(packet)])
    )
    assert lengths.tolist() == [layout.size]
    values = layout.decode(rows[0].tobytes())
    assert (values["message_id"], values["robot_mode"]) == (number, mode)
    for name, event in (("tau_J", "torques"), ("q", "joint_angles"), ("dq", "joint_velocities")):
        assert values[event].tolist() == given[name]


# ---- in words


def test_modes_and_errors_are_described_in_words() -> None:
    receiver = FrankaReceiver(host="a")

    def values_of(**fields: Any) -> dict[str, Any]:
        rows, _ = receiver.layout.unpack(
            np.frombuffer(text := state(**fields), np.uint8)[None], np.array([len(text)])
        )
        return receiver.layout.decode(rows[0].tobytes())

    def flags(*names: str) -> list[bool]:
        return [name in names for name in ERRORS]

    def told(**fields: Any) -> tuple[str, list[str]]:
        values = values_of(**fields)
        return receiver.describe_link(values), receiver.link_faults(*receiver.link_state(values))

    assert told(robot_mode=2) == ("robot moving", [])
    assert told(robot_mode=1, reflex_reason=flags("joint_reflex")) == (
        "robot idle, last: joint_reflex", [],
    )  # fmt: skip
    assert told(robot_mode=4, errors=flags("cartesian_reflex", "tau_J_range_violation")) == (
        "robot stopped by a reflex, cartesian_reflex, tau_J_range_violation",
        ["robot stopped by a reflex: cartesian_reflex"],
    )
    assert told(robot_mode=5) == ("robot stopped by its user", ["robot stopped by its user"])
    assert told(robot_mode=9) == ("robot in mode 9", ["robot in mode 9"])
    assert len(ERRORS) == 41


# ---- in a scene


@pytest.mark.parametrize(
    ("fields", "key", "reason"),
    [
        ({}, "host", "is required"),
        ({"host": ""}, "host", "found ''; expected an address such as 192.168.0.3"),
        (
            {"host": "a", "structure": "7F"},
            "structure",
            "found '7F'; FCI determines this",
        ),
        (
            {"host": "a", "time_scale": 1.0},
            "time_scale",
            "found 1; FCI determines this",
        ),
        ({"host": "a", "port": 0}, "port", "found 0; expected"),
    ],
)
def test_fields_are_checked(fields: dict[str, Any], key: str, reason: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        make_source("fci", {"kind": "franka", **fields})
    (problem,) = caught.value.problems
    assert problem.key == key
    assert problem.message.startswith(reason)


def test_robot_is_mirrored_recorded_and_replayed(tmp_path: Path) -> None:
    file, recording = tmp_path / "fr3.toml", tmp_path / "fr3.mcap"
    with FrankaServer(9) as server:
        file.write_text(SCENE.format(port=server.port))
        scene = load_scene(file)
        with Mirror(scene) as mirror:
            source = mirror.sources["fci"]
            assert isinstance(source, FrankaReceiver)
            awaited = Status(mirror.world)._awaited(mirror.data, Toggles(mirror.world), view_at())
            assert awaited is not None
            assert awaited.texts[0][1].decode() == "  expected: states"
            assert server.started.wait(5.0)
            target = [angle + 0.25 for angle in SEVEN]
            with record_sources(mirror.sources, recording, scene=scene):
                good = server.state(q=SEVEN, q_d=target, tau_J=SEVEN[::-1])
                give(source, server, good[:-8])
                give(source, server, good)
            mirror.advance()
            check(mirror, target)
            give(source, server, server.state(robot_mode=5))
            mirror.advance()
            assert corner_lines(mirror) == [
                "fci: 1 of 3 packets not applied",
                "  invalid state, 2365 bytes",
                "fci: robot stopped by its user",
            ]
    scene.sources["fci"] = Replay(name="fci", file=recording)
    with Mirror(scene) as again:
        again.advance(1e3)
        check(again, target)
        assert again.sources["fci"].counters.wrong_size == 1
        assert report(again.sources["fci"])["controller"] == "robot idle"


def check(mirror: Mirror, target: list[float]) -> None:
    world, data = mirror.world, mirror.data
    np.testing.assert_array_equal(data.qpos[world.robots["fr3"].qpos], SEVEN)
    np.testing.assert_array_equal(data.userdata[world.slots["fr3.torques"]], SEVEN[::-1])
    np.testing.assert_array_equal(data.userdata[world.slots["target.joint_angles"]], target)


def test_status_reports_the_state_of_the_robot(tmp_path: Path, capsys: Any) -> None:
    file = tmp_path / "fr3.toml"
    with FrankaServer() as server:
        file.write_text(SCENE.format(port=server.port))
        server.on_start = lambda: server.send(server.state(robot_mode=3))
        with pytest.raises(SystemExit) as ended:
            main(["status", str(file), "--duration", "0.5"])
    assert ended.value.code == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[0][:3] == ["fci:", "Franka", "FCI"]
    assert ["controller", "robot", "being", "guided"] in lines
