"""Reception survives every exception: the source reports it, counts it, and receives again."""

from __future__ import annotations

import logging
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from polling import until
from shm_tools import make, remove
from source_slots import get_source

from sero_mj import Mirror, Scene, SerialRobot, ShmReader, UdpReceiver
from sero_mj.base.errors import SourceError
from sero_mj.data.receive import receiving_thread
from sero_mj.data.receive.report import describe, report
from sero_mj.data.receive.source import Source
from sero_mj.viewer.decor.staleness import Staleness
from sero_mj.viewer.session.clock import Clock
from sero_mj.viewer.session.status_line import status_pieces

Send = Callable[[float], None]


class Broken(Exception):
    """An exception that a callback or recorder may raise."""


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(receiving_thread, "MIN_PAUSE", 0.002)
    monkeypatch.setattr(receiving_thread, "MAX_PAUSE", 0.02)


@contextmanager
def udp() -> Iterator[tuple[Source, Send]]:
    with (
        UdpReceiver(structure="1F", udpport=0) as source,
        socket.socket(type=socket.SOCK_DGRAM) as sender,
    ):
        port = source.port
        yield source, lambda number: _sent(sender, port, number)


def _sent(sender: socket.socket, port: int, number: float) -> None:
    sender.sendto(np.array([number], "<f8").tobytes(), ("127.0.0.1", port))


@contextmanager
def shm() -> Iterator[tuple[Source, Send]]:
    name = f"sero-mj-test-{os.getpid()}-{threading.get_ident()}"
    block = make(name, bytes(16))
    counts = iter(range(2, 1000, 2))
    try:
        with ShmReader(block=name, structure="lock:1Q 1F", lock="lock") as source:

            def write(number: float) -> None:
                lock = np.array([next(counts)], "<u8").tobytes()
                block.write(lock + np.array([number], "<f8").tobytes())

            yield source, write
    finally:
        remove(block)


@pytest.fixture(params=[udp, shm])
def received(request: pytest.FixtureRequest) -> Iterator[tuple[Source, Send]]:
    with request.param() as found:
        yield found


def first_value(source: Source) -> float | None:
    packet = source.latest()
    return None if packet is None else float(packet.values["values0"][0])


def failing(times: int, error: BaseException) -> Callable[..., None]:
    """Returns a function that raises `count` times and then no more."""
    left = [error] * times

    def fail(*_: object) -> None:
        if left:
            raise left.pop()

    return fail


def test_failing_callback_is_reported_and_reception_continues(
    received: tuple[Source, Send], caplog: pytest.LogCaptureFixture
) -> None:
    source, send = received
    called = threading.Event()
    source.on_receive(failing(1, KeyError("mine")))
    source.on_receive(called.set)
    send(1.0)
    assert until(lambda: source.error)
    assert called.wait(5.0)  # the other callback is not affected
    assert isinstance(source.error, SourceError)
    assert isinstance(source.error.__cause__, KeyError)
    assert "KeyError: 'mine'" in source.error.reason
    assert (source.counters.failures, first_value(source)) == (1, 1.0)
    assert until(lambda: "Traceback" in caplog.text)  # names the failing line
    send(2.0)
    assert until(lambda: first_value(source) == 2.0 and source.error is None)
    assert source.counters.failures == 1


@pytest.mark.parametrize("error", [Broken("disk"), SystemExit(1)])
def test_failed_reception_restarts(received: tuple[Source, Send], error: BaseException) -> None:
    source, send = received
    source.record_to(failing(3, error))
    for k in range(3):
        send(float(k))
        assert until(lambda k=k: source.counters.failures == k + 1)
        assert type(error).__name__ in str(source.error)
        source.latest()  # for shared memory, this reads the block on this thread
    send(7.0)
    assert until(lambda: first_value(source) == 7.0 and source.error is None)
    assert source.receiving


