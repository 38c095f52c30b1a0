"""`RtdeReceiver`: a robot of Universal Robots, by its Real-Time Data Exchange (RTDE) on TCP 30004.

A client asks for variables by name and starts them; the controller then sends a data package each
cycle (2 ms, CB3: 8 ms). All messages are big-endian: a size of 2 bytes, a type of 1 byte, a
payload. Nothing but questions is ever sent: no input is set up, so nothing can be commanded. The
protocol and names of variables are those of UR's RTDE guide, protocol version 2.
"""

from __future__ import annotations

import math
import socket
import struct
import time as clock
from collections import deque
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import ClassVar

from pydantic import Field, PrivateAttr

from ...base.frames import Array
from ...data.receive import connecting
from ...data.receive.connecting import ConnectingSource, Connection, ProtocolError
from ...data.receive.structure import Structure, TorqueSign

PORT = 30004
VERSION = 2  # of the protocol
# Types of messages; the last two are those of clients that command.
_TYPES = b"VvOSUM"
ASK_VERSION, ASK_CONTROLLER, SET_UP, START, DATA, TEXT = _TYPES
SET_UP_INPUTS, PAUSE = b"IP"
HEAD = struct.Struct(">HB")  # size, and type
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"  # instead of the type of a variable
_MOST_BYTES = 4096  # of a message; those of a controller have up to 600

# Variable, its type, and its events.
VARIABLES = (
    ("timestamp", "DOUBLE", "timestamp:1d"),
    ("actual_q", "VECTOR6D", "joint_angles:6d"),
    ("actual_qd", "VECTOR6D", "joint_velocities:6d"),
    ("actual_current", "VECTOR6D", "currents:6d"),
    ("actual_current_as_torque", "VECTOR6D", "torques:6d"),
    ("target_moment", "VECTOR6D", "commanded_torques:6d"),
    ("target_q", "VECTOR6D", "commanded_angles:6d"),
    ("actual_TCP_force", "VECTOR6D", "tcp_force:1Vd tcp_moment:1Vd"),
    ("robot_mode", "INT32", "robot_mode:1i"),
    ("safety_mode", "INT32", "safety_mode:1i"),
)
# What is added to a data package: whether its torques are commanded ones, and its number, counted
# by time stamps, of which those of packages that the controller left out are passed over.
_ADDED = struct.Struct(">BI")
STRUCTURE = " ".join(
    (">", *(events for *_, events in VARIABLES), "torques_are_commanded:1B package_number:1I")
)
MEASURED, COMMANDED = "actual_current_as_torque", "target_moment"
UNKNOWN = -128  # of a mode that the controller does not tell
_NAN = struct.pack(">d", math.nan)
_ABSENT = {"DOUBLE": _NAN, "VECTOR6D": 6 * _NAN, "INT32": struct.pack(">i", UNKNOWN)}

ROBOT_MODES = {
    -1: "without a controller", 0: "disconnected", 1: "waiting for its safety to be confirmed",
    2: "booting", 3: "powered off", 4: "powered on", 5: "idle", 6: "in backdrive", 7: "running",
    8: "updating its firmware",
}  # fmt: skip
SAFETY_MODES = {
    1: "normal", 2: "reduced", 3: "protective stop", 4: "recovery", 5: "safeguard stop",
    6: "system emergency stop", 7: "robot emergency stop", 8: "violation", 9: "fault",
    10: "joint identification", 11: "undefined",
}  # fmt: skip
_RUNNING, _SAFE = 7, (1, 2)

_EARLY = 0.25  # of a period: so much less between stamps is still another package


