"""`RtdeReceiver`: the state of a Universal Robots arm from its Real-Time Data Exchange (RTDE).

A client connects to TCP port 30004 and requests variables by name. The controller then sends a data
package in each cycle (2 ms, or 8 ms for a CB3). All messages are big-endian and consist of a size
(2 bytes), a type (1 byte) and a payload. The receiver sets up no inputs, so it cannot command
anything. The protocol and the names of variables are those of UR's RTDE guide, protocol version 2.
"""

from __future__ import annotations

import math
import socket
import struct
import time as clock
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cached_property
from typing import ClassVar

from pydantic import Field, PrivateAttr

from ...base.frames import Array
from ...data.receive import connecting
from ...data.receive.connecting import ConnectingSource, Connection, ProtocolError
from ...data.receive.structure import Structure, TorqueSign

PORT = 30004
VERSION = 2  # version of the protocol
# Message types. Clients that command also use the last two.
_TYPES = b"VvOSUM"
ASK_VERSION, ASK_CONTROLLER, SET_UP, START, DATA, TEXT = _TYPES
SET_UP_INPUTS, PAUSE = b"IP"
HEAD = struct.Struct(">HB")  # size and type of a message
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"  # answers instead of the type of a variable
MAX_BYTES = 4096  # maximum size of a message; controllers send up to 600 bytes

# Name, type and events of each variable.
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
# Values that are added to a data package: whether its torques are commanded torques, and a package
# number. The number is computed from time stamps, so it skips packages that have not arrived.
_ADDED = struct.Struct(">BI")
STRUCTURE = " ".join(
    (">", *(events for *_, events in VARIABLES), "torques_are_commanded:1B package_number:1I")
)
MEASURED, COMMANDED = "actual_current_as_torque", "target_moment"
UNKNOWN = -128  # value of a mode that the controller does not send
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

_TOLERANCE = 0.25  # fraction of a period by which a package may be early


