"""`FciLink`: the sockets of a robot's FCI: requests by TCP, states and commands by UDP."""

from __future__ import annotations

import logging
import select
import socket
import struct
import time as clock
import weakref
from collections.abc import Callable
from typing import Any, Protocol

from ...base.once import Once
from ...simulate.external_control.program import PORT, Program
from ...simulate.external_control.program_controller import (
    DONT_WAIT,
    RECEIVE_BUFFER,
    Link,
    Reachable,
)
from .messages import HEAD, INCOMPATIBLE, MOST_BYTES, SUCCESS, Messages

log = logging.getLogger(__name__)

_SLICE = 0.02  # s, in which the end of the program is seen
_MOST_AT_ONCE = 256  # datagrams, so that a flood of strays does not keep the simulation
_KEEPALIVE = {"TCP_KEEPIDLE": 1, "TCP_KEEPINTVL": 1, "TCP_KEEPCNT": 3}  # as libfranka has them
_MUTE = 1.0  # s, after which a connection that asks for nothing gives way to another


class Host(Protocol):
    """What a link tells of: the robot."""

    def request(self, name: str, number: int, values: tuple[Any, ...]) -> None:
        """A connected client asks for something, see `franka_messages.REQUESTS`."""

    def connected(self) -> None:
        """A client has connected."""

    def lost(self, why: str) -> None:
        """The client is gone."""


