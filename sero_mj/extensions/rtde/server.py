"""`RtdeServer`: the sockets of a simulated Universal Robots controller.

The thread of the simulation serves all clients. RTDE listens on TCP port 30004. Optionally, a
dashboard server (29999) answers the requests that clients send when they connect, and a server for
URScript (30003) accepts scripts without running them.
"""

from __future__ import annotations

import logging
import math
import selectors
import socket
import struct
import time as clock
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from ...base.once import Once
from ...data.receive.connecting import ProtocolError
from .receiver import (
    ASK_CONTROLLER,
    ASK_VERSION,
    DATA,
    HEAD,
    MAX_BYTES,
    PAUSE,
    SET_UP,
    SET_UP_INPUTS,
    START,
    TEXT,
    VERSION,
    split_messages,
)
from .variables import INPUTS, OUTPUTS, Recipe

log = logging.getLogger(__name__)

CONTROLLER_VERSION = 5, 23, 0, 0  # the first one with actual_current_as_torque
_KINDS = {ASK_VERSION, ASK_CONTROLLER, SET_UP, SET_UP_INPUTS, START, PAUSE, DATA, TEXT}
_MAX_PEERS, _MAX_RECIPES = 16, 255
_MAX_UNSENT = 1 << 18  # maximum number of bytes that a client may leave unread
# Time in s from the start to the first package. If a package arrives together with the answer to
# the start, UR's own client does not detect it before the next one, which lockstep never sends.
_START_DELAY = 0.02
_MAX_UNREAD_TIME = 10.0  # time in s without reading after which a client is disconnected
_WARNING = 2  # level of a text message
_SOURCE = b"sero-mj"


class Robot(Protocol):
    """The methods of a simulated robot that the RTDE server calls."""

    @property
    def is_running(self) -> bool:
        """Whether the robot's program is running."""

    def value(self, name: str) -> Any:
        """Returns the current value of an output: a number, or a vector of numbers."""

    def take(self, peer: RtdePeer, values: dict[str, Any]) -> bool:
        """Applies inputs and returns whether they answer the last package."""

    def reject(self, reason: str) -> None:
        """Counts a rejected message or command, and logs each reason once."""

    def take_script(self, text: bytes) -> None:
        """Called when a client has sent URScript, which starts a program on a real robot."""

    def stop_program(self) -> None:
        """Called when the dashboard server stops the robot's program."""


class Peer(ABC):
    """A connection from a client."""

    def __init__(self, server: RtdeServer, connection: socket.socket, name: str) -> None:
        self.server, self.name = server, name
        self.socket = connection
        self._unsent = bytearray()
        self._received = b""

    @abstractmethod
    def handle(self, received: bytes) -> bytes:
        """Handles received bytes and returns the incomplete rest. Raises ProtocolError."""

    def read(self) -> None:
        """Receives and handles bytes. Raises OSError or ProtocolError."""
        more = self.socket.recv(65536)
        if not more:
            raise ConnectionError("the client closed the connection")
        self._received = self.handle(self._received + more)

    def send(self, message: bytes) -> None:
        """Sends a message now, or as soon as the client reads. Raises OSError."""
        self._unsent += message
        if len(self._unsent) > _MAX_UNSENT:
            raise ConnectionError("the client does not read")
        self.flush()

    def flush(self) -> bool:
        with suppress(BlockingIOError):
            while self._unsent:
                del self._unsent[: self.socket.send(self._unsent)]
        return not self._unsent


