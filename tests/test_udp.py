"""`UdpReceiver` on real sockets, with senders in this process and in others."""

from __future__ import annotations

import contextlib
import errno
import gc
import math
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from polling import until

from sero_mj.base.errors import SeroError, SourceError
from sero_mj.data.receive.intake import Counters, Intake
from sero_mj.data.receive.mailbox import Packet
from sero_mj.data.receive.udp import UdpReceiver

LINUX = sys.platform == "linux"

# A separate process with its own encoder: packets 1 to COUNT, in which every value is the number
# of the packet.
ROBOT = """
import socket, struct, sys, time
port, count, values = map(int, sys.argv[1:])
sock = socket.socket(type=socket.SOCK_DGRAM)
for k in range(1, count + 1):
    sock.sendto(struct.pack(f"<{values}d", *[float(k)] * values), ("127.0.0.1", port))
    time.sleep(1e-4)  # as a robot, not at the maximum rate
"""


def threads_of(name: str) -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == f"udp {name}"]


def doubles(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}d", *values)


def values_of(packet: Packet | None, event: str = "values0") -> list[float]:
    assert packet is not None
    return packet.values[event].tolist()


Send = Callable[[UdpReceiver, bytes], object]


def settle(receiver: UdpReceiver, send: Send, length: int = 1) -> bool:
    """Sends a packet of a wrong length and waits until the receiver reports it.

    Packets are checked in order, so all earlier packets have been checked then.
    """
    send(receiver, bytes(length))
    fault = f"{length} bytes; expected {receiver.size}"
    return until(lambda: receiver.counters.last_fault == fault)


@pytest.fixture
def sender() -> Iterator[Send]:
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        yield lambda receiver, packet: sock.sendto(packet, ("127.0.0.1", receiver.port))


def test_packet_is_received_unchanged(sender: Send) -> None:
    with UdpReceiver(structure="2F1F") as receiver:
        assert receiver.latest() is None
        assert not receiver.wait(0.0)
        before = time.monotonic()
        sender(receiver, doubles(1.5, -2.5, 5e-324))
        assert receiver.wait(5.0)
        assert values_of(packet := receiver.latest()) == [1.5, -2.5]
        assert values_of(packet, "values1") == [5e-324]
        assert packet.number == 1
        assert before <= packet.arrival <= time.monotonic()
        assert receiver.counters == Counters(received=1, senders=1)


def test_latest_packet_is_returned_and_older_ones_count_as_superseded(sender: Send) -> None:
    with UdpReceiver(structure="1F") as receiver:
        for k in range(1, 4):
            sender(receiver, doubles(k))
        assert settle(receiver, sender, 1)
        assert values_of(receiver.latest()) == [3.0]
        assert receiver.counters.superseded == 2
        assert receiver.latest() is receiver.latest()  # a second call supersedes nothing
        assert receiver.counters.superseded == 2
        sender(receiver, doubles(4.0))
        assert settle(receiver, sender, 2)
        assert values_of(receiver.latest()) == [4.0]
        counters = receiver.counters
        assert (counters.received, counters.malformed, counters.superseded) == (6, 2, 2)


def test_packets_of_another_process_arrive_complete_and_in_order(sender: Send) -> None:
    count = 1500
    # A buffer for all packets: dropped packets would weaken the test.
    with UdpReceiver(structure="7F7F", buffer_size=4_000_000) as receiver:
        command = [sys.executable, "-c", ROBOT, str(receiver.port), str(count), "14"]
        seen: list[int] = []

        def look() -> bool:
            packet = receiver.latest()
            if packet is not None:
                values = np.concatenate([packet.values["values0"], packet.values["values1"]])
                assert (values == values[0]).all(), "parts of two packets"
                if int(values[0]) not in seen[-1:]:
                    seen.append(int(values[0]))
            return seen[-1:] == [count]

        with subprocess.Popen(command) as robot:
            assert until(look, seconds=20.0)
        assert robot.returncode == 0
        assert len(seen) > 1
        assert seen == sorted(set(seen))
        assert settle(receiver, sender)
        # Every valid packet except the last one was either returned or superseded.
        assert receiver.counters.superseded == receiver.counters.received - 1 - len(seen)


