"""A source that plays a table of numbers, with a packet for each row."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from ...base.errors import CsvError, Problem, UnknownName, did_you_mean, mismatch
from ...base.frames import Array
from ...data.receive.source import RoutedJoint, Source
from ...data.receive.structure import Structure
from ...data.receive.udp import UdpReceiver
from ...data.record.csv_files import TIME, column_names
from ...data.record.file_source import FileSource
from ...data.record.recording import PacketFile, RecordedSource
from .signals import signals_of, wrong_columns
from .table import Table, read_cached

SOURCE = "table"
_LAST_DATE = 2.5e11  # time in the last year that `datetime` supports, s
_EPOCH = datetime.fromtimestamp(0.0, UTC)


class TableFile(PacketFile):
    """The rows of a table as packets. Times are relative to the first row.

    Args:
        events: values of events by name, shape (T, ...). Other events of the structure are zero, or
            identity matrices.
        declared: fields of a source of kind `udp` that decodes the packets.
    """

    def __init__(
        self,
        table: Table,
        events: Mapping[str, Array],
        structure: Structure,
        declared: Mapping[str, Any],
    ) -> None:
        self.path, self.about, self.lost, self.faults = table.path, {}, {}, []
        first = float(table.times[0])  # time since 1970 or another date, s
        self.start = datetime.fromtimestamp(first, UTC) if 0 <= first < _LAST_DATE else _EPOCH
        self._times = table.times - first
        self.duration = float(self._times[-1])
        self._events, self._structure = events, structure
        count = len(self._times)
        self.sources = {
            SOURCE: RecordedSource(
                SOURCE, "udp", dict(declared), structure.events, structure.size, count, 0.0,
                self.duration,
            )
        }  # fmt: skip

    def packets(
        self, name: str, start: float = -math.inf, stop: float | None = None
    ) -> Iterator[tuple[float, bytes]]:
        self._check(name)
        first = int(np.searchsorted(self._times, start))
        last = None if stop is None else int(np.searchsorted(self._times, stop))
        for k in range(len(self._times))[first:last]:
            yield float(self._times[k]), self._packet(k)

    def last_before(self, name: str, t: float) -> tuple[float, bytes] | None:
        self._check(name)
        k = int(np.searchsorted(self._times, t, side="right")) - 1
        return None if k < 0 else (float(self._times[k]), self._packet(k))

    def _check(self, name: str) -> None:
        if name != SOURCE:
            raise UnknownName("source", name, [SOURCE])

    def _packet(self, k: int) -> bytes:
        shapes = self._structure.events
        frames = {
            event: np.broadcast_to(np.eye(4), shapes[event]) for event in self._structure.matrices
        }
        return self._structure.encode(
            {**frames, **{event: rows[k] for event, rows in self._events.items()}}
        )

    @property
    def attachments(self) -> tuple[str, ...]:
        return ()

    def read_attachment(self, name: str) -> bytes:
        raise UnknownName("file", name, [])

    def close(self) -> None:
        pass  # the table is already closed


def has_numbers(table: Table, events: Mapping[str, tuple[int, ...]]) -> bool:
    """Whether a column of a table is named after a number of an event, such as `joints[0]`."""
    return not set(table.columns).isdisjoint(column_names(events))


def events_of(table: Table, structure: Structure) -> dict[str, Array]:
    """Returns the values of the events of packets in a table, shape (T, ...); raises CsvError.

    Columns have the names that `export` writes, such as `joints[0]`. All columns of an event may be
    missing. If no column has such a name, the table must have all numbers of the packets, in order.
    """
    names, columns = column_names(structure.events), [*table.columns]
    places = dict(zip(columns, columns, strict=True))
    if not has_numbers(table, structure.events):
        if len(columns) != len(names):
            few = ", ".join(columns[:4])
            has = f"found {len(columns)} columns in addition to time: {few}, ..."
            wanted = ", ".join(names[:3])
            reason = f"{has}; expected {len(names)} for '{structure.text}', or {wanted}, ..."
            raise CsvError(table.path, reason)
        places = dict(zip(names, columns, strict=True))
    for name in places:
        if name not in names:
            reason = f"not a number of '{structure.text}'{did_you_mean(name, names)}"
            raise CsvError(table.path, reason, column=name)
    found: dict[str, Array] = {}
    for event, shape in structure.events.items():
        own = column_names({event: shape})
        missing = [name for name in own if name not in places]
        if 0 < len(missing) < len(own):
            few = ", ".join(missing[:4]) + (", ..." if len(missing) > 4 else "")
            has = f"has {len(own) - len(missing)} of the {len(own)} numbers of {event}"
            raise CsvError(table.path, f"{has}; missing columns: {few}")
        if not missing:
            numbers = np.stack([table.column(places[name]) for name in own], axis=1)
            found[event] = numbers.reshape(-1, *shape)
    return found


_PACKETS = ("structure", "is_double", "column_major", "alignment", "scale")


class TableReplay(FileSource):
    """A source that plays a table of numbers in the format of `read_table`.

    Its events are joint signals of a robot such as `joint_angles`, in columns that are recognized
    or declared. If `structure` is set, they are the events of packets.

    Attributes:
        columns: names of the columns of each signal: a pattern such as `"q_*"`, a list, or
            `time = "stamp"`. A unit can follow the signal in brackets: `"joint_angles [deg]"`.
        robot: robot name that column names can have as a prefix.
        structure: structure of packets whose numbers are in the table; `export` writes such tables.
        rate: rows per second, for a table without a time column.
    """

    name: str = "table"
    columns: dict[str, str | list[str]] = {}
    robot: str = ""
    rate: float | None = Field(None, gt=0, le=1e6)

    _structure_is: ClassVar[str] = ""
    # Joint names of the robot that the table moves.
    _joints: list[str] = PrivateAttr(default_factory=list)

    @field_validator("structure")
    @classmethod
    def _check_structure(cls, text: str, info: ValidationInfo) -> str:
        return super()._check_structure(text, info) if text else text

    @model_validator(mode="after")
    def _check_table(self) -> Self:
        try:
            table = self._table
        except CsvError as error:
            raise Problem("file", str(error)).error() from None
        if self.structure and self.columns.keys() - {TIME}:
            raise ValueError("structure and columns cannot be combined. Remove one of them")
        begin, end = self.start or 0.0, float(table.times[-1] - table.times[0])
        if begin > end:
            raise mismatch(begin, f"at most {end:g} s, the end of the table", key="start")
        if self.stop is not None and not begin < self.stop:
            raise mismatch(self.stop, f"more than {begin:g} s, the start", key="stop")
        return self

    @property
    def _table(self) -> Table:
        return read_cached(self.file, self.columns, self.rate)

    def set_joints(self, joints: Sequence[RoutedJoint]) -> None:
        self._joints = [joint.name for joint in joints]
        self.__dict__.pop("_events_of_rows", None)
        for key in ("recorded", "original", "layout"):
            self.__dict__.pop(key, None)

    @cached_property
    def _events_of_rows(self) -> dict[str, Array]:
        table = self._table
        if self.structure:
            return events_of(table, UdpReceiver(**self._packets, name=self.name).layout)
        found = signals_of(table, self._joints, self.columns, robot=self.robot)
        if not found:
            raise wrong_columns(table, len(self._joints), 'columns = { SIGNAL = "COLUMNS" }')
        return found

    @property
    def _packets(self) -> dict[str, Any]:
        return {key: getattr(self, key) for key in _PACKETS}

    @cached_property
    def original(self) -> Source:
        packets, rows = self._packets, self._events_of_rows
        if not self.structure:
            counts = {event: each.shape[1] for event, each in rows.items()}
            packets = {"structure": " ".join(f"{event}:{n}d" for event, n in counts.items())}
        receiver = UdpReceiver(**packets, name=self.name)
        receiver.only_latest_packet = self.only_latest_packet
        return receiver

    @cached_property
    def recorded(self) -> RecordedSource:
        return self.open_recording().sources[SOURCE]

    @cached_property
    def _begin(self) -> float:
        return self.start or 0.0

    def open_recording(self) -> PacketFile:
        declared = self.original.decoding_fields()
        return TableFile(self._table, self._events_of_rows, self.layout, declared)
