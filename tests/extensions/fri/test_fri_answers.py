"""Answers of `FriReceiver` (none by default), and the FRI status in images."""

from __future__ import annotations

import errno
import math
import socket
import struct
import sys
import threading
from pathlib import Path

import pytest
from decor_tools import corner_lines
from fri_packets import give, measurement
from polling import until

import sero_mj
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.receive.structure import Structure
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.data.record.recording_writer import RecordingWriter
from sero_mj.extensions.fri.receiver import COMMAND, FriReceiver, no_command
from sero_mj.load import load_scene


def test_receiver_without_answer_sends_nothing(controller: socket.socket) -> None:
    with FriReceiver(udpport=0) as receiver:
        give(receiver, controller, *(measurement(k, state=2) for k in range(50)), bytes(3))
        assert receiver.latest() is not None
        assert receiver.answers == 0
        controller.settimeout(0.2)
        with pytest.raises(TimeoutError):
            controller.recv(2000)


def test_nothing_but_the_answer_sends() -> None:
    package = Path(sero_mj.__file__).parent
    files = [*package.glob("data/receive/*.py"), package / "extensions" / "fri" / "receiver.py"]
    texts = {path.name: path.read_text() for path in files}
    assert {name for name, text in texts.items() if "sendto" in text} == {"udp_socket.py"}
    assert {name for name, text in texts.items() if "datagrams.send" in text} == {"udp.py"}
    handing_on = {name for name, text in texts.items() if "def _on_arrival(" in text}
    assert handing_on == {"udp.py", "receiver.py"}
    assert UdpReceiver(structure="7F")._on_arrival(lambda *_: None) is None
    assert FriReceiver()._on_arrival(lambda *_: None) is None


def test_answer_is_a_header_and_zeros(controller: socket.socket) -> None:
    with FriReceiver(udpport=0, answer=True) as receiver:
        moving = {"joint_angles": 1.0, "krl_real": 2.0, "krl_int": 3, "krl_bool": 0xFFFF}
        for k, counter in enumerate((65_534, 65_535, 0, 1), start=1):
            give(receiver, controller, measurement(counter, state=2, **moving))
            answer, sender = controller.recvfrom(2000)
            assert answer == struct.pack("<4H", k, counter, 376, 0x1005) + bytes(368)
            assert sender == ("127.0.0.1", receiver.port)
        assert receiver.answers == 4
    command = Structure(COMMAND)
    assert command.size == 376
    offsets = {field.name: field.offset for field in command.fields}
    assert (offsets["command_flags"], offsets["joint_torques"]) == (140, 220)
    assert command.decode(answer)["command_flags"] == 0


def test_counter_of_answers_wraps() -> None:
    assert no_command(65_535, 5)[:4] == struct.pack("<HH", 65_535, 5)
    assert no_command(65_536, 5)[:4] == struct.pack("<HH", 0, 5)


def test_only_measurements_are_answered() -> None:
    receiver, sent = FriReceiver(udpport=0, answer=True), []

    def send(packet: bytes, to: bytes) -> None:
        sent.append((struct.unpack_from("<2H", packet), to))
        if len(sent) == 3:
            raise OSError(errno.ENETUNREACH, "Network is unreachable")

    def come(*packets: bytes, sender: bytes) -> None:
        for packet in packets:
            answer(memoryview(packet.ljust(2048, b"\0")), len(packet), sender)

    answer = receiver._on_arrival(send)
    assert answer is not None
    v4 = struct.pack("=H2s4s20x", 2, (4711).to_bytes(2, "big"), bytes([10, 0, 0, 7]))
    v6 = struct.pack("=H2s4x16sI", 10, (5).to_bytes(2, "big"), b"\xfe\x80" + bytes(13) + b"\1", 3)
    # NaN makes a packet unusable here, but it is a measurement that the controller sent.
    come(measurement(1), measurement(2, torques=math.nan), bytes(916), bytes(376), sender=v4)
    come(measurement(3), sender=v4)  # the network is away
    come(measurement(4), sender=v6)
    come(measurement(5)[:-1], measurement(5) + b"\0", b"", sender=v4)
    come(measurement(5, packet_size=915), measurement(5, datagram_id=0x1005), sender=v4)
    assert sent == [((1, 1), v4), ((2, 2), v4), ((3, 3), v4), ((3, 4), v6)]
    assert receiver.answers == 3