class RtdeReceiver(ConnectingSource):
    """Receives the state of a robot of Universal Robots, without commanding it.

    It connects, and connects again when the connection is lost. Events are in SI units; currents
    in A. `torques` are those measured, `actual_current_as_torque`, which controllers have from
    PolyScope 5.23 and 10.11 on; before that they are the commanded ones, which is told, and
    `torques_are_commanded` is 1. `tcp_force` and `tcp_moment` are at the TCP, in directions of the
    base, and are what the environment exerts on the robot. What the controller does not have is
    NaN, a mode -128.

    Attributes:
        host: address of the controller.
        port: its port.
        frequency: of data packages, Hz; 0 for the highest of the controller: 500, or 125 of a CB3.
        torque_sign: factor of measured and commanded torques: 1 or -1.
    """

    name: str = "rtde"
    port: int = Field(PORT, ge=1, le=65535)
    frequency: float = Field(0.0, ge=0.0, le=500.0)
    structure: str = STRUCTURE
    sequence: str = "package_number"
    time: str = "timestamp"
    torque_sign: TorqueSign = 1

    _fixed_by: ClassVar[str] = "RTDE"
    protocol: ClassVar[str] = "UR RTDE"
    # As long as the routes are unknown, what older controllers lack may be missing.
    _nan_allowed: frozenset[str] = PrivateAttr(
        frozenset(("currents", "torques", "commanded_torques", "tcp_force", "tcp_moment"))
    )

    @cached_property
    def layout(self) -> Structure:
        return RtdeLayout(self.torque_sign)

    def describe_link(self, values: Mapping[str, Array]) -> str:
        said = _modes(*self.link_state(values))
        if values["torques_are_commanded"][0]:
            said.append("torques are commanded, not measured")
        return ", ".join(said)

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        return float(values["robot_mode"][0]), max(float(values["safety_mode"][0]), -1.0)

    def link_faults(self, state: float, quality: float) -> list[str]:
        good = state in (_RUNNING, UNKNOWN) and (quality < 0 or quality in _SAFE)
        return [] if good else [", ".join(_modes(state, quality))]

    def converse(self, wake: socket.socket) -> None:
        left_out = frozenset[str]()
        while True:  # once more without what the controller lacks, as UR's own client does it
            with _Connection(self.host, self.port, wake) as connection:
                left_out |= self._talk(connection, left_out)

    def _talk(self, connection: _Connection, left_out: frozenset[str]) -> frozenset[str]:
        if connection.ask(ASK_VERSION, struct.pack(">H", VERSION), self._hear) != b"\1":
            raise ProtocolError("does not accept version 2 of RTDE")
        answer = connection.ask(ASK_CONTROLLER, b"", self._hear)
        if len(answer) != 16:
            raise ProtocolError("does not tell its version", answer)
        version = struct.unpack(">4I", answer)
        fastest = 500.0 if version[0] >= 5 else 125.0
        rate = min(self.frequency or fastest, fastest)
        recipe = [(name, kind) for name, kind, _ in VARIABLES if name not in left_out]
        names = ",".join(name for name, _ in recipe).encode()
        answer = connection.ask(SET_UP, struct.pack(">d", rate) + names, self._hear)
        found = answer[1:].decode("ascii", "replace").split(",")
        if len(found) != len(recipe):
            raise ProtocolError(f"told {len(found)} types of {len(recipe)} variables", answer)
        lacking = self._check_types(recipe, found)
        if lacking:
            if len(lacking) == len(recipe):
                raise ProtocolError("has none of the variables that are needed")
            return lacking
        if connection.ask(START, b"", self._hear) != b"\1":
            raise ProtocolError("does not start to send")
        self.note_connected(f"{rate:g} Hz")
        if MEASURED in left_out and COMMANDED not in left_out:
            self._state += ", torques are commanded, not measured"
            self.log_once(
                f"controller {'.'.join(map(str, version[:3]))} does not measure torques "
                "(actual_current_as_torque, from PolyScope 5.23 and 10.11 on); those shown are "
                "the commanded ones (target_moment)"
            )
        packages = _Packages(answer[0], left_out, rate, fastest)
        while True:
            bodies = [
                payload for kind, payload in connection.receive() if self._is_data(kind, payload)
            ]
            if bodies:
                self.accept([packages.packet(body, self.size) for body in bodies])

    def _check_types(self, recipe: list[tuple[str, str]], found: list[str]) -> frozenset[str]:
        lacking = set()
        for (name, kind), other in zip(recipe, found, strict=True):
            if other == kind:
                continue
            lacking.add(name)
            if other == NOT_FOUND:
                if name != MEASURED:  # which is told when it is known what stands in for it
                    self.log_once(f"the controller has no {name}")
            elif other == IN_USE:
                self.log_once(f"{name} is in use by another client")
            else:
                self.log_once(f"{name} is of type {other[:40]}; expected {kind}")
        return frozenset(lacking)

    def _is_data(self, kind: int, payload: bytes) -> bool:
        if kind == TEXT:
            self._hear(payload)
        elif kind != DATA:
            raise ProtocolError(f"sent message {chr(kind)} among data packages", payload)
        return kind == DATA

    def _hear(self, payload: bytes) -> None:
        is_whole = bool(payload) and 1 + payload[0] <= len(payload)
        text = payload[1 : 1 + payload[0]] if is_whole else payload
        self.log_once(f"the controller says: {text.decode('utf-8', 'replace').strip()}")


