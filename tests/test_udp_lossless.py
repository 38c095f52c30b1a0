"""`UdpReceiver` without losses, and with sequence numbers and time stamps."""

from __future__ import annotations

import logging
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from polling import until

from sero_mj.base.errors import DeclarationError
from sero_mj.data.receive import mailbox
from sero_mj.data.receive.udp import UdpReceiver

LINUX = sys.platform == "linux"
NUMBERED = "number:1H 1F"
# A separate process that sends COUNT numbered packets at about the maximum rate of the reader.
FLOOD = """
import socket, struct, sys, time
port, count = map(int, sys.argv[1:])
sock = socket.socket(type=socket.SOCK_DGRAM)
for k in range(count):
    sock.sendto(struct.pack("<Id", k, k / 1000), ("127.0.0.1", port))
    if k % 50 == 0:
        time.sleep(5e-4)
"""

Send = Callable[..., None]


@pytest.fixture
def send() -> Iterator[Send]:
    """Sends numbered packets whose value is their number."""
    with socket.socket(type=socket.SOCK_DGRAM) as sock:

        def numbered(receiver: UdpReceiver, *numbers: int) -> None:
            for number in numbers:
                packet = struct.pack("<Hd", number % 65536, number)
                sock.sendto(packet, ("127.0.0.1", receiver.port))

        yield numbered


def numbers_of(receiver: UdpReceiver) -> list[float]:
    packets = receiver.take()
    return [] if packets is None else packets.values["values0"][:, 0].tolist()


def settled(receiver: UdpReceiver, received: int) -> bool:
    return until(lambda: receiver.counters.received == received)


def test_arrivals_are_ordered_when_the_wall_clock_is_set(
    send: Send, monkeypatch: pytest.MonkeyPatch
) -> None:
    with UdpReceiver(structure=NUMBERED, only_latest_packet=False) as receiver:
        arrivals = []
        wall = time.time_ns
        for ahead in (0, 1_000_000_000, -1_000_000_000):
            monkeypatch.setattr(time, "time_ns", lambda ahead=ahead: wall() + ahead)
            send(receiver, *range(3))
            assert settled(receiver, len(arrivals) + 3)
            packets = receiver.take()
            assert packets is not None
            arrivals += packets.arrivals.tolist()
        assert np.all(np.diff(arrivals) >= 0.0)


@pytest.mark.slow
@pytest.mark.skipif(not LINUX, reason="counts what the kernel drops")
def test_lossless_receiver_returns_all_packets_in_order() -> None:
    count = 30_000
    receiver = UdpReceiver(
        structure="number:1I time:1F", only_latest_packet=False, sequence="number", time="time"
    )
    taken: list[np.ndarray] = []

    def collect() -> bool:
        packets = receiver.take()
        if packets is not None:
            assert len(packets) == len(packets.values["number"])
            assert (np.diff(packets.arrivals) >= 0).all()
            taken.append(packets.values["number"][:, 0])
        return sum(map(len, taken)) + receiver.counters.dropped >= count

    with receiver:
        command = [sys.executable, "-c", FLOOD, str(receiver.port), str(count)]
        with subprocess.Popen(command) as robot:
            assert until(collect, seconds=60.0)
        assert robot.returncode == 0
        got = np.concatenate(taken)
        assert (np.diff(got) > 0).all()
        assert len(got) == count - receiver.counters.dropped
        assert receiver.counters.dropped == 0  # with the default buffer
        assert receiver.counters.superseded == receiver.counters.lost == 0
        assert receiver.receive_trigger == count


def test_take_returns_each_packet_once(send: Send) -> None:
    for lossless, expected in ((True, [1.0, 2.0, 3.0]), (False, [3.0])):
        with UdpReceiver(structure=NUMBERED, only_latest_packet=not lossless) as receiver:
            assert receiver.take() is None
            send(receiver, 1, 2, 3)
            assert settled(receiver, 3)
            assert receiver.latest().values["values0"].tolist() == [3.0]  # `latest` takes nothing
            assert numbers_of(receiver) == expected
            assert receiver.take() is None
            assert receiver.counters.superseded == (0 if lossless else 2)
            send(receiver, 4)
            assert settled(receiver, 4)
            packets = receiver.take()
            assert packets is not None
            assert (packets.number, packets.last.number) == (4, 4)
            assert packets.last.values["values0"].tolist() == [4.0]


def test_full_queue_pauses_reception_and_drops_nothing(
    send: Send, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mailbox, "QUEUE_BYTES", 100)  # ten packets
    with UdpReceiver(structure=NUMBERED, only_latest_packet=False) as receiver:
        got: list[float] = []
        for k in range(0, 300, 10):
            send(receiver, *range(k, k + 10))
            assert until(lambda k=k: receiver.counters.received > min(k, 10))
        assert until(lambda: bool(got.extend(numbers_of(receiver)) or len(got) == 300))
        assert got == list(range(300))


def test_close_does_not_wait_for_a_consumer(send: Send, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mailbox, "QUEUE_BYTES", 0)
    receiver = UdpReceiver(structure=NUMBERED, only_latest_packet=False)
    receiver.open()
    send(receiver, 1)
    assert receiver.wait(5.0)
    send(receiver, 2)
    (closing := threading.Thread(target=receiver.close, daemon=True)).start()
    closing.join(5.0)
    assert not closing.is_alive()