def test_packets_received_during_callbacks_are_answered(controller: socket.socket) -> None:
    with FriReceiver(udpport=0, answer=True) as receiver:
        held = threading.Event()
        receiver.on_receive(lambda: held.wait(5.0) and None)  # the thread stands still
        for counter in range(40):
            controller.sendto(measurement(counter), ("127.0.0.1", receiver.port))
        held.set()
        answers = [controller.recv(2000) for _ in range(40)]
        assert [struct.unpack_from("<2H", each)[1] for each in answers] == list(range(40))
        assert until(lambda: receiver.answers == 40)


def test_answer_is_sent_before_the_packet_is_processed(controller: socket.socket) -> None:
    with FriReceiver(udpport=0, answer=True) as receiver:
        looked, go_on = threading.Event(), threading.Event()

        def look(*_: object) -> None:
            looked.set()
            go_on.wait(5.0)

        receiver.record_to(look)  # which is before all checks
        controller.sendto(measurement(7), ("127.0.0.1", receiver.port))
        assert looked.wait(5.0)
        assert struct.unpack_from("<2H", controller.recv(2000)) == (1, 7)
        assert receiver.counters.received == 0
        go_on.set()


def test_threads_take_short_turns_only_while_somebody_answers() -> None:
    usual = sys.getswitchinterval()
    with FriReceiver(udpport=0):
        assert sys.getswitchinterval() == usual
        with FriReceiver(udpport=0, answer=True) as one, FriReceiver(udpport=0, answer=True):
            assert sys.getswitchinterval() == pytest.approx(5e-4)
            one.close()
            assert sys.getswitchinterval() == pytest.approx(5e-4)
        assert sys.getswitchinterval() == usual


def test_unexpected_sender_gets_no_answer(controller: socket.socket) -> None:
    with FriReceiver(udpport=0, answer=True, sender=["127.0.0.1:9"]) as receiver:
        give(receiver, controller, measurement())
        assert (receiver.counters.foreign, receiver.answers) == (1, 0)


# ---- on the screen


@pytest.mark.parametrize(
    ("state", "quality", "answer", "lines"),
    [
        (1, 3, False, []),
        (2, 2, False, []),
        (1, 1, False, ["fri: quality bad, state monitor"]),
        (0, 3, False, ["fri: quality perfect, state off"]),
        (65_535, 65_535, True, ["fri: quality invalid, state invalid"]),
        (7, 9, True, ["fri: quality 9, state 7"]),
        (1, 0, True, ["fri: quality unacceptable, state monitor"]),
        (
            1,
            0,
            False,
            [
                "fri: quality unacceptable, state monitor",
                "  no answers are sent: answer = false",
            ],
        ),
    ],
)
def test_unhealthy_state_is_shown_in_the_corner(
    controller: socket.socket, state: int, quality: int, answer: bool, lines: list[str]
) -> None:
    scene = load_scene("lwr_fri")
    scene.sources["fri"] |= {"port": 0, "answer": answer}
    with Mirror(scene) as mirror:
        assert corner_lines(mirror) == []
        fri = mirror.sources["fri"]
        assert isinstance(fri, FriReceiver)
        give(fri, controller, measurement(state=state, quality=quality))
        mirror.advance()
        assert corner_lines(mirror) == lines
        give(fri, controller, measurement(1, datagram_id=1))
        mirror.advance()
        assert corner_lines(mirror)[:2] == [
            "fri: 1 of 2 packets not applied",
            "  wrong constant: another kind of packet",
        ]


def test_recording_of_fri_is_decoded_as_fri(tmp_path: Path) -> None:
    packets = [
        measurement(65_535, quality=1, tcp_moment=[3, 2, 1], commanded_before_fri=0.1),
        measurement(0, quality=1, tcp_moment=[3, 2, 1], commanded_before_fri=math.nan),
    ]
    events = {name: tuple(shape) for name, shape in FriReceiver().events.items()}
    with RecordingWriter(tmp_path / "run.mcap", about={}) as writer:
        writer.add_source("fri", kind="fri", declared={}, events=events, size=916)
        for k, packet in enumerate(packets):
            writer.write_raw("fri", packet, writer.clock.monotonic_ns / 1e9 + 0.01 * k)
    scene = load_scene("lwr_fri")
    scene.sources["fri"] = {"kind": "replay", "file": str(tmp_path / "run.mcap")}
    with Mirror(scene) as mirror:
        mirror.advance(0.5)
        assert mirror.sources["fri"].counters.not_finite == 1  # it would move the double
        assert corner_lines(mirror)[-1] == "fri: quality bad, state monitor"
        slots, data = mirror.world.slots, mirror.data.userdata
        assert data[slots["moment.vector"]].tolist() == [1, 2, 3]
        assert data[slots["commanded.joint_angles"]] == pytest.approx([0.1] * 7)
