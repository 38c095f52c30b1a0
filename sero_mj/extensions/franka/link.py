"""`FciLink`: the sockets of a simulated robot for requests, states and commands of FCI."""

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
from .messages import HEAD, INCOMPATIBLE, MAX_BYTES, SUCCESS, Messages

log = logging.getLogger(__name__)

_SLICE = 0.02  # time between checks for the end of the program, s
_MAX_DATAGRAMS = 256  # maximum number of datagrams per step, so that a flood does not block steps
_KEEPALIVE = {"TCP_KEEPIDLE": 1, "TCP_KEEPINTVL": 1, "TCP_KEEPCNT": 3}  # as in libfranka
_CONNECT_TIMEOUT = 1.0  # time after which another client replaces one without a request, s


class Robot(Protocol):
    """The interface of a simulated robot that `FciLink` calls."""

    def request(self, name: str, number: int, values: tuple[Any, ...]) -> None:
        """Called with the name, id and values of a request from a connected client."""

    def connected(self) -> None:
        """Called when a client has connected."""

    def lost(self, why: str) -> None:
        """Called with a reason when the client has disconnected."""


class FciLink(Link):
    """A server that connects one FCI client at a time to a simulated robot, as a real robot does.

    Attributes:
        clients: number of clients that have connected so far.
        unexpected: number of datagrams from unexpected senders.
    """

    def __init__(self, declared: Reachable, robot: str, messages: Messages, owner: Robot) -> None:
        super().__init__(declared, robot, messages.command.size)
        self._messages, self._owner = messages, weakref.proxy(owner)
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._since = 0.0  # time at which the client has connected
        self._peer: tuple[str, int] | None = None  # UDP address to which states are sent
        self._received = bytearray()
        self._is_new = Once()
        self.port = declared.port
        self.clients = self.unexpected = 0

    @property
    def name(self) -> str:
        return f"{self._declared.host}:{self.port}"

    @property
    def is_connected(self) -> bool:
        return self._peer is not None

    def warn_once(self, text: str) -> None:
        if self._is_new(text):
            log.warning("%s: %s", self._robot, text)

    def open(self, time: float) -> None:
        """Starts to listen for clients, and starts the program if one is declared.

        Raises:
            DeclarationError: the program cannot be started.
            SimulationError: the address is not available.
        """
        declared = self._declared
        try:
            self._listener = socket.create_server((declared.host, declared.port))
            self._socket = socket.socket(type=socket.SOCK_DGRAM)
            self._socket.bind((declared.host, 0))
        except OSError as error:
            hint = "; use a different address for each robot, for example host = '127.0.0.2'"
            hint = hint if declared.port and self._listener is None else ""
            what = f"cannot listen on {self.name}: {error.strerror or error}{hint}"
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
        """Waits for the first client, starts the clock, and returns whether a client has connected.

        Raises:
            SimulationError: the program ended before a client connected.
        """
        while not self.clients and clock.monotonic() < self._given_up:
            self.serve(_SLICE)
            if not self.clients and self._program is not None and self._program.has_ended:
                what = f"{self._program.why()}; it has not connected to {self.name}"
                raise self.error(time, what)
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
        except OSError:  # the network is unavailable or overloaded
            return False
        return True

    def receive(self, take: Callable[[int], object]) -> None:
        if self._socket is None:
            return
        for _ in range(_MAX_DATAGRAMS):
            try:
                size, address = self._socket.recvfrom_into(self.buffer, 0, DONT_WAIT)
            except ConnectionError:  # on Windows if the port of a client is closed
                continue
            except OSError:
                return
            if address == self._peer:
                take(size)
            else:
                self.unexpected += 1

    def receive_until(self, time: float, step: int, take: Callable[[int], object]) -> None:
        due = self._due(time, step)
        while self.is_connected and self.answered != step:
            left = due - clock.monotonic()
            if left <= 0.0:
                return
            self.serve(left)
            self.receive(take)

    def share_core(self) -> None:
        """Moves a started program to the CPU core of the simulation, if this is declared."""
        self._share_core()

    # ---- requests

    def serve(self, seconds: float) -> None:
        """Waits for input for a maximum time in seconds, and handles requests."""
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
            self._disconnect(f"accepts no answer: {error.strerror or error}")

    def _accept(self) -> None:
        assert self._listener is not None
        try:
            client, address = self._listener.accept()
        except OSError:  # the client has disconnected
            return
        if self._client is not None:
            has_timed_out = (
                self._peer is None and clock.monotonic() > self._since + _CONNECT_TIMEOUT
            )
            if not has_timed_out:
                client.close()
                self.warn_once(f"another client of {self.name} is rejected: only one is allowed")
                return
            self._disconnect("has not sent a connection request")
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
            self._disconnect(f"lost its connection: {error.strerror or error}")
            return
        if not more:
            self._disconnect(f"disconnected{' within a message' if self._received else ''}")
            return
        self._received += more
        while self._client is not None and len(self._received) >= HEAD.size:
            command, number, size = HEAD.unpack_from(self._received)
            known = self._messages.requests.get(command)
            if known is None or not HEAD.size <= size <= MAX_BYTES:
                self._disconnect(f"sends an invalid request: {bytes(self._received[:16]).hex(' ')}")
                return
            name, structure = known
            if size != HEAD.size + structure.size:
                expected = HEAD.size + structure.size
                self._disconnect(f"sends {name} of {size} bytes; expected {expected} bytes")
                return
            if len(self._received) < size:
                return
            values = structure.unpack_from(self._received, HEAD.size)
            del self._received[:size]
            self._handle(name, number, values)

    def _handle(self, name: str, number: int, values: tuple[Any, ...]) -> None:
        if name != "Connect":
            if self._peer is None:
                self._disconnect(f"sends {name} before it has connected")
            else:
                self._owner.request(name, number, values)
            return
        version, port = values
        own = self._messages.version
        if version != own or not port:
            self.answer(name, number, INCOMPATIBLE, struct.pack("<H", own))
            expected = f"version = {version}" if version != own else "a UDP port"
            found = f"a client uses version {version}, but the robot uses {own}"
            self.warn_once(f"{found}; expected {expected}")
            return
        self.answer(name, number, SUCCESS, struct.pack("<H", own))
        if self._client is not None:
            self.clients += 1
            self._peer = self._address, port
            self._owner.connected()

    def _disconnect(self, why: str) -> None:
        if self._client is not None:
            self._client.close()
        was_connected = self._peer is not None
        self._client = self._peer = None
        self._received.clear()
        if was_connected:
            self._owner.lost(why)
        else:
            self.warn_once(f"a client of {self.name} {why}")