def test_socket_error_does_not_end_reception(monkeypatch: pytest.MonkeyPatch) -> None:
    from sero_mj.data.receive.udp_socket import Datagrams

    read, left = Datagrams.read, [OSError(100, "Network is down")] * 2

    def down(datagrams: Datagrams) -> int:
        if left:
            raise left.pop()
        return read(datagrams)

    monkeypatch.setattr(Datagrams, "read", down)
    with udp() as (source, send):
        assert until(lambda: source.counters.failures == 2)
        assert "Network is down" in str(source.error)
        send(3.0)
        assert until(lambda: first_value(source) == 3.0)
        assert source.error is None


def test_closing_does_not_wait_for_the_next_attempt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(receiving_thread, "MIN_PAUSE", 1000.0)  # s; longer than the test
    with udp() as (source, send):
        source.record_to(failing(1, Broken()))
        send(1.0)
        assert until(lambda: source.counters.failures)
    names = [thread.name for thread in threading.enumerate()]
    assert "udp udp" not in names


def test_pause_doubles_until_packets_arrive(monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[float] = []
    with udp() as (source, send):
        wait = source.closing.wait

        def noted(timeout: float | None = None) -> bool:
            pauses.append(timeout or 0.0)
            return wait(0.001)

        monkeypatch.setattr(source.closing, "wait", noted)
        source.record_to(failing(6, Broken()))
        for k in range(6):
            send(1.0)
            assert until(lambda k=k: source.counters.failures == k + 1)
        assert until(lambda: len(pauses) == 6)
        assert pauses == [0.002, 0.004, 0.008, 0.016, 0.02, 0.02]
        send(2.0)
        assert until(lambda: first_value(source) == 2.0)
        source.record_to(failing(1, Broken()))
        send(3.0)
        assert until(lambda: len(pauses) == 7)
        assert pauses[-1] == 0.002


def test_failure_is_shown_at_the_robot_in_the_status_and_in_the_report() -> None:
    robot = SerialRobot.from_model("lwr")
    source = UdpReceiver(structure="7F", udpport=0)
    routes = {"lwr.joint_angles": "udp.values0"}
    scene = Scene(robots=[robot], sources={"udp": source}, routes=routes)
    with Mirror(scene) as mirror, socket.socket(type=socket.SOCK_DGRAM) as sender:
        live: Any = mirror.sources["udp"]
        live.record_to(failing(1, Broken("disk")))
        sender.sendto(bytes(56), ("127.0.0.1", live.port))
        assert until(lambda: live.error)
        mirror.advance()
        slot = get_source(mirror.data, mirror.world, "udp")
        assert (slot["failures"], slot["is_failing"]) == (1, 1)
        label = Staleness(mirror.world).find(mirror.data)["lwr"]
        assert label.endswith("reception failed")
        pieces = status_pieces(mirror.sources.values(), Clock(mirror), 60.0)
        assert ("udp: reception failed: Broken: disk", "bad") in pieces
        found = report(live)
        assert (found["failures"], found["error"]) == (1, "reception failed: Broken: disk")
        assert ("error", "", found["error"]) in describe(found)
        sender.sendto(bytes(56), ("127.0.0.1", live.port))
        assert until(mirror.advance)
        slot = get_source(mirror.data, mirror.world, "udp")
        assert slot["failures"] == 1
        assert "is_failing" not in slot
        assert report(live)["error"] == ""


def test_failing_log_handler_does_not_end_reception() -> None:
    class Full(logging.Handler):
        def handle(self, record: logging.LogRecord) -> bool:
            raise OSError("no space left")

    logger, handler = logging.getLogger("sero_mj.data.receive.source"), Full()
    logger.addHandler(handler)
    try:
        with udp() as (source, send):
            source.record_to(failing(1, Broken()))
            send(1.0)
            assert until(lambda: source.counters.failures == 1)
            send(2.0)
            assert until(lambda: first_value(source) == 2.0)
    finally:
        logger.removeHandler(handler)