@pytest.mark.parametrize(
    ("fault", "kind", "bad"),
    [
        ("0 bytes; expected 24", "wrong_size", b""),
        ("23 bytes; expected 24", "wrong_size", bytes(23)),
        ("25 bytes; expected 24", "wrong_size", bytes(25)),
        ("26 bytes; expected 24", "wrong_size", bytes(26)),
        ("65507 bytes; expected 24", "wrong_size", bytes(65_507)),
        ("values0[1] is nan", "not_finite", doubles(0, math.nan, 0)),
        ("values0[0] is inf", "not_finite", doubles(math.inf, 0, math.nan)),
        ("values1[0] is -inf", "not_finite", doubles(0, 0, -math.inf)),
        ("values0[0] is inf", "not_finite", doubles(math.inf, -math.inf, 0)),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_malformed_packet_is_counted_and_the_last_valid_one_remains(
    sender: Send, fault: str, kind: str, bad: bytes
) -> None:
    with UdpReceiver(structure="2F1F") as receiver:
        counters = receiver.counters
        sender(receiver, doubles(1, 2, 3))
        sender(receiver, bad)
        assert until(lambda: counters.last_fault, seconds=2.0)
        assert counters.last_fault == fault
        assert (counters.received, counters.malformed, getattr(counters, kind)) == (2, 1, 1)
        assert values_of(receiver.latest()) == [1.0, 2.0]
        assert values_of(receiver.latest(), "values1") == [3.0]
        # Reception continues, and malformed packets are not numbered.
        sender(receiver, doubles(4, 5, 6))
        assert settle(receiver, sender, 3)
        assert values_of(packet := receiver.latest()) == [4.0, 5.0]
        assert (packet.number, counters.superseded) == (2, 0)


def adds_up(receiver: UdpReceiver, send: Send, sent: int) -> bool:
    """Returns whether every packet was received or dropped; sends valid packets until it is known.

    Linux reports dropped packets only with the next packet.
    """
    counters = receiver.counters
    for total in range(sent + 1, sent + 26):
        send(receiver, bytes(receiver.layout.size))
        if until(lambda total=total: counters.received + counters.dropped == total, seconds=0.2):
            return True
    return False


@pytest.mark.skipif(not LINUX, reason="counts what the kernel drops")
def test_counters_add_up_after_a_flood_of_malformed_packets(sender: Send) -> None:
    with UdpReceiver(structure="3F") as receiver:
        for _ in range(20_000):
            sender(receiver, b"nonsense")
        assert adds_up(receiver, sender, 20_000)
        assert receiver.wait(1.0)
        assert receiver.counters.wrong_size > 0


@pytest.mark.skipif(not LINUX, reason="counts what the kernel drops")
@pytest.mark.parametrize("buffer_size", [1, 200_000])
def test_larger_receive_buffer_drops_fewer_packets(
    sender: Send, monkeypatch: pytest.MonkeyPatch, buffer_size: int
) -> None:
    take, go_on = Intake.take, threading.Event()

    def wait_and_take(self: Intake, *batch: Any) -> Any:
        go_on.wait(10.0)  # the thread waits until all packets are sent
        return take(self, *batch)

    monkeypatch.setattr(Intake, "take", wait_and_take)
    with UdpReceiver(structure="1F", buffer_size=buffer_size) as receiver:
        for k in range(100):
            sender(receiver, doubles(k))
        go_on.set()
        assert adds_up(receiver, sender, 100)
        dropped = receiver.counters.dropped
        assert dropped == 0 if buffer_size > 1 else dropped > 50


@pytest.mark.skipif(not LINUX, reason="127.0.0.2 is of this machine on Linux only")
def test_default_host_is_loopback() -> None:
    with UdpReceiver(structure="1F") as receiver, socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.2", receiver.port))  # free, because the receiver uses only 127.0.0.1
    everywhere = UdpReceiver(structure="1F", host="0.0.0.0")
    with everywhere, socket.socket(type=socket.SOCK_DGRAM) as sock, pytest.raises(OSError):
        sock.bind(("127.0.0.2", everywhere.port))


def test_port_in_use_is_reported_with_number_and_host() -> None:
    with UdpReceiver(structure="1F", name="first") as first:
        second = UdpReceiver(structure="1F", name="second", udpport=first.port)
        with pytest.raises(SourceError) as caught:
            second.open()
        assert str(caught.value) == (
            f"source 'second': UDP port {first.port} on 127.0.0.1 is in use by another program. "
            "Close it, or choose another port"
        )
        assert caught.value.source == "second"
        assert not threads_of("second")
        second.close()
        port = first.port
    with second:  # the port is free now
        assert second.port == port


@pytest.mark.parametrize("host", ["192.0.2.1", "no.such.host.invalid", "[::1]"])
def test_address_of_another_machine_is_reported(host: str) -> None:
    receiver = UdpReceiver(structure="1F", host=host, udpport=32123)
    with pytest.raises(SourceError) as caught:
        receiver.open()
    assert str(caught.value) == (
        f"source 'udp': UDP port 32123 on {host}: not an address of this machine; "
        "expected 127.0.0.1 or 0.0.0.0, for example"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"host": ""}, "host: found ''"),  # the system would use all interfaces
        ({"host": "a\0b"}, "not an address"),
        ({"host": "x" * 70}, "not an address"),
        ({"buffer_size": 2**31}, "buffer_size: found 2147483648"),  # beyond the range of setsockopt
    ],
)
def test_invalid_socket_options_are_rejected_without_a_leak(
    fields: dict[str, object], message: str
) -> None:
    with pytest.raises(SeroError, match=message), UdpReceiver(structure="1F", **fields):
        pass
    gc.collect()  # an open socket would cause a warning


