"""TCP clients: sources that connect to a server, and reconnect when the connection is lost."""

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

from ...base.errors import mismatch
from .receiving_thread import Closing, Disconnected
from .source import Source

PATIENCE = 2.0  # timeout in s for an answer and for the next packet
_MAX_REJECTED_BYTES = 2048  # bytes of a malformed message that are recorded


def is_address(expected: str) -> Callable[[str], str]:
    """Returns a validator of host names and addresses, which `expected` describes in errors."""

    def validate(host: str) -> str:
        if not host or any(character.isspace() for character in host):
            raise mismatch(host, expected)
        return host

    return validate


Address = Annotated[str, AfterValidator(is_address("an address such as 192.168.0.3"))]


class ProtocolError(Exception):
    """Raised if the peer violates the protocol or refuses the connection.

    Args:
        received: malformed message, which is counted and recorded; may be empty.
    """

    def __init__(self, text: str, received: bytes = b"") -> None:
        super().__init__(text)
        self.received = received


class ConnectingSource(Source):
    """Base class of sources that connect to a TCP server, and reconnect when necessary.

    A subclass sets `protocol`, the displayed name of its protocol, and implements `converse`.

    Attributes:
        host: address of the server.
        port: port of the server.
    """

    host: Address
    port: int = Field(ge=1, le=65535)

    protocol: ClassVar[str] = "TCP"
    if_refused: ClassVar[str] = ""  # hint that follows the error of a refused connection
    _state: str = PrivateAttr("")  # displayed state of the connection

    @property
    def about(self) -> str:
        state = f", {self._state}" if self._state else ""
        return f"{self.protocol} of {self.host}:{self.port}{state}"

    def open(self) -> None:
        self.close()
        self.reset()
        self._state = ""
        self.start_receiving(self._receive, name=f"{self.protocol} {self.name}")

    def close(self) -> None:
        self.stop_receiving()

    @abstractmethod
    def converse(self, wake: socket.socket) -> None:
        """Connects with a `Connection`, calls `note_connected`, and receives until an exception.

        Args:
            wake: socket that becomes readable when the source is being closed.

        Raises:
            OSError: the connection cannot be established or is lost.
            Closing: the source is being closed.
            ProtocolError: the peer violates the protocol or refuses the connection.
        """

    def _receive(self, wake: socket.socket) -> None:
        place = f"{self.host}:{self.port}"
        try:
            self.converse(wake)
        except ProtocolError as error:
            if raw := error.received[:_MAX_REJECTED_BYTES]:
                self.reject(raw, str(error))
            raise Disconnected(f"{place}: {error}") from error
        except ConnectionRefusedError as error:
            raise Disconnected(f"{place}: {error.strerror}{self.if_refused}") from error
        except OSError as error:
            raise Disconnected(f"{place}: {error.strerror or error}") from error
        finally:
            self._state = ""

    def note_connected(self, state: str = "") -> None:
        """Clears `trouble`, sets the displayed connection state, and counts a reconnection."""
        if self.receive_trigger:
            self.intake.restart()
        self.note_trouble("")
        self._state = state


def connect(host: str, port: int, wake: socket.socket) -> socket.socket:
    """Connects a non-blocking socket to the first address of a host that accepts, and returns it.

    Raises:
        OSError: no address accepts within `PATIENCE`, or the host name is unknown.
        Closing: `wake` is readable.
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
                raise TimeoutError(errno.ETIMEDOUT, "the peer does not answer")
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
    """Returns the addresses of a host like `socket.getaddrinfo`; raises OSError or Closing.

    Names are resolved in a thread, because this may take long and cannot be interrupted.
    """
    with suppress(ValueError):
        ipaddress.ip_address(host.partition("%")[0])
        return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    found: list[tuple[Any, ...]] = []
    failures: list[Exception] = []
    here, there = socket.socketpair()

    def look_up() -> None:
        with there:  # closing it makes `here` readable
            try:
                found.extend(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
            except UnicodeError:  # the name is invalid
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
    with selectors.DefaultSelector() as selector:
        selector.register(wake, selectors.EVENT_READ)
        selector.register(sock, event)
        ready = [key.fileobj for key, _ in selector.select(timeout)]
    if wake in ready:
        raise Closing
    return sock in ready


class Connection:
    """A TCP connection. Its methods raise OSError, or Closing as soon as `wake` is readable."""

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
        """Adds a socket for which `wait` also waits."""
        self._selector.register(other, selectors.EVENT_READ)

    def wait(self, deadline: float | None = None, else_what: str = "") -> list[object]:
        """Waits until sockets are readable, and returns them.

        Args:
            deadline: time at which `wait` raises TimeoutError, on the clock of `time.monotonic`;
                None for no limit.
            else_what: message of the TimeoutError.
        """
        timeout = None if deadline is None else max(deadline - clock.monotonic(), 0.0)
        found: list[object] = [key.fileobj for key, _ in self._selector.select(timeout)]
        if self._wake in found:
            raise Closing
        if not found:
            raise TimeoutError(else_what)
        return found

    def read(self) -> bytes:
        """Reads the available bytes, at least one."""
        received = self.socket.recv(65536)
        if not received:
            raise ConnectionError("the peer closed the connection")
        return received