class RtdePeer(Peer):
    """An RTDE client.

    Attributes:
        inputs: input recipes, which are numbered from 1.
    """

    def __init__(self, server: RtdeServer, connection: socket.socket, name: str) -> None:
        super().__init__(server, connection, name)
        self.is_started = self.is_awaited = False
        self.inputs: list[Recipe] = []
        self.claimed: set[str] = set()
        self.skipped = 0
        self._outputs: Recipe | None = None
        self._every, self._begins = 1, 0.0
        self._last_sent = 0.0  # time of the last package on the monotonic clock, s
        self._has_version = False

    def handle(self, received: bytes) -> bytes:
        at = 0
        for kind, payload, end in split_messages(received, _KINDS):
            self._handle_message(kind, payload)
            at = end
        return received[at:]

    def send_text(self, text: str) -> None:
        encoded = text.encode()[:255]
        payload = bytes([len(encoded)]) + encoded
        payload += bytes([len(_SOURCE)]) + _SOURCE + bytes([_WARNING])
        self._answer(TEXT, payload)

    @property
    def is_ready(self) -> bool:
        return self.is_started and clock.monotonic() >= self._begins

    def is_due(self, cycle: int) -> bool:
        """Returns whether the client receives a package in this cycle."""
        return self.is_ready and cycle % self._every == 0

    def send_package(self) -> None:
        """Sends the values of the output recipe if the client has read the previous values."""
        assert self._outputs is not None
        now = clock.monotonic()
        if self.flush():
            self._last_sent, self.is_awaited = now, True
            values = self._outputs.pack(self.server.robot.value)
            self._answer(DATA, b"\1" + values)
        else:
            self.skipped += 1
            if now - self._last_sent > _MAX_UNREAD_TIME:
                raise ConnectionError(f"the client has read nothing for {_MAX_UNREAD_TIME:g} s")

    def _answer(self, kind: int, payload: bytes) -> None:
        self.send(HEAD.pack(HEAD.size + len(payload), kind) + payload)

    def _handle_message(self, kind: int, payload: bytes) -> None:
        if kind == ASK_VERSION:
            self._has_version = payload == struct.pack(">H", VERSION)
            self._answer(kind, bytes([self._has_version]))
        elif kind == ASK_CONTROLLER:
            self._answer(kind, struct.pack(">4I", *CONTROLLER_VERSION))
        elif kind == TEXT:
            text = payload[1 : 1 + payload[0]] if payload else b""
            self.server.warn_once(
                f"message of client {self.name}: {text.decode('utf-8', 'replace')}"
            )
        elif not self._has_version:
            problem = f"the client sends {chr(kind)} before it requests RTDE version {VERSION}"
            raise ProtocolError(problem)
        elif kind == SET_UP:
            self._set_up_outputs(payload)
        elif kind == SET_UP_INPUTS:
            self._set_up_inputs(payload)
        elif kind == START:
            self.is_started = self._outputs is not None
            if not self.is_started:
                self.send_text("no outputs are set up")
            self._begins = clock.monotonic() + _START_DELAY
            self._answer(kind, bytes([self.is_started]))
        elif kind == PAUSE:
            self.is_started = self.is_awaited = False
            self._answer(kind, b"\1")
        elif kind == DATA:
            self._take(payload)

    def _set_up_outputs(self, payload: bytes) -> None:
        if len(payload) < 8:
            text = f"a request to set up outputs has {len(payload)} bytes; expected at least 8"
            raise ProtocolError(text)
        (rate,) = struct.unpack_from(">d", payload)
        recipe = Recipe(payload[8:], OUTPUTS, frozenset())
        self.is_started = self.is_awaited = False
        self._outputs = recipe if recipe.is_valid else None
        # A rate that is not a divisor is rounded to whole cycles; an invalid rate is the maximum.
        cycles = 1.0 / (rate * self.server.cycle) if math.isfinite(rate) and rate > 0.0 else 1.0
        self._every = max(math.ceil(min(cycles, 1e6) - 1e-6), 1)
        self._answer(SET_UP, bytes([recipe.is_valid]) + ",".join(recipe.types).encode())

    def _set_up_inputs(self, payload: bytes) -> None:
        recipe = Recipe(payload, INPUTS, self.server.claimed_by_others(self))
        is_taken = recipe.is_valid and len(self.inputs) < _MAX_RECIPES
        if is_taken:
            self.inputs.append(recipe)
            self.claimed |= set(recipe.names)
        number = len(self.inputs) if is_taken else 0
        self._answer(SET_UP_INPUTS, bytes([number]) + ",".join(recipe.types).encode())

    def _take(self, payload: bytes) -> None:
        number = payload[0] if payload else 0
        robot = self.server.robot
        if not 1 <= number <= len(self.inputs):
            robot.reject(f"client {self.name} sends a data package of unknown recipe {number}")
            return
        recipe = self.inputs[number - 1]
        if len(payload) != 1 + recipe.size:
            what = f"found {len(payload) - 1} bytes; expected {recipe.size}"
            robot.reject(f"data package of recipe {number} of client {self.name}: {what}")
            return
        try:
            values = recipe.unpack(payload[1:])
        except ValueError as error:
            robot.reject(f"data package of recipe {number} of client {self.name}: {error}")
            return
        if robot.take(self, values):
            self.is_awaited = False


