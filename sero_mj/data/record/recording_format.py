"""The format of recordings in MCAP: topics, metadata, and the two clocks.

    metadata `sero-mj`    format, version, started, start_epoch_ns, start_monotonic_ns
    metadata `about`      what the recording is of: scene, robot, ...
    metadata `lost`       source to the number of packets that could not be kept, where there are
    channel /NAME/raw     a source's packets as `std_msgs/UInt8MultiArray`; its metadata says how to
                          decode them
    channel /NAME/signals what the good ones of them mean, as numbers that Foxglove and PlotJuggler
                          plot; its metadata says of every name where its number comes from
    channel /ROBOT/joint_states   likewise the states of a robot's joints, as ROS has them
    attachments           the scene file and its robots' files

All messages are of ROS 2 (profile `ros2`, definitions `ros2msg`, CDR), so that `ros2 bag` and
`rosbags` open the file: `ros2 bag` wants one encoding in all of it and a schema for each channel,
`rosbags` knows no JSON Schema. Files of format 1 have packets without a head, and JSON.

A message's log time is when the packet arrived, in ns since the epoch. It is the monotonic clock
with a constant offset set at the start of the recording: it never jumps, and differences are exact
to the ns.

Numbers with individual names (`lwr.A1.torque [Nm]`) are members of a message, whose names in ROS
are made of these (`lwr_a1_torque`); a comment in the definition has the name itself. Other values
are an array of numbers, of points, or of frames. All are doubles, so a message is a row of a table.
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
from ...base.errors import (
    mismatch,
)
from .joint_state_messages import CDR_HEAD, RULE, JointStates

FORMAT = 2
ABOUT, CLOCK, LOST = "about", "sero-mj", "lost"
SOURCE_KEY = "sero-mj"  # in the metadata of a raw channel
LIBRARY = "sero-mj"  # which wrote the file
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
_RAW_HEAD = struct.Struct("<4s3I")  # of CDR; then no dimensions, no offset, and the bytes' number
_MAX_NS = 2**64 - 1


@dataclass(frozen=True)
class RecordingClock:
    """The start of a recording, on both clocks.

    Attributes:
        epoch_ns: ns since the epoch, UTC.
        monotonic_ns: ns on the clock of `time.monotonic`.
    """

    epoch_ns: int = field(default_factory=time.time_ns)
    monotonic_ns: int = field(default_factory=time.monotonic_ns)

    def log_time(self, arrival: float) -> int:
        """Returns the log time, ns since the epoch, of an arrival in s on `time.monotonic`.

        Raises:
            ValueError: the time is out of the file's range.
        """
        if not math.isfinite(arrival):
            raise mismatch(arrival, "seconds on time.monotonic", key="arrival")
        log_time = round(arrival * 1e9) - self.monotonic_ns + self.epoch_ns
        if not 0 <= log_time <= _MAX_NS:
            raise ValueError(f"arrival: found {arrival}, which is before 1970 or after 2554")
        return log_time

    def to_metadata(self) -> dict[str, str]:
        """As the metadata record that every recording has."""
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
        """Reads it from the metadata record; raises KeyError or ValueError."""
        return cls(int(metadata["start_epoch_ns"]), int(metadata["start_monotonic_ns"]))


@dataclass(frozen=True)
class SourceDeclaration:
    """The declaration needed to decode a source's packets, stored as a raw channel's metadata.

    Attributes:
        name: the source's name in routes.
        kind: its kind, e.g. `udp`.
        declared: its fields in the scene, of JSON's types.
        size: bytes of a packet.
    """

    name: str
    kind: str
    declared: Mapping[str, Any]
    events: Mapping[str, tuple[int, ...]]
    size: int

    def to_json(self) -> str:
        """As JSON; raises TypeError for a field that is not of JSON's types."""
        plain = {"declared": dict(self.declared), "events": dict(self.events)}
        return json.dumps({**vars(self), **plain})

    @classmethod
    def from_json(cls, text: str) -> SourceDeclaration:
        """Reads it from JSON; raises KeyError, TypeError, AttributeError or ValueError."""
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
    """Returns a packet as a message of `RAW_SCHEMA`."""
    return _RAW_HEAD.pack(CDR_HEAD, 0, 0, len(packet)) + packet


def unpack_raw(message: bytes) -> bytes:
    """Returns the packet in such a message; raises ValueError if it is none."""
    if len(message) < _RAW_HEAD.size:
        raise ValueError(f"found {len(message)} bytes; expected {_RAW_HEAD.size} or more")
    packet = message[_RAW_HEAD.size :]
    if _RAW_HEAD.unpack_from(message) != (CDR_HEAD, 0, 0, len(packet)):
        raise ValueError("its head is not that of a packet")
    return packet


def message_type(source: str, taken: Collection[str]) -> str:
    """Returns the type in ROS of the messages of a source's signals: `sero_mj/msg/SignalsMyArm`."""
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
_VECTORS, _MATRICES = (3,), (4, 4)  # the shape of one item
_ITEMS = {_VECTORS: _POINT, _MATRICES: _FRAME}
_NOT_IN_FIELDS = re.compile(r"[^a-z0-9]+")
_UNIT = re.compile(r" \[[^]]*\]$")


@dataclass(frozen=True, eq=False)
class Signals:
    """The contents of a source's messages, and their names.

    Attributes:
        shapes: event, or routed input, to its shape: (n,), (n, 3) or (n, 4, 4).
        names: one of these to the names of its numbers, n; the others are arrays.
        origins: such a name to the origin of its number: `values1[0]`.
    """

    shapes: Mapping[str, tuple[int, ...]]
    names: Mapping[str, Sequence[str]] = field(default_factory=dict)
    origins: Mapping[str, str] = field(default_factory=dict)
    joint_states: Mapping[str, JointStates] = field(default_factory=dict)

    def schema(self) -> bytes:
        """Returns the definition of the messages."""
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
        """The names of its numbers and arrays in messages, which ROS restricts."""
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
        """Returns a decoded packet as a message; arrays by `shapes`."""
        return self.encode_table(self.table(values))[0]

    def table(self, values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Returns a decoded packet as a table of one row, (1, k); arrays by `shapes`."""
        numbers = [np.asarray(values[key], np.float64).ravel() for key in self.shapes]
        return np.concatenate([*numbers, np.zeros(0)])[None]

    def encode_table(self, table: NDArray[np.float64]) -> list[bytes]:
        """Returns many decoded packets at once, each as `encode` does.

        Args:
            table: (packets, k), the numbers of all events in their order; matrices row by row.
        """
        if not self.shapes:
            return [CDR_HEAD + b"\0"] * len(table)
        rows = np.ascontiguousarray(table[:, self._order], "<f8")
        return [CDR_HEAD + row.tobytes() for row in rows]

    @cached_property
    def _order(self) -> NDArray[np.intp]:
        """The order of the numbers in messages: of frames the position comes first."""
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
    """The media type of a scene's or a robot's file, by the ending of its name."""
    types = {".toml": "application/toml", ".xml": "application/xml", ".urdf": "application/xml"}
    return types.get(name[name.rfind(".") :].lower(), "text/plain")
