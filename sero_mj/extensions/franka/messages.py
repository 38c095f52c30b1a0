"""Messages between a Franka arm and its clients, for the server versions 3 to 10.

All messages are little-endian and packed. Sources: `research_interface/robot/service_types.h` and
`rbk_types.h` of libfranka-common, at the commits that libfranka 0.9 (server version 5), 0.10 (6),
0.13.6 (7), 0.14 (8), 0.15 (9) and 0.18 (10) use, and the last commits with versions 3 and 4.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base.frames import Array

HEAD = struct.Struct("<III")  # command, id of the request, number of bytes
MAX_BYTES = 4096  # maximum size of a request; the longest request has 428 bytes
SUCCESS, NOT_POSSIBLE, INVALID = 0, 1, 2  # status numbers of answers, except for Move
INCOMPATIBLE = 1  # status number of the answer to Connect
IDLE, MOVE, REFLEX = 1, 2, 4  # values of robot_mode
# Numbers in Move requests. In states, generator numbers are higher by 1, and 0 means no generator.
JOINT_POSITION, JOINT_VELOCITY, NO_GENERATOR = 0, 1, 4
JOINT_IMPEDANCE, CARTESIAN_IMPEDANCE, EXTERNAL = 0, 1, 2
OTHER_CONTROLLER = 3  # controller number in states without a motion

# Mapping from requests to the `struct` formats of their payloads.
REQUESTS = {
    "Connect": "HH",
    "Move": "II6d",
    "StopMove": "",
    "GetCartesianLimit": "i",
    "SetCollisionBehavior": "52d",
    "SetJointImpedance": "7d",
    "SetCartesianImpedance": "6d",
    "SetGuidingMode": "7?",
    "SetEEToK": "16d",
    "SetNEToEE": "16d",
    "SetLoad": "13d",
    "SetFilters": "5d",
    "AutomaticErrorRecovery": "",
    "LoadModelLibrary": "BB",
    "GetRobotModel": "",
}
_UNTIL = {"GetCartesianLimit": 5, "SetFilters": 5, "LoadModelLibrary": 9}
_SINCE = {"GetRobotModel": 8}
_ASYNC_SINCE, _ASYNC = 10, "?7d"  # fields of Move: is_asynchronous, and velocities in rad/s
_NO_GENERATOR_SINCE = 7
# Status names of answers to Move. Since version 6, two safety functions follow the third one.
_MOVE_STATUS = (
    "success", "started", "preempted", "not_possible", "singular", "invalid", "reflex",
    "emergency", "input_error", "aborted",
)  # fmt: skip
_SAFETY_SINCE = 6
_COMMAND = "<Q7d7d16d6d2d??7d"  # id, q_c, dq_c, O_T_EE_c, O_dP_EE_c, elbow_c, flags, tau_J_d
_FINISHED_SINCE = 7  # first version with a final flag that finishes torque control


@dataclass(frozen=True)
class RobotCommand:
    """A command that a client sends for one cycle. Its torques do not include gravity."""

    message_id: int
    angles: Array
    velocities: Array
    torques: Array
    is_last: bool


@dataclass(frozen=True)
class Messages:
    """The structures of all messages of a server version."""

    version: int

    @cached_property
    def requests(self) -> dict[int, tuple[str, struct.Struct]]:
        """Mapping from request numbers to names and payload structures."""
        names = [
            name
            for name in REQUESTS
            if _SINCE.get(name, 0) <= self.version <= _UNTIL.get(name, self.version)
        ]
        found = {}
        for number, name in enumerate(names):
            more = _ASYNC if name == "Move" and self.version >= _ASYNC_SINCE else ""
            found[number] = name, struct.Struct(f"<{REQUESTS[name]}{more}")
        return found

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Mapping from request names to numbers."""
        return {name: number for number, (name, _) in self.requests.items()}

    def answer(self, request: str, number: int, status: int, more: bytes = b"") -> bytes:
        size = HEAD.size + 1 + len(more)
        return HEAD.pack(self.numbers[request], number, size) + bytes([status]) + more

    def move_status(self, name: str) -> int:
        """Returns the status number of an answer to Move."""
        found = _MOVE_STATUS.index(name)
        return found + 2 * (found > 2 and self.version >= _SAFETY_SINCE)

    @property
    def has_no_generator(self) -> bool:
        """Whether torques can be commanded without a motion generator."""
        return self.version >= _NO_GENERATOR_SINCE

    @cached_property
    def command(self) -> struct.Struct:
        return struct.Struct(_COMMAND + "?" * (self.version >= _FINISHED_SINCE))

    def read_command(self, packet: bytes | bytearray | memoryview) -> RobotCommand | None:
        if len(packet) != self.command.size:
            return None
        found = self.command.unpack(packet)
        numbers = np.array(found[1:39] + found[41:48])
        is_last = found[40] or any(found[48:])
        return RobotCommand(found[0], numbers[:7], numbers[7:14], numbers[38:], is_last)