class RtdeLayout(Structure):
    """The packets of `RtdeReceiver`, which are data packages with `_ADDED`."""

    message = "data package"

    def __init__(self, torque_sign: TorqueSign = 1) -> None:
        signs = dict.fromkeys(("torques", "commanded_torques"), float(torque_sign))
        super().__init__(STRUCTURE, signs=signs)

    def describe_wrong_size(self, packet: bytes, length: int) -> str:
        return f"{length} bytes that are no {self.message} as agreed"


class _Connection(Connection):
    def __init__(self, host: str, port: int, wake: socket.socket) -> None:
        super().__init__(host, port, wake)
        self._received = b""
        self._messages: deque[tuple[int, bytes]] = deque()

    def ask(self, kind: int, question: bytes, hear: Callable[[bytes], None]) -> bytes:
        self.socket.sendall(HEAD.pack(HEAD.size + len(question), kind) + question)
        deadline = clock.monotonic() + connecting.PATIENCE
        while True:
            while not self._messages:
                self._read(deadline, f"does not answer question {chr(kind)}")
            found, payload = self._messages.popleft()
            if found == kind:
                return payload
            if found != TEXT:
                raise ProtocolError(
                    f"answers question {chr(kind)} by message {chr(found)}", payload
                )
            hear(payload)
            if clock.monotonic() > deadline:
                raise TimeoutError(f"does not answer question {chr(kind)}")

    def receive(self) -> list[tuple[int, bytes]]:
        deadline = clock.monotonic() + connecting.PATIENCE
        while not self._messages:
            self._read(deadline, f"sends nothing for {connecting.PATIENCE:g} s")
        messages = [*self._messages]
        self._messages.clear()
        return messages

    def _read(self, deadline: float, else_what: str) -> None:
        self.wait(deadline, else_what)
        received, at = self._received + self.read(), 0
        while len(received) - at >= HEAD.size:
            size, kind = HEAD.unpack_from(received, at)
            if not HEAD.size <= size <= _MOST_BYTES or kind not in _TYPES:
                text = f"sends what is no message of RTDE: {size} bytes of type {kind}"
                raise ProtocolError(text, received[at:])
            if len(received) - at < size:
                break
            self._messages.append((kind, received[at + HEAD.size : at + size]))
            at += size
        self._received = received[at:]


class _Packages:
    def __init__(self, recipe: int, left_out: frozenset[str], rate: float, fastest: float) -> None:
        self._recipe = recipe
        places, at = {}, 1  # behind the recipe's number
        for name, kind, _ in VARIABLES:
            if name not in left_out:
                places[name] = slice(at, at + len(_ABSENT[kind]))
                at = places[name].stop
        self._length = at
        self._is_commanded = MEASURED not in places and COMMANDED in places
        if self._is_commanded:
            places[MEASURED] = places[COMMANDED]
        self._pieces = [(places.get(name), _ABSENT[kind]) for name, kind, _ in VARIABLES]
        self._has_time = "timestamp" in places
        # The longest time between packages: whole cycles, of which a rate may not be a divisor.
        self._period = math.ceil(fastest / rate - 1e-6) / fastest
        self._number, self._stamp = 0, math.nan

    def packet(self, payload: bytes, size: int) -> bytes:
        if len(payload) != self._length or payload[0] != self._recipe:
            return payload + b"\0" * (len(payload) == size)
        step = 1
        if self._has_time:
            (stamp,) = struct.unpack_from(">d", payload, 1)
            passed = (stamp - self._stamp) / self._period
            # A simulated controller may stamp by a clock that is not that of its cycles.
            step = max(math.floor(passed + _EARLY), 1) if 0.0 < passed < 2.0**31 else 1
            self._stamp = stamp
        self._number = (self._number + step) & 0xFFFFFFFF
        data = b"".join(
            [absent if place is None else payload[place] for place, absent in self._pieces]
        )
        return data + _ADDED.pack(self._is_commanded, self._number)


def _modes(state: float, quality: float) -> list[str]:
    said = []
    if state != UNKNOWN:
        said.append(f"robot {ROBOT_MODES.get(int(state), f'in mode {state:.0f}')}")
    if quality >= 0:
        said.append(f"safety: {SAFETY_MODES.get(int(quality), f'mode {quality:.0f}')}")
    return said
