"""The format of recordings in MCAP: topics, metadata, and the two clocks.

    metadata `sero-mj`    format, version, started, start_epoch_ns, start_monotonic_ns
    metadata `about`      description of the recording: scene, robot, ...
    metadata `lost`       number of lost packets by source, if any
    channel /NAME/raw     packets of a source as `std_msgs/UInt8MultiArray`; the metadata declares
                          how they are decoded
    channel /NAME/signals decoded values, for plots in Foxglove and PlotJuggler; the metadata
                          contains the origin of each named number
    channel /ROBOT/joint_states   joint states of a robot, as in ROS
    attachments           the scene file and its robots' files

All messages are ROS 2 messages (profile `ros2`, definitions `ros2msg`, CDR), so that `ros2 bag` and
`rosbags` can open the file: `ros2 bag` requires the same encoding for all messages and a schema for
each channel, and `rosbags` does not support JSON Schema. Files of format 1 have packets without a
header, and JSON.

The log time of a message is the arrival time of the packet in ns since the epoch. It is the
monotonic clock with a constant offset, so it never jumps, and differences are exact.

Numbers with individual names (`lwr.A1.torque [Nm]`) are members of a message. The names of the
members are derived from these names (`lwr_a1_torque`), and comments in the definition contain the
full names. Other values are arrays of numbers, points or frames. All numbers are float64.
"""

from __future__ import annotations

import json
import math
import re
import struct
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from typing import Any
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ...base.errors import mismatch
from .joint_state_messages import CDR_HEAD, RULE, JointStates