class FciLink(Link):
    """Serves one client at a time, as the robot does.

    Attributes:
        clients: number of those that have connected so far.
    """

    def __init__(self, declared: Reachable, robot: str, messages: Messages, host: Host) -> None:
        super().__init__(declared, robot, messages.command.size)
        self._messages, self._host = messages, weakref.proxy(host)
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._since = 0.0  # when it has come
        self._peer: tuple[str, int] | None = None  # where states go to
        self._received = bytearray()
        self._is_new = Once()
        self.port = declared.port
        self.clients = self.foreign = 0

    @property
    def name(self) -> str:
        return f"{self._declared.host}:{self.port}"

    @property
    def is_connected(self) -> bool:
        return self._peer is not None

    def tell(self, text: str) -> None:
        if self._is_new(text):
            log.warning("%s: %s", self._robot, text)

    def open(self, time: float) -> None:
        """Listens, and starts the program, if it is to be.

        Args:
            time: s since the start.

        Raises:
            DeclarationError: the program cannot be started.
            SimulationError: the address cannot be listened at.
        """
        declared = self._declared
        try:
            self._listener = socket.create_server((declared.host, declared.port))
            self._socket = socket.socket(type=socket.SOCK_DGRAM)
            self._socket.bind((declared.host, 0))
        except OSError as error:
            more = "; a robot each has an address of its own, host = '127.0.0.2' say"
            taken = more if declared.port and self._listener is None else ""
            what = f"{self.name} cannot be listened at: {error.strerror or error}{taken}"
            raise self.error(time, what) from error
        for opened in (self._listener, self._socket):
            weakref.finalize(self, opened.close)
            opened.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self.port = int(self._listener.getsockname()[1])
        if declared.command:
            command = [part.replace(PORT, str(self.port)) for part in declared.command]
            self._program = Program(command, declared.folder)
        self._given_up = clock.monotonic() + declared.first_patience
        self._began = clock.monotonic() - time

    def wait_for_client(self, time: float) -> bool:
        """Waits for the first client, and lets time begin then; whether one has come.

        Args:
            time: s since the start.

        Raises:
            SimulationError: the program has ended before.
        """
        while not self.clients and clock.monotonic() < self._given_up:
            self.serve(_SLICE)
            if not self.clients and self._program is not None and self._program.has_ended:
                raise self.error(
                    time, f"{self._program.why()}; it has not connected to {self.name}"
                )
        self._began = clock.monotonic() - time
        return self.clients > 0

    def close(self) -> None:
        for opened in (self._client, self._listener):
            if opened is not None:
                opened.close()
        self._client = self._listener = self._peer = None
        super().close()

    def check(self, time: float) -> None:
        if self._program is not None and self._program.has_failed:
            raise self.error(time, self._program.why())

    # ---- states and commands

    def send(self, packet: bytes | bytearray) -> bool:
        if self._peer is None or self._socket is None:
            return False
        try:
            self._socket.sendto(packet, self._peer)
        except OSError:  # its network is gone, or takes no more
            return False
        return True

    def receive(self, take: Callable[[int], object]) -> None:
        if self._socket is None:
            return
        for _ in range(_MOST_AT_ONCE):
            try:
                size, address = self._socket.recvfrom_into(self.buffer, 0, DONT_WAIT)
            except ConnectionError:  # on Windows: a client's port is closed
                continue
            except OSError:
                return
            if address == self._peer:
                take(size)
            else:
                self.foreign += 1

    def receive_until(self, time: float, step: int, take: Callable[[int], object]) -> None:
        due = self._due(time, step)
        while self.is_connected and self.answered != step:
            left = due - clock.monotonic()
            if left <= 0.0:
                return
            self.serve(left)
            self.receive(take)

    def share_core(self) -> None:
        """Has a program that was started run on this core, where that is declared."""
        self._share_core()

    # ---- requests

    def serve(self, seconds: float) -> None:
        """Waits until something has come, at most so long, s, and handles requests."""
        sockets = [s for s in (self._client, self._listener, self._socket) if s is not None]
        if not sockets:
            return
        ready, _, _ = select.select(sockets, [], [], max(seconds, 0.0))
        if self._client in ready:
            self._read()
        if self._listener in ready:
            self._accept()

    def answer(self, request: str, number: int, status: int, more: bytes = b"") -> None:
        if self._client is None:
            return
        try:
            self._client.sendall(self._messages.answer(request, number, status, more))
        except OSError as error:
            self._drop(f"takes no answer: {error.strerror or error}")

    def _accept(self) -> None:
        assert self._listener is not None
        try:
            client, address = self._listener.accept()
        except OSError:  # it is gone again
            return
        if self._client is not None:
            is_mute = self._peer is None and clock.monotonic() > self._since + _MUTE
            if not is_mute:
                client.close()
                self.tell(f"another client of {self.name} is refused: there is one already")
                return
            self._drop("has not asked to connect")
        self._client, self._since = client, clock.monotonic()
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in _KEEPALIVE.items():
            if hasattr(socket, name):
                client.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
        self._address = str(address[0])

    def _read(self) -> None:
        assert self._client is not None
        try:
            more = self._client.recv(65536)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(f"is lost: {error.strerror or error}")
            return
        if not more:
            self._drop(f"has left{' within a message' if self._received else ''}")
            return
        self._received += more
        while self._client is not None and len(self._received) >= HEAD.size:
            command, number, size = HEAD.unpack_from(self._received)
            known = self._messages.requests.get(command)
            if known is None or not HEAD.size <= size <= MOST_BYTES:
                self._drop(f"says what is no request: {bytes(self._received[:16]).hex(' ')}")
                return
            name, structure = known
            if size != HEAD.size + structure.size:
                expected = HEAD.size + structure.size
                self._drop(f"sends {name} of {size} bytes; expected {expected}")
                return
            if len(self._received) < size:
                return
            values = structure.unpack_from(self._received, HEAD.size)
            del self._received[:size]
            self._handle(name, number, values)

    def _handle(self, name: str, number: int, values: tuple[Any, ...]) -> None:
        if name != "Connect":
            if self._peer is None:
                self._drop(f"asks for {name} before it has connected")
            else:
                self._host.request(name, number, values)
            return
        version, port = values
        own = self._messages.version
        if version != own or not port:
            self.answer(name, number, INCOMPATIBLE, struct.pack("<H", own))
            expected = f"version = {version}" if version != own else "a UDP port"
            self.tell(f"a client speaks version {version}, this is {own}; expected {expected}")
            return
        self.answer(name, number, SUCCESS, struct.pack("<H", own))
        if self._client is not None:
            self.clients += 1
            self._peer = self._address, port
            self._host.connected()

    def _drop(self, why: str) -> None:
        if self._client is not None:
            self._client.close()
        was_connected = self._peer is not None
        self._client = self._peer = None
        self._received.clear()
        if was_connected:
            self._host.lost(why)
        else:
            self.tell(f"a client of {self.name} {why}")