class DashboardPeer(Peer):
    """A client of the dashboard server. Only requests that RTDE clients send are supported."""

    def greet(self) -> None:
        self.send(b"Connected: Universal Robots Dashboard Server\n")

    def handle(self, received: bytes) -> bytes:
        *lines, rest = received.split(b"\n")
        if len(rest) > MAX_BYTES:
            raise ProtocolError(f"the client sends a line of more than {MAX_BYTES} bytes")
        for line in lines:
            self.send(self._answer_to(line.decode("utf-8", "replace").strip()).encode() + b"\n")
        return rest

    def _answer_to(self, line: str) -> str:
        robot, request = self.server.robot, line.lower()
        if request == "stop":
            robot.stop_program()
            return "Stopped"
        if request == "running":
            return f"Program running: {str(robot.is_running).lower()}"
        version = ".".join(map(str, CONTROLLER_VERSION))
        answers = {
            "polyscopeversion": f"URSoftware {version} (sero-mj)",
            "get serial number": "0",
            "is in remote control": "true",
            "robotmode": "Robotmode: RUNNING",
            "safetystatus": "Safetystatus: NORMAL",
            "programstate": "PLAYING" if robot.is_running else "STOPPED",
            "power on": "Powering on",
            "brake release": "Brake releasing",
            "quit": "Disconnected",
        }
        if request not in answers:
            self.server.warn_once(f"dashboard server: unknown request '{line[:40]}'")
        return answers.get(request, f"could not understand: '{line[:40]}'")


class ScriptPeer(Peer):
    """A client that sends URScript. The script is passed to `Robot.take_script`, but not run."""

    def handle(self, received: bytes) -> bytes:
        if received.rstrip().endswith((b"\nend", b"\r\nend")):  # inner ones are indented
            self.server.robot.take_script(received)
            return b""
        return received[-_MAX_UNSENT:]