@pytest.mark.parametrize("start", [5, 65_530])  # the second one wraps to 0
def test_sequence_numbers_show_lost_late_and_duplicate_packets(send: Send, start: int) -> None:
    with UdpReceiver(structure=NUMBERED, sequence="number", only_latest_packet=False) as receiver:
        offsets = [0, 1, 2, 5, 6, 4, 6, 7, 20]
        send(receiver, *(start + offset for offset in offsets))
        assert settled(receiver, len(offsets))
        counters = receiver.counters
        assert (counters.lost, counters.late, counters.duplicates) == (1 + 12, 1, 1)
        assert counters.restarts == 0
        # All delivered packets are returned, except duplicates.
        assert numbers_of(receiver) == [start + k for k in (0, 1, 2, 5, 6, 4, 7, 20)]


def test_latest_packet_has_the_highest_sequence_number(send: Send) -> None:
    with UdpReceiver(structure=NUMBERED, sequence="number") as receiver:
        send(receiver, 1, 2, 5, 4, 3)
        assert settled(receiver, 5)
        assert numbers_of(receiver) == [5.0]
        assert receiver.counters.late == 2


@pytest.mark.parametrize("numbers", [(1000, 1001, 0, 1, 2), (10, 11, 0, 1, 2, 3, 4, 5)])
def test_restarted_sender_is_detected_and_accepted(send: Send, numbers: tuple[int, ...]) -> None:
    with UdpReceiver(structure=NUMBERED, sequence="number") as receiver:
        send(receiver, *numbers)
        assert settled(receiver, len(numbers))
        assert receiver.counters.restarts == 1
        assert numbers_of(receiver) == [numbers[-1]]


def test_time_stamps_show_jitter_and_restarts() -> None:
    receiver = UdpReceiver(structure="t:1Q", time="t", time_scale=1e-6)
    with receiver, socket.socket(type=socket.SOCK_DGRAM) as sock:
        for stamp in (10_000_000, 10_000_000, 9_990_000, 10_001_000, 5, 1005):
            sock.sendto(struct.pack("<Q", stamp), ("127.0.0.1", receiver.port))
        assert settled(receiver, 6)
        counters = receiver.counters
        assert (counters.late, counters.restarts, counters.duplicates) == (1, 1, 0)
        assert receiver.timing.jitter > 0
        assert receiver.timing.rate > 0
        assert receiver.latest().values["t"].tolist() == [1005.0]


def test_receiving_is_true_while_packets_arrive(send: Send) -> None:
    called = threading.Event()
    with UdpReceiver(structure=NUMBERED) as receiver:
        receiver.on_receive(called.set)
        assert not receiver.receiving
        assert receiver.receive_trigger == 0
        send(receiver, 1)
        assert called.wait(5.0)
        assert receiver.receiving
        assert receiver.receive_trigger == 1
        assert until(lambda: not receiver.receiving, seconds=2.0)
        assert time.monotonic() - receiver.latest().arrival > 0.5


@pytest.mark.parametrize(
    ("level", "expected"),
    [
        (0, []),
        (1, ["a packet is not applied: 1 bytes; expected 10"]),
        (2, ["listening on", "a packet is not applied: 1 bytes", "3 packets lost"]),
        (3, ["listening on", "a packet is not applied: 1 bytes", "1 valid packets",
             "3 packets lost", "1 valid packets"]),
    ],
)  # fmt: skip
def test_debug_level_selects_log_messages(
    send: Send, caplog: pytest.LogCaptureFixture, level: int, expected: list[str]
) -> None:
    caplog.set_level(logging.INFO)
    with UdpReceiver(structure=NUMBERED, sequence="number", debug_level=level) as receiver:
        with socket.socket(type=socket.SOCK_DGRAM) as sock:
            for k in range(3):  # repeated faults are logged once
                sock.sendto(b"x", ("127.0.0.1", receiver.port))
                assert settled(receiver, k + 1)
        send(receiver, 1)
        assert settled(receiver, 4)
        send(receiver, 5)
        assert settled(receiver, 5)
    reported = [text for text in caplog.messages if "0 valid" not in text]
    assert len(reported) == len(expected), reported
    for text, part in zip(reported, expected, strict=True):
        assert text.startswith("source 'udp': ") and part in text


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"sequence": "numbr"}, "sequence: no event 'numbr' in the structure; did you mean 'nu"),
        ({"sequence": "joints"}, "sequence: 'joints' has 7 numbers; expected one, as in joints:1I"),
        ({"time": "values7"}, "time: no event 'values7' in the structure; available: joints, nu"),
        ({"alignment": 3}, "alignment: found 3"),
        ({"scale": 0}, "scale: found 0"),
        ({"debug_level": 4}, "debug_level: found 4"),
        ({"time_scale": -1}, "time_scale: found -1"),
        ({"only_latest": True}, "only_latest: unknown key; did you mean 'only_latest_packet'?"),
    ],
)
def test_invalid_declarations_are_reported(fields: dict[str, object], message: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        UdpReceiver(structure="number:1I joints:7F", **fields)
    assert str(caught.value).startswith(message)
