"""Connections by TCP to robots' controllers and to servers, made again when they are lost.

`connect` tries all addresses of a name; `ConnectingSource` is the base of the sources that speak a
protocol of a controller over it.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import selectors
import socket
import threading
import time as clock
from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Annotated, Any, ClassVar, Self

from pydantic import AfterValidator, Field, PrivateAttr

from ...base.errors import (
    mismatch,
)
from .receiving_thread import ClosedHere, Disconnected
from .source import Source

PATIENCE = 2.0  # s for an answer, or for the next packet
_MOST_KEPT = 2048  # bytes of what is no message


def is_address(expected: str) -> Callable[[str], str]:
    """Returns a validator of the address or name of a machine.

    Args:
        expected: for the error, such as `an address such as 127.0.0.1`.
    """

    def validate(host: str) -> str:
        if not host or any(character.isspace() for character in host):
            raise mismatch(host, expected)
        return host

    return validate


Address = Annotated[str, AfterValidator(is_address("an address such as 192.168.0.3"))]


class ProtocolError(Exception):
    """The peer sent what is not of its protocol, or refuses.

    Attributes:
        received: the bytes at fault; may be empty.
    """

    def __init__(self, text: str, received: bytes = b"") -> None:
        super().__init__(text)
        self.received = received


class ConnectingSource(Source):
    """A source that connects to a controller, and again when the connection is lost.

    Attributes:
        host: address of the controller.
        port: its port.
    """

    host: Address
    port: int = Field(ge=1, le=65535)

    # The kind of its link as it is shown to the user.
    _link: ClassVar[str] = ""
    _if_refused: ClassVar[str] = ""  # what to do about it
    _state: str = PrivateAttr("")  # of the connection, for people

    @property
    def about(self) -> str:
        state = f", {self._state}" if self._state else ""
        return f"{self._link} of {self.host}:{self.port}{state}"

    def open(self) -> None:
        self.close()
        self.reset()
        self._state = ""
        self.start_receiving(self._receive, name=f"{self._link} {self.name}")

    def close(self) -> None:
        self.stop_receiving()

    @abstractmethod
    def _converse(self, wake: socket.socket) -> None:
        """Connects, and receives until the connection ends, by one of these errors.

        Raises:
            OSError: it cannot be made, or is lost.
            ClosedHere: `wake` can be read.
            ProtocolError: the peer is no such controller, or refuses.
        """

    def _receive(self, wake: socket.socket) -> None:
        place = f"{self.host}:{self.port}"
        try:
            self._converse(wake)
        except ProtocolError as error:
            if raw := error.received[:_MOST_KEPT]:
                self.accept([raw + b"\0" * (len(raw) == self.size)])
            raise Disconnected(f"{place} {error}") from error
        except ConnectionRefusedError as error:
            raise Disconnected(f"{place}: {error.strerror}{self._if_refused}") from error
        except OSError as error:
            raise Disconnected(f"{place}: {error.strerror or error}") from error
        finally:
            self._state = ""

    def _begin(self, state: str) -> None:
        """Notes that packets come from here on; `state` is that of the connection."""
        if self.receive_trigger:
            self.intake.restart()
        self._trouble, self._state = "", state


def connect(host: str, port: int, wake: socket.socket) -> socket.socket:
    """Connects to the first of a machine's addresses that accepts; the socket does not block.

    Raises:
        OSError: none accepts within `PATIENCE`, or the name is unknown.
        ClosedHere: `wake` can be read.
    """
    failure = OSError("no address")
    for family, kind, _, _, address in addresses(host, port, wake):
        sock = None
        try:
            sock = socket.socket(family, kind)
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with suppress(BlockingIOError):
                sock.connect(address)
            if not _wait(wake, sock, selectors.EVENT_WRITE, PATIENCE):
                raise TimeoutError(errno.ETIMEDOUT, "does not answer")
            if number := sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                raise OSError(number, os.strerror(number))
        except BaseException as error:
            if sock is not None:
                sock.close()
            if not isinstance(error, OSError):
                raise
            failure = error
        else:
            return sock
    raise failure


def addresses(host: str, port: int, wake: socket.socket) -> list[tuple[Any, ...]]:
    """All addresses of a machine, as of `socket.getaddrinfo`; raises OSError or ClosedHere.

    A name is looked up on another thread, since that can take long and cannot be interrupted.
    """
    with suppress(ValueError):
        ipaddress.ip_address(host.partition("%")[0])
        return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    found: list[tuple[Any, ...]] = []
    failures: list[Exception] = []
    here, there = socket.socketpair()

    def look_up() -> None:
        with there:  # `here` can be read once it is closed
            try:
                found.extend(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
            except UnicodeError:  # of names that no resolver is asked for
                failures.append(OSError("not an address"))
            except OSError as error:
                failures.append(error)

    with here:
        threading.Thread(target=look_up, name=f"address of {host}", daemon=True).start()
        _wait(wake, here, selectors.EVENT_READ, None)
    if failures:
        raise failures[0]
    return found


def _wait(wake: socket.socket, sock: socket.socket, event: int, timeout: float | None) -> bool:
    """Returns whether an event came within `timeout` s; raises ClosedHere if `wake` is readable."""
    with selectors.DefaultSelector() as selector:
        selector.register(wake, selectors.EVENT_READ)
        selector.register(sock, event)
        ready = [key.fileobj for key, _ in selector.select(timeout)]
    if wake in ready:
        raise ClosedHere
    return sock in ready


class Connection:
    """A connection by TCP, which ends when `wake` can be read; raises OSError or ClosedHere."""

    def __init__(self, host: str, port: int, wake: socket.socket) -> None:
        self._wake = wake
        self.socket = connect(host, port, wake)
        self._selector = selectors.DefaultSelector()
        self.watch(wake)
        self.watch(self.socket)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._selector.close()
        self.socket.close()

    def watch(self, other: socket.socket) -> None:
        """Lets `wait` wait for another socket as well."""
        self._selector.register(other, selectors.EVENT_READ)

    def wait(self, deadline: float, else_what: str) -> list[object]:
        """Waits until a socket is ready; returns those that are.

        Args:
            deadline: on the clock of `time.monotonic`, s.
        """
        ready = self._selector.select(max(deadline - clock.monotonic(), 0.0))
        found: list[object] = [key.fileobj for key, _ in ready]
        if self._wake in found:
            raise ClosedHere
        if not found:
            raise TimeoutError(else_what)
        return found

    def read(self) -> bytes:
        """What has come; at least one byte."""
        more = self.socket.recv(65536)
        if not more:
            raise ConnectionError("it closed the connection")
        return more
