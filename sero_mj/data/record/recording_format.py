"""The format of recordings in MCAP: topics, metadata, the two clocks, and JSON.

    metadata `sero-mj`    format, version, started, start_epoch_ns, start_monotonic_ns
    metadata `about`      what the recording is of: scene, robot, ...
    metadata `lost`       source to the number of packets that could not be kept, where there are
    channel /NAME/raw     a source's packets, byte for byte; its metadata says how to decode them
    channel /NAME/signals what the good ones of them mean, as JSON that Foxglove and PlotJuggler
                          plot; its metadata says of every name where its number comes from
    channel /ROBOT/joint_states   likewise the states of a robot's joints, as ROS has them
    attachments           the scene file and its robots' files

A message's log time is when the packet arrived, in ns since the epoch. It is the monotonic clock
with a constant offset set at the start of the recording: it never jumps, and differences are exact
to the ns.

Numbers with individual names (`lwr.A1.torque [Nm]`) are members of a JSON message. Foxglove refuses
a whole channel if its schema has an array of arrays. Therefore other values are an array of
numbers; vectors an array of `{x, y, z}`; matrices an array of `{position: {x, y, z}, rotation: [9
numbers, row by row]}`, which defines a frame. NaN and infinity, which JSON lacks, are null. Numbers
have seven significant digits, enough for a plot; the raw packets have all digits.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ... import __version__
from ...base.errors import Problem
from .joint_state_messages import JointStates

FORMAT = 1
ABOUT, CLOCK, LOST = "about", "sero-mj", "lost"
SOURCE_KEY = "sero-mj"  # in the metadata of a raw channel
RAW_ENCODING = "application/octet-stream"
SIGNALS_ENCODING, SCHEMA_ENCODING = "json", "jsonschema"
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
            raise Problem("arrival", found=arrival, expected="seconds on time.monotonic").error()
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
        events: event name to its shape.
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


_NUMBER = {"type": "number"}
_POINT = {"type": "object", "properties": {axis: _NUMBER for axis in "xyz"}}
_FRAME = {
    "type": "object",
    "properties": {"position": _POINT, "rotation": {"type": "array", "items": _NUMBER}},
}
_VECTORS, _MATRICES = (3,), (4, 4)  # the shape of one item
_DIGITS = "%.7g"
_POINT_TEXT = f'{{"x":{_DIGITS},"y":{_DIGITS},"z":{_DIGITS}}}'
_FRAME_TEXT = f'{{"position":{_POINT_TEXT},"rotation":[{",".join([_DIGITS] * 9)}]}}'


@dataclass(frozen=True, eq=False)
class Signals:
    """The contents of a source's messages, and their names.

    Attributes:
        shapes: event, or routed input, to its shape: (n,), (n, 3) or (n, 4, 4).
        names: one of these to the names of its numbers, n; the others are arrays.
        origins: such a name to the origin of its number: `values1[0]`.
        joint_states: robot to which of these are the states of its joints.
    """

    shapes: Mapping[str, tuple[int, ...]]
    names: Mapping[str, Sequence[str]] = field(default_factory=dict)
    origins: Mapping[str, str] = field(default_factory=dict)
    joint_states: Mapping[str, JointStates] = field(default_factory=dict)

    def schema(self, title: str) -> bytes:
        """Returns the JSON Schema of the messages."""
        items = {_VECTORS: _POINT, _MATRICES: _FRAME}
        properties: dict[str, Any] = {}
        for key, shape in self.shapes.items():
            if key in self.names:
                for name in self.names[key]:
                    origin = self.origins.get(name)
                    properties[name] = {**_NUMBER, **({"description": origin} if origin else {})}
            else:
                item = items.get(tuple(shape[1:]), _NUMBER)
                properties[key] = {"type": "array", "items": item}
        return json.dumps({"title": title, "type": "object", "properties": properties}).encode()

    def encode(self, values: Mapping[str, NDArray[np.float64]]) -> bytes:
        """Returns a decoded packet as a message; arrays by `shapes`."""
        return self.encode_table(self.table(values))[0] if self.shapes else b"{}"

    def table(self, values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Returns a decoded packet as a table of one row, (1, k); arrays by `shapes`."""
        numbers = [np.asarray(values[key], np.float64).ravel() for key in self.shapes]
        return np.concatenate([*numbers, np.zeros(0)])[None]

    def encode_table(self, table: NDArray[np.float64]) -> list[bytes]:
        """Returns many decoded packets at once, each as `encode` does.

        Args:
            table: (packets, k), the numbers of all events in their order; matrices row by row.
        """
        template, order = self._template
        if order is not None:
            table = table[:, order]
        rows: list[list[float]] = table.tolist()
        finite = np.isfinite(table)
        if finite.all():
            return [(template % tuple(row)).encode() for row in rows]
        text = template.replace(_DIGITS, "%s")
        return [
            (text % tuple(_DIGITS % x if k else "null" for x, k in zip(row, known, strict=True)))
            .encode()
            for row, known in zip(rows, finite.tolist(), strict=True)
        ]  # fmt: skip

    @cached_property
    def _template(self) -> tuple[str, NDArray[np.intp] | None]:
        """The message template with a placeholder for every number, and the order of numbers.

        The latter is None if the order is unchanged.
        """
        members, order, first = [], [], 0
        for key, shape in self.shapes.items():
            count = int(np.prod(shape))
            places = np.arange(first, first + count)
            first += count
            if key in self.names:
                members += [f"{_quoted(name)}:{_DIGITS}" for name in self.names[key]]
                order.append(places)
                continue
            if shape[1:] == _VECTORS:
                items = [_POINT_TEXT] * shape[0]
            elif shape[1:] == _MATRICES:
                items = [_FRAME_TEXT] * shape[0]
                frames = places.reshape(-1, 4, 4)
                parts = frames[:, :3, 3], frames[:, :3, :3].reshape(-1, 9)
                places = np.concatenate(parts, axis=1).ravel()
            else:
                items = [_DIGITS] * count
            members.append(f"{_quoted(key)}:[{','.join(items)}]")
            order.append(places)
        places = np.concatenate(order) if order else np.arange(0)
        as_they_come = np.array_equal(places, np.arange(first))
        return f"{{{','.join(members)}}}", None if as_they_come else places


def media_type(name: str) -> str:
    """The media type of a scene's or a robot's file, by the ending of its name."""
    types = {".toml": "application/toml", ".xml": "application/xml", ".urdf": "application/xml"}
    return types.get(name[name.rfind(".") :].lower(), "text/plain")


def _quoted(name: str) -> str:
    return json.dumps(name).replace("%", "%%")
