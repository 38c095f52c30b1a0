"""TCP connections: all addresses of a name are tried, and closing does not wait for a name."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from polling import until

from sero_mj import FrankaReceiver, RtdeReceiver
from sero_mj.data.receive import connecting, receiving_thread
from sero_mj.data.receive.receiving_thread import Closing
from sero_mj.data.receive.source import RoutedJoint, Source
from sero_mj.extensions.ros.foxglove import Foxglove
from sero_mj.extensions.ros.zenoh import Zenoh

NAME = "robot.test"  # a top-level domain that no resolver knows
Found = list[tuple[Any, ...]]


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(receiving_thread, "MIN_PAUSE", 0.002)
    monkeypatch.setattr(receiving_thread, "MAX_PAUSE", 0.02)


def ros(kind: type[Source], **fields: Any) -> Source:
    source = kind(**fields)
    source.set_joints([RoutedJoint("joint")])
    return source


def made(kind: str, host: str, port: int) -> Source:
    makers: dict[str, Callable[..., Source]] = {
        "rtde": RtdeReceiver,
        "franka": FrankaReceiver,
        "foxglove": lambda **fields: ros(Foxglove, **fields),
        "zenoh": lambda **fields: ros(Zenoh, **fields),
    }
    return makers[kind](host=host, port=port)


KINDS = pytest.mark.parametrize("kind", ["rtde", "franka", "foxglove", "zenoh"])


@contextmanager
def listening() -> Iterator[tuple[int, threading.Event]]:
    """Yields a port of 127.0.0.1 only and an event that is set once someone connects."""
    came = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            while True:
                try:
                    client, _ = server.accept()
                except OSError:
                    return
                came.set()
                client.close()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        try:
            yield server.getsockname()[1], came
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join(5.0)


def resolve(monkeypatch: pytest.MonkeyPatch, look_up: Callable[[int], Found]) -> None:
    """Makes the resolver know one more name."""
    real = socket.getaddrinfo

    def known(host: Any, port: Any, *args: Any, **kwargs: Any) -> Any:
        return look_up(port) if host == NAME else real(host, port, *args, **kwargs)

    monkeypatch.setattr(socket, "getaddrinfo", known)


def two_addresses(port: int) -> Found:
    """Returns IPv6 first, as for `localhost` on Debian; nothing listens there."""
    of = (socket.SOCK_STREAM, socket.IPPROTO_TCP, "")
    return [
        (socket.AF_INET6, *of, ("::1", port, 0, 0)),
        (socket.AF_INET, *of, ("127.0.0.1", port)),
    ]


@KINDS
def test_controller_at_the_second_address_of_its_name_is_reached(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "zenoh":
        pytest.importorskip("zenoh")
    resolve(monkeypatch, two_addresses)
    with listening() as (port, came), made(kind, NAME, port):
        assert came.wait(20.0)


@KINDS
def test_closing_does_not_wait_for_a_name(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if kind == "zenoh":
        pytest.importorskip("zenoh")
    asked, answer = threading.Event(), threading.Event()

    def never(_: int) -> Found:
        asked.set()
        answer.wait()
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    resolve(monkeypatch, never)
    try:
        source = made(kind, NAME, 1)
        source.open()
        assert asked.wait(20.0)
        source.close()  # otherwise the test takes too long
    finally:
        answer.set()


def test_unknown_name_is_reported_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    tries = 0

    def unknown(_: int) -> Found:
        nonlocal tries
        tries += 1
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    resolve(monkeypatch, unknown)
    caplog.set_level(logging.WARNING)
    with made("rtde", NAME, 1) as source:
        assert until(lambda: tries > 3)
        assert source.trouble == f"{NAME}:1: Name or service not known"
        assert (source.error, source.counters.failures) == (None, 0)  # not an error of ours
    assert caplog.text.count("Name or service not known") == 1


def test_silent_address_is_skipped_for_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connecting, "PATIENCE", 0.05)
    with socket.socket() as full, listening() as (port, came):
        full.bind(("127.0.0.2", port))
        full.listen(0)
        fillers = []
        for _ in range(4):  # more than its backlog, so further connections get no answer
            fillers.append(socket.socket())
            fillers[-1].setblocking(False)
            fillers[-1].connect_ex(("127.0.0.2", port))
        of = (socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP, "")
        resolve(monkeypatch, lambda port: [(*of, ("127.0.0.2", port)), (*of, ("127.0.0.1", port))])
        here, there = socket.socketpair()
        with here, there, connecting.connect(NAME, port, here) as found:
            assert found.getpeername() == ("127.0.0.1", port)
        assert came.wait(5.0)
        for filler in fillers:
            filler.close()


def test_connecting_ends_when_it_is_woken() -> None:
    here, there = socket.socketpair()
    with here, there, listening() as (port, _):
        there.send(b"x")
        with pytest.raises(Closing):
            connecting.connect("127.0.0.1", port, here)