def test_receiver_listens_on_ipv6() -> None:
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sock:
        try:
            sock.bind(("::1", 0))
        except OSError:
            pytest.skip("no IPv6 here")
        with UdpReceiver(structure="1F", host="::1") as receiver:
            sock.sendto(doubles(6.0), ("::1", receiver.port))
            assert receiver.wait(5.0)
            assert values_of(receiver.latest()) == [6.0]


def test_missing_ipv6_support_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    receiver = UdpReceiver(structure="1F", host="::1", port=32123)
    monkeypatch.setattr(socket, "socket", refuse)
    with raises_with(
        SourceError,
        source="udp",
        reason="UDP port 32123 on ::1: Address family not supported by protocol",
    ):
        receiver.open()


def test_close_ends_the_thread_and_frees_the_port() -> None:
    receiver = UdpReceiver(structure="1F", name="closing")
    receiver.close()  # has no effect before open
    receiver.open()
    port = receiver.port
    assert len(threads_of("closing")) == 1
    receiver.close()
    assert not threads_of("closing")
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", port))
    receiver.close()


def test_close_returns_during_an_uninterrupted_stream(
    sender: Send, monkeypatch: pytest.MonkeyPatch
) -> None:
    receiver = UdpReceiver(structure="1F", name="pouring")
    take, pouring = Intake.take, True

    def take_and_pour(self: Intake, rows: np.ndarray, *others: Any) -> Any:
        # The next packet arrives before this one is checked, so the socket is never empty.
        if pouring:
            sender(receiver, rows[0, :8].tobytes())
        return take(self, rows, *others)

    monkeypatch.setattr(Intake, "take", take_and_pour)
    receiver.open()
    sender(receiver, doubles(1.0))
    assert receiver.wait(5.0)
    (closing := threading.Thread(target=receiver.close, daemon=True)).start()
    closing.join(2.0)
    closed = not closing.is_alive()
    pouring = False  # otherwise, the thread would outlive the test
    closing.join()
    assert closed, "close() waits for a pause between packets"


def test_reopening_resets_packets_and_counters(sender: Send) -> None:
    receiver = UdpReceiver(structure="1F")
    for k in (1.0, 2.0):
        with receiver:
            assert receiver.latest() is None
            assert not receiver.wait(0.0)
            sender(receiver, doubles(0.0))
            sender(receiver, doubles(k))
            assert settle(receiver, sender)
            assert values_of(packet := receiver.latest()) == [k]
            counters = receiver.counters
            assert (packet.number, counters.superseded, counters.received) == (2, 1, 3)


def test_opening_an_open_receiver_leaks_no_thread() -> None:
    receiver = UdpReceiver(structure="1F", name="twice")
    receiver.open()
    with contextlib.suppress(SourceError):
        receiver.open()
    receiver.close()
    assert not threads_of("twice")
    gc.collect()  # an open socket would cause a warning
