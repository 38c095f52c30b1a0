"""`ConnectingSource`: the common base of sources that connect to a robot's controller by TCP.

They connect again and again, survive whatever the controller says, and tell it in words.
"""

from __future__ import annotations

import os
import selectors
import socket
import time as clock
from abc import abstractmethod
from contextlib import suppress
from typing import ClassVar, Self

from pydantic import Field, PrivateAttr, field_validator

from ...base.errors import Problem
from .source import ReceivingThread, Source, log

PATIENCE = 2.0  # s for an answer, or for the next packet
SHORTEST, LONGEST = 0.1, 5.0  # s between attempts to connect
_MOST_KEPT = 2048  # bytes of what is no message
_MOST_TOLD = 100  # different texts


class ClosedHere(Exception):
    """The source is being closed."""


class Nonsense(Exception):
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

    host: str
    port: int = Field(ge=1, le=65535)

    # The kind of its link as it is shown to the user.
    _link: ClassVar[str] = ""
    _if_refused: ClassVar[str] = ""  # what to do about it
    _thread: ReceivingThread | None = PrivateAttr(None)
    _trouble: str = PrivateAttr("")
    _told: set[str] = PrivateAttr(default_factory=set)
    _state: str = PrivateAttr("")  # of the connection, for people

    @field_validator("host")
    @classmethod
    def _host_is_an_address(cls, host: str) -> str:
        if not host or any(character.isspace() for character in host):
            raise Problem(found=host, expected="an address such as 192.168.0.3").error()
        return host

    @property
    def about(self) -> str:
        """Kind and address, as shown to the user."""
        state = f", {self._state}" if self._state else ""
        return f"{self._link} of {self.host}:{self.port}{state}"

    @property
    def trouble(self) -> str:
        """Why no packets arrive, as shown to the user; empty when unknown."""
        return self._trouble

    def open(self) -> None:
        """Starts the thread that connects; the controller need not be there."""
        self.close()
        self.reset()
        self._trouble = self._state = ""
        self._told = set()
        self._thread = ReceivingThread(f"{self._link} {self.name}", self._receive)

    def close(self) -> None:
        """Ends the connection; harmless when it is not open."""
        if self._thread is not None:
            self.closing.set()
            self._thread.end()
        self._thread = None

    @abstractmethod
    def _converse(self, wake: socket.socket) -> None:
        """Connects, and receives until the connection ends, by one of these errors.

        Raises:
            OSError: it cannot be made, or is lost.
            ClosedHere: `wake` can be read.
            Nonsense: the peer is no such controller, or refuses.
        """

    def _receive(self, wake: socket.socket) -> None:
        """Connects again and again, until it is closed."""
        pause = SHORTEST
        while not self.closing.is_set():
            good = self.receive_trigger
            try:
                self._converse(wake)
            except ClosedHere:
                break
            except Nonsense as error:
                self._end(f"{self.host}:{self.port} {error}")
                if raw := error.received[:_MOST_KEPT]:
                    self.accept([raw + b"\0" * (len(raw) == self.size)])
            except ConnectionRefusedError as error:
                self._end(f"{self.host}:{self.port}: {error.strerror}{self._if_refused}")
            except OSError as error:
                self._end(f"{self.host}:{self.port}: {error.strerror or error}")
            except UnicodeError:  # of names that no resolver is asked for
                self._end(f"{self.host}:{self.port}: not an address")
            if self.receive_trigger > good:
                pause = SHORTEST
            self.closing.wait(pause)
            pause = min(2.0 * pause, LONGEST)

    def _begin(self, state: str) -> None:
        """Notes that packets come from here on; `state` is that of the connection."""
        if self.receive_trigger:
            self.intake.restart()
        self._trouble, self._state = "", state

    def _end(self, trouble: str) -> None:
        self._trouble, self._state = trouble, ""
        self._tell(f"{trouble}; it is tried again")

    def _tell(self, text: str) -> None:
        """Logs something once."""
        if self.debug_level >= 1 and text not in self._told and len(self._told) < _MOST_TOLD:
            self._told.add(text)
            log.warning("source '%s': %s", self.name, text)


class Connection:
    """A connection by TCP, which ends when `wake` can be read.

    Raises:
        OSError: it cannot be made, or is lost, in any method.
        ClosedHere: likewise.
    """

    def __init__(self, host: str, port: int, wake: socket.socket) -> None:
        self._wake = wake
        self._selector = selectors.DefaultSelector()
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self.socket = socket.socket(family, kind)
        try:
            self._selector.register(wake, selectors.EVENT_READ)
            self.socket.setblocking(False)
            self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with suppress(BlockingIOError):
                self.socket.connect(address)
            self._selector.register(self.socket, selectors.EVENT_WRITE)
            self.wait(clock.monotonic() + PATIENCE, "does not answer")
            if error := self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                raise OSError(error, os.strerror(error))
            self._selector.modify(self.socket, selectors.EVENT_READ)
        except BaseException:
            self.__exit__()
            raise

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
            else_what: what is wrong when none is by then.
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