FORMAT = 2
ABOUT, CLOCK, LOST = "about", "sero-mj", "lost"
SOURCE_KEY = "sero-mj"  # key in the metadata of a raw channel
LIBRARY = "sero-mj"  # name of the library in the header of the file
RAW_SCHEMA = f"""\
std_msgs/MultiArrayLayout layout
uint8[] data
{RULE}
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
{RULE}
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
RAW_SCHEMA_NAME = "std_msgs/msg/UInt8MultiArray"
_RAW_HEAD = struct.Struct("<4s3I")  # CDR header, 0 dimensions, offset 0, and number of bytes
_MAX_NS = 2**64 - 1


@dataclass(frozen=True)
class RecordingClock:
    """Start time of a recording, both since the epoch and on the clock of `time.monotonic`."""

    epoch_ns: int = field(default_factory=time.time_ns)
    monotonic_ns: int = field(default_factory=time.monotonic_ns)

    def log_time(self, arrival: float) -> int:
        """Converts a time of `time.monotonic` in seconds to nanoseconds since the epoch."""
        if not math.isfinite(arrival):
            raise mismatch(arrival, "seconds on time.monotonic", key="arrival")
        log_time = round(arrival * 1e9) - self.monotonic_ns + self.epoch_ns
        if not 0 <= log_time <= _MAX_NS:
            raise ValueError(f"arrival: found {arrival}, which is before 1970 or after 2554")
        return log_time

    def to_metadata(self) -> dict[str, str]:
        """Returns the metadata record of the recording."""
        started = datetime.fromtimestamp(self.epoch_ns / 1e9, UTC)
        return {
            "format": str(FORMAT),
            "version": __version__,
            "started": started.isoformat(timespec="milliseconds"),
            "start_epoch_ns": str(self.epoch_ns),
            "start_monotonic_ns": str(self.monotonic_ns),
        }

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> RecordingClock:
        """Reads the metadata record; raises KeyError or ValueError."""
        return cls(int(metadata["start_epoch_ns"]), int(metadata["start_monotonic_ns"]))


@dataclass(frozen=True)
class SourceDeclaration:
    """Declaration for decoding the packets of a source, stored as metadata of the raw channel.

    Attributes:
        declared: fields of the source in the scene, as JSON types.
        size: size of a packet in bytes.
    """

    name: str
    kind: str
    declared: Mapping[str, Any]
    events: Mapping[str, tuple[int, ...]]
    size: int

    def to_json(self) -> str:
        """Returns the declaration as JSON; raises TypeError if a field has no JSON type."""
        plain = {"declared": dict(self.declared), "events": dict(self.events)}
        return json.dumps({**vars(self), **plain})

    @classmethod
    def from_json(cls, text: str) -> SourceDeclaration:
        """Parses a declaration; raises KeyError, TypeError, AttributeError or ValueError."""
        found = json.loads(text)
        events = {str(event): tuple(map(int, shape)) for event, shape in found["events"].items()}
        return cls(
            str(found["name"]),
            str(found["kind"]),
            dict(found["declared"]),
            events,
            int(found["size"]),
        )


def pack_raw(packet: bytes) -> bytes:
    """Converts a packet to a message of `RAW_SCHEMA`."""
    return _RAW_HEAD.pack(CDR_HEAD, 0, 0, len(packet)) + packet


def unpack_raw(message: bytes) -> bytes:
    """Returns the packet in a message of `RAW_SCHEMA`; raises ValueError."""
    if len(message) < _RAW_HEAD.size:
        raise ValueError(f"found {len(message)} bytes; expected {_RAW_HEAD.size} or more")
    packet = message[_RAW_HEAD.size :]
    if _RAW_HEAD.unpack_from(message) != (CDR_HEAD, 0, 0, len(packet)):
        raise ValueError("its header is not valid for a packet")
    return packet


def message_type(source: str, taken: Collection[str]) -> str:
    """Returns the ROS type for the signals of a source, such as `sero_mj/msg/SignalsMyArm`."""
    words = re.findall(r"[A-Za-z0-9]+", source)
    name = "sero_mj/msg/Signals" + "".join(word[0].upper() + word[1:] for word in words)
    unique, count = name, 1
    while unique in taken:
        count += 1
        unique = f"{name}{count}"
    return unique


_POINT, _FRAME = "geometry_msgs/Point", "sero_mj/Frame"
_DEFINITIONS = {
    _FRAME: f"{_POINT} position\nfloat64[9] rotation  # row by row",
    _POINT: "float64 x\nfloat64 y\nfloat64 z",
}
_VECTORS, _MATRICES = (3,), (4, 4)  # shapes of an item
_ITEMS = {_VECTORS: _POINT, _MATRICES: _FRAME}
_NOT_IN_FIELDS = re.compile(r"[^a-z0-9]+")
_UNIT = re.compile(r" \[[^]]*\]$")


@dataclass(frozen=True, eq=False)
class Signals:
    """Names, shapes and encoding of the decoded values of a source.

    Attributes:
        shapes: shape (n,), (n, 3) or (n, 4, 4) of each event or routed input.
        names: individual names of the n numbers, by key of `shapes`. Values without individual
            names are arrays.
        origins: origin of each number with an individual name, such as `values1[0]`.
        joint_states: joint states by robot.
    """

    shapes: Mapping[str, tuple[int, ...]]
    names: Mapping[str, Sequence[str]] = field(default_factory=dict)
    origins: Mapping[str, str] = field(default_factory=dict)
    joint_states: Mapping[str, JointStates] = field(default_factory=dict)

    def schema(self) -> bytes:
        """Returns the definition of the message type."""
        lines, used = [], set()
        fields = iter(self.fields)
        for key, shape in self.shapes.items():
            for name in self.names.get(key, ()):
                origin = self.origins.get(name)
                about = f"{name}, from {origin}" if origin else name
                lines.append(f"float64 {next(fields)}  # {' '.join(about.split())}")
            if key not in self.names:
                item = _ITEMS.get(tuple(shape[1:]), "float64")
                used |= {item} | ({_POINT} if item == _FRAME else set())
                count = int(np.prod(shape)) if item == "float64" else shape[0]
                lines.append(f"{item}[{count}] {next(fields)}")
        parts = ["\n".join(lines or ["uint8 structure_needs_at_least_one_member"])]
        parts += [f"MSG: {kind}\n{text}" for kind, text in _DEFINITIONS.items() if kind in used]
        return f"\n{RULE}\n".join(parts).encode()

    @cached_property
    def fields(self) -> list[str]:
        """Names of the members of messages, restricted to the characters that ROS allows."""
        found: list[str] = []
        for key in self.shapes:
            for name in self.names.get(key, [key]):
                ascii = normalize("NFKD", _UNIT.sub("", name)).encode("ascii", "ignore").decode()
                plain = _NOT_IN_FIELDS.sub("_", ascii.lower()).strip("_") or "value"
                plain = plain if plain[0].isalpha() else f"n{plain}"
                unique, count = plain, 1
                while unique in found:
                    count += 1
                    unique = f"{plain}_{count}"
                found.append(unique)
        return found

    def encode(self, values: Mapping[str, NDArray[np.float64]]) -> bytes:
        """Converts the values of a packet, with the keys of `shapes`, to a message."""
        return self.encode_table(self.table(values))[0]

    def table(self, values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Converts the values of a packet, with the keys of `shapes`, to a table row (1, k)."""
        numbers = [np.asarray(values[key], np.float64).ravel() for key in self.shapes]
        return np.concatenate([*numbers, np.zeros(0)])[None]

    def encode_table(self, table: NDArray[np.float64]) -> list[bytes]:
        """Converts each row of a table (n, k) of numbers in the order of `shapes` to a message."""
        if not self.shapes:
            return [CDR_HEAD + b"\0"] * len(table)
        rows = np.ascontiguousarray(table[:, self._order], "<f8")
        return [CDR_HEAD + row.tobytes() for row in rows]

    @cached_property
    def _order(self) -> NDArray[np.intp]:
        order, first = [np.zeros(0, np.intp)], 0
        for shape in self.shapes.values():
            places = np.arange(first, first + int(np.prod(shape)))
            first += len(places)
            if tuple(shape[1:]) == _MATRICES:
                frames = places.reshape(-1, 4, 4)
                parts = frames[:, :3, 3], frames[:, :3, :3].reshape(-1, 9)
                places = np.concatenate(parts, axis=1).ravel()
            order.append(places)
        return np.concatenate(order)


def media_type(name: str) -> str:
    """Returns the media type of a scene or robot file, by its extension."""
    types = {".toml": "application/toml", ".xml": "application/xml", ".urdf": "application/xml"}
    return types.get(name[name.rfind(".") :].lower(), "text/plain")
