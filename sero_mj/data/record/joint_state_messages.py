"""Encodes joint states as `sensor_msgs/JointState`, for Foxglove, PlotJuggler and `ros2 bag`.

The encoding is little-endian CDR: numbers are aligned to their size, relative to byte 4.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...base.frames import Array

SCHEMA_NAME, ENCODING, SCHEMA_ENCODING = "sensor_msgs/msg/JointState", "cdr", "ros2msg"
RULE = "=" * 80  # separator between the definitions of a schema
SCHEMA = f"""\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{RULE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{RULE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
""".encode()
CDR_HEAD = b"\0\1\0\0"  # plain CDR, little-endian


@dataclass(frozen=True)
class JointStates:
    """Joint names of a robot, and keys in `Signals.shapes` of its joint states (empty for none)."""

    names: Sequence[str]
    angles: str
    velocities: str = ""
    torques: str = ""


class JointStateMessages:
    """Encodes the joint states of one robot as `sensor_msgs/JointState`."""

    def __init__(self, joints: JointStates, shapes: Mapping[str, tuple[int, ...]]) -> None:
        sizes = [int(np.prod(shape)) for shape in shapes.values()]
        ends = dict(zip(shapes, np.cumsum(sizes).tolist(), strict=True))
        body = bytearray(8)  # the stamp
        body += struct.pack("<I", 1) + b"\0"  # frame_id
        _align(body, 4)
        body += struct.pack("<I", len(joints.names))
        for name in joints.names:
            text = name.encode() + b"\0"
            _align(body, 4)
            body += struct.pack("<I", len(text)) + text
        self._parts: list[tuple[int, slice]] = []  # byte in the message, and columns of the table
        for key in (joints.angles, joints.velocities, joints.torques):
            count = len(joints.names) if key else 0
            _align(body, 4)
            body += struct.pack("<I", count)
            if count:
                _align(body, 8)
                self._parts.append((len(CDR_HEAD) + len(body), slice(ends[key] - count, ends[key])))
                body += bytes(8 * count)
        self._template = np.frombuffer(CDR_HEAD + bytes(body), np.uint8)

    def encode(self, table: Array, log_times: Sequence[int]) -> list[bytes]:
        """Encodes each row of a table (n, k) with its log time in ns since the epoch."""
        rows = np.repeat(self._template[None], len(table), axis=0)
        times = np.array([divmod(time, 10**9) for time in log_times], "<i4")
        rows[:, 4:12] = times.view(np.uint8)
        for start, columns in self._parts:
            numbers = np.ascontiguousarray(table[:, columns], "<f8").view(np.uint8)
            rows[:, start : start + numbers.shape[1]] = numbers
        return [row.tobytes() for row in rows]


def _align(body: bytearray, size: int) -> None:
    body += bytes(-len(body) % size)