class RtdeServer:
    """A server that serves all clients. `cycle` is the minimum time between packages, s."""

    def __init__(self, robot: Robot, cycle: float, name: str) -> None:
        self.robot, self.cycle = robot, cycle
        self.port = 0
        self._name = name
        self._selector: selectors.BaseSelector | None = None
        self._peers: dict[socket.socket, Peer] = {}
        self._makes: dict[socket.socket, Callable[[socket.socket, str], Peer]] = {}
        self._is_new = Once()

    @property
    def peers(self) -> list[RtdePeer]:
        return [peer for peer in self._peers.values() if isinstance(peer, RtdePeer)]

    def open(self, host: str, port: int, dashboard: int = 0, script: int = 0) -> None:
        """Starts to listen. Raises OSError if a port is not available.

        Args:
            port: port of RTDE; 0 for a free port.
            dashboard: port of the dashboard server; 0 for no dashboard server.
            script: port of the server for URScript; 0 for no such server.
        """
        self._selector = selectors.DefaultSelector()
        for number, make in ((port, RtdePeer), (dashboard, DashboardPeer), (script, ScriptPeer)):
            if not number and make is not RtdePeer:
                continue
            try:
                listening = socket.create_server((host, number))
            except OSError as error:
                self.close()
                reason = error.strerror or str(error)
                raise OSError(error.errno, f"{host}:{number}: {reason}") from error
            listening.setblocking(False)
            weakref.finalize(self, listening.close)
            self._makes[listening] = self._maker(make)
            self._selector.register(listening, selectors.EVENT_READ)
            if make is RtdePeer:
                self.port = int(listening.getsockname()[1])

    def _maker(self, kind: type[Peer]) -> Callable[[socket.socket, str], Peer]:
        return lambda connection, name: kind(self, connection, name)

    def close(self) -> None:
        """Ends all connections. Has no effect if the server is closed."""
        for peer in [*self._peers.values()]:
            self._drop(peer, "")
        for listening in self._makes:
            listening.close()
        self._makes.clear()
        if self._selector is not None:
            self._selector.close()
        self._selector = None

    def serve(self, seconds: float = 0.0) -> bool:
        """Waits some seconds for data, handles the data, and returns whether any arrived."""
        if self._selector is None:
            return False
        ready = self._selector.select(max(seconds, 0.0))
        for key, _ in ready:
            found = key.fileobj
            assert isinstance(found, socket.socket)
            if found in self._makes:
                self._accept(found)
            elif (peer := self._peers.get(found)) is not None:
                self._do(peer, peer.read)
        return bool(ready)

    def send(self, cycle: int) -> None:
        """Sends packages to all clients that receive one in this cycle."""
        for peer in self.peers:
            if peer.is_due(cycle):
                self._do(peer, peer.send_package)

    def send_to(self, peer: RtdePeer) -> None:
        self._do(peer, peer.send_package)

    def claimed_by_others(self, but: RtdePeer) -> frozenset[str]:
        """Returns the names of inputs that other clients have set up."""
        return frozenset().union(*(peer.claimed for peer in self.peers if peer is not but))

    def warn_once(self, text: str) -> None:
        if self._is_new(text):
            log.warning("%s: %s", self._name, text)

    def _accept(self, listening: socket.socket) -> None:
        assert self._selector is not None
        try:
            connection, address = listening.accept()
        except OSError:
            return
        name = f"{address[0]}:{address[1]}"
        if len(self._peers) >= _MAX_PEERS:
            self.warn_once(f"more than {_MAX_PEERS} connections; additional connections are closed")
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer = self._makes[listening](connection, name)
        self._peers[connection] = peer
        self._selector.register(connection, selectors.EVENT_READ)
        if isinstance(peer, RtdePeer):
            log.info("%s: client %s connected", self._name, name)
        if isinstance(peer, DashboardPeer):
            self._do(peer, peer.greet)

    def _do(self, peer: Peer, act: Callable[[], None]) -> None:
        try:
            act()
        except BlockingIOError:
            pass
        except ProtocolError as error:
            self.robot.reject(f"client {peer.name}: {error}")
            self._drop(peer, "")
        except OSError as error:
            is_reported = isinstance(peer, RtdePeer)
            why = str(error) if error.errno is None else error.strerror
            self._drop(peer, f"client {peer.name} disconnected: {why}" if is_reported else "")

    def _drop(self, peer: Peer, why: str) -> None:
        if self._peers.pop(peer.socket, None) is None:
            return
        if self._selector is not None:
            with suppress(KeyError, ValueError):
                self._selector.unregister(peer.socket)
        peer.socket.close()
        if why:
            log.warning("%s: %s", self._name, why)

    def wait_until(self, due: float) -> None:
        """Serves all clients until `time.monotonic()` reaches a time in seconds."""
        while (left := due - clock.monotonic()) > 0.0:
            self.serve(left)
        while self.serve() and clock.monotonic() < due + self.cycle:
            pass