class RtdeReceiver(ConnectingSource):
    """Receives the state of a Universal Robots arm without commanding it.

    `torques` are the measured `actual_current_as_torque`, which controllers provide since PolyScope
    5.23 and 10.11. With older controllers, `torques` are the commanded torques, a warning is
    logged, and `torques_are_commanded` is 1. Currents are in A. `tcp_force` and `tcp_moment` are
    exerted by the environment on the robot at the TCP, in base directions. Missing values are NaN,
    and a missing mode is -128.

    Attributes:
        host: address of the controller.
        port: port of the controller.
        frequency: rate of data packages, Hz; 0 for the maximum rate (500 Hz, or 125 Hz for a CB3).
        torque_sign: factor of measured and commanded torques, 1 or -1.
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
    # Until the routes are known, variables that older controllers lack may be missing.
    _nan_allowed: frozenset[str] = PrivateAttr(
        frozenset(("currents", "torques", "commanded_torques", "tcp_force", "tcp_moment"))
    )

    @cached_property
    def layout(self) -> Structure:
        return RtdeLayout(self.torque_sign)

    def describe_link(self, values: Mapping[str, Array]) -> str:
        texts = _modes(*self.link_state(values))
        if values["torques_are_commanded"][0]:
            texts.append("torques are commanded, not measured")
        return ", ".join(texts)

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        return float(values["robot_mode"][0]), max(float(values["safety_mode"][0]), -1.0)

    def link_faults(self, state: float, quality: float) -> list[str]:
        good = state in (_RUNNING, UNKNOWN) and (quality < 0 or quality in _SAFE)
        return [] if good else [", ".join(_modes(state, quality))]

    def converse(self, wake: socket.socket) -> None:
        omitted = frozenset[str]()
        while True:  # repeated without the variables that the controller lacks, like UR's client
            with _Connection(self.host, self.port, wake) as connection:
                omitted |= self._run_session(connection, omitted)

    # Returns immediately if the controller lacks variables, otherwise receives until an error.
    def _run_session(self, connection: _Connection, omitted: frozenset[str]) -> frozenset[str]:
        if connection.request(ASK_VERSION, struct.pack(">H", VERSION), self._on_text) != b"\1":
            raise ProtocolError("the robot does not accept version 2 of RTDE")
        answer = connection.request(ASK_CONTROLLER, b"", self._on_text)
        if len(answer) != 16:
            raise ProtocolError("the robot sends an invalid controller version", answer)
        version = struct.unpack(">4I", answer)
        max_rate = 500.0 if version[0] >= 5 else 125.0
        rate = min(self.frequency or max_rate, max_rate)
        recipe = [(name, kind) for name, kind, _ in VARIABLES if name not in omitted]
        names = ",".join(name for name, _ in recipe).encode()
        answer = connection.request(SET_UP, struct.pack(">d", rate) + names, self._on_text)
        found = answer[1:].decode("ascii", "replace").split(",")
        if len(found) != len(recipe):
            text = f"the robot sends {len(found)} types for {len(recipe)} variables"
            raise ProtocolError(text, answer)
        missing = self._check_types(recipe, found)
        if missing:
            if len(missing) == len(recipe):
                raise ProtocolError("the robot has none of the required variables")
            return missing
        if connection.request(START, b"", self._on_text) != b"\1":
            raise ProtocolError("the robot does not start to send data")
        self.note_connected(f"{rate:g} Hz")
        if MEASURED in omitted and COMMANDED not in omitted:
            self._state += ", torques are commanded, not measured"
            self.log_once(
                f"controller {'.'.join(map(str, version[:3]))} does not measure torques "
                "(actual_current_as_torque requires PolyScope 5.23 or 10.11); the commanded "
                "torques (target_moment) are shown instead"
            )
        packages = _Packages(answer[0], omitted, rate, max_rate)
        while True:
            bodies = [
                payload for kind, payload in connection.receive() if self._is_data(kind, payload)
            ]
            if bodies:
                self.accept([packages.packet(body, self.size) for body in bodies])

    def _check_types(self, recipe: list[tuple[str, str]], found: list[str]) -> frozenset[str]:
        missing = set()
        for (name, kind), other in zip(recipe, found, strict=True):
            if other == kind:
                continue
            missing.add(name)
            if other == NOT_FOUND:
                if name != MEASURED:  # the warning about MEASURED names its replacement
                    self.log_once(f"the controller has no {name}")
            elif other == IN_USE:
                self.log_once(f"{name} is in use by another client")
            else:
                self.log_once(f"{name} is of type {other[:40]}; expected {kind}")
        return frozenset(missing)

    def _is_data(self, kind: int, payload: bytes) -> bool:
        if kind == TEXT:
            self._on_text(payload)
        elif kind != DATA:
            text = f"the robot sends a message of type {chr(kind)} between data packages"
            raise ProtocolError(text, payload)
        return kind == DATA

    def _on_text(self, payload: bytes) -> None:
        is_complete = bool(payload) and 1 + payload[0] <= len(payload)
        text = payload[1 : 1 + payload[0]] if is_complete else payload
        self.log_once(f"message of the controller: {text.decode('utf-8', 'replace').strip()}")


class RtdeLayout(Structure):
    """The structure of the packets of `RtdeReceiver`, data packages followed by `_ADDED`."""

    message = "data package"

    def __init__(self, torque_sign: TorqueSign = 1) -> None:
        signs = dict.fromkeys(("torques", "commanded_torques"), float(torque_sign))
        super().__init__(STRUCTURE, signs=signs)

    def describe_wrong_size(self, packet: bytes, length: int) -> str:
        return f"{length} bytes are not a {self.message} of the agreed recipe"


def split_messages(received: bytes, kinds: Collection[int]) -> Iterator[tuple[int, bytes, int]]:
    """Yields type, payload and end position of each complete message. Raises ProtocolError."""
    at = 0
    while len(received) - at >= HEAD.size:
        size, kind = HEAD.unpack_from(received, at)
        if not HEAD.size <= size <= MAX_BYTES or kind not in kinds:
            text = f"an RTDE message is invalid: {size} bytes of type {kind}"
            raise ProtocolError(text, received[at:])
        if len(received) - at < size:
            return
        yield kind, received[at + HEAD.size : at + size], at + size
        at += size


class _Connection(Connection):
    def __init__(self, host: str, port: int, wake: socket.socket) -> None:
        super().__init__(host, port, wake)
        self._received = b""
        self._messages: deque[tuple[int, bytes]] = deque()

    def request(self, kind: int, payload: bytes, on_text: Callable[[bytes], None]) -> bytes:
        self.socket.sendall(HEAD.pack(HEAD.size + len(payload), kind) + payload)
        deadline = clock.monotonic() + connecting.PATIENCE
        while True:
            while not self._messages:
                self._read(deadline, f"the robot does not answer request {chr(kind)}")
            found, payload = self._messages.popleft()
            if found == kind:
                return payload
            if found != TEXT:
                text = f"the robot answers request {chr(kind)} with {chr(found)}"
                raise ProtocolError(text, payload)
            on_text(payload)
            if clock.monotonic() > deadline:
                raise TimeoutError(f"the robot does not answer request {chr(kind)}")

    def receive(self) -> list[tuple[int, bytes]]:
        deadline = clock.monotonic() + connecting.PATIENCE
        while not self._messages:
            self._read(deadline, f"the robot sends nothing for {connecting.PATIENCE:g} s")
        messages = [*self._messages]
        self._messages.clear()
        return messages

    def _read(self, deadline: float, timeout_text: str) -> None:
        self.wait(deadline, timeout_text)
        self._received += self.read()
        at = 0
        for kind, payload, end in split_messages(self._received, _TYPES):
            self._messages.append((kind, payload))
            at = end
        self._received = self._received[at:]


# Converts payloads of data packages to packets.
class _Packages:
    def __init__(self, recipe: int, omitted: frozenset[str], rate: float, max_rate: float) -> None:
        self._recipe = recipe
        places, at = {}, 1  # after the recipe number
        for name, kind, _ in VARIABLES:
            if name not in omitted:
                places[name] = slice(at, at + len(_ABSENT[kind]))
                at = places[name].stop
        self._length = at
        self._is_commanded = MEASURED not in places and COMMANDED in places
        if self._is_commanded:
            places[MEASURED] = places[COMMANDED]
        self._pieces = [(places.get(name), _ABSENT[kind]) for name, kind, _ in VARIABLES]
        self._has_time = "timestamp" in places
        # Maximum time between packages: whole cycles, even if the rate is not a divisor.
        self._period = math.ceil(max_rate / rate - 1e-6) / max_rate
        self._number, self._stamp = 0, math.nan

    def packet(self, payload: bytes, size: int) -> bytes:
        if len(payload) != self._length or payload[0] != self._recipe:
            return payload + b"\0" * (len(payload) == size)
        step = 1
        if self._has_time:
            (stamp,) = struct.unpack_from(">d", payload, 1)
            passed = (stamp - self._stamp) / self._period
            # The time stamps of a simulated controller may not follow its cycles.
            step = max(math.floor(passed + _TOLERANCE), 1) if 0.0 < passed < 2.0**31 else 1
            self._stamp = stamp
        self._number = (self._number + step) & 0xFFFFFFFF
        data = b"".join(
            [absent if place is None else payload[place] for place, absent in self._pieces]
        )
        return data + _ADDED.pack(self._is_commanded, self._number)


def _modes(state: float, quality: float) -> list[str]:
    texts = []
    if state != UNKNOWN:
        texts.append(f"robot {ROBOT_MODES.get(int(state), f'in mode {state:.0f}')}")
    if quality >= 0:
        texts.append(f"safety: {SAFETY_MODES.get(int(quality), f'mode {quality:.0f}')}")
    return texts
