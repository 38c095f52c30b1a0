"""`TableReplay`: a table of numbers as a source."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Self

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from ...base.errors import (
    CsvError,
    Problem,
    mismatch,
)
from ...base.frames import Array
from ..receive.led_robot import LedJoint
from ..receive.source import Source
from ..receive.udp import UdpReceiver
from .csv_files import TIME
from .file_source import FileSource
from .recording import PacketFile, RecordedSource
from .table import Table
from .table_events import events_of
from .table_file import SOURCE, TableFile, cached_table
from .table_signals import signals_of, wrong_columns

_PACKETS = ("structure", "is_double", "column_major", "alignment", "scale")


class TableReplay(FileSource):
    """Plays a table of numbers: text whose cells are separated by commas, semicolons, tabs, blanks.

    Its events are the signals of a robot's joints (`joint_angles`, `torques`, ...), whose columns
    are recognised or declared; or, with a structure, those of packets.

    Attributes:
        file: the table.
        columns: signal to its columns: `"q_*"`, a list of names, or `time = "stamp"`. A unit in
            brackets behind the signal, `"joint_angles [deg]"`, is that of the numbers.
        robot: name that the columns' names may begin with.
        structure: packets with the numbers that columns are called like, as `export` writes
            them.
        rate: rows per s, for a table without times.
    """

    name: str = "table"
    columns: dict[str, str | list[str]] = {}
    robot: str = ""
    rate: float | None = Field(None, gt=0, le=1e6)

    _structure_is: ClassVar[str] = ""
    _joints: list[str] = PrivateAttr(default_factory=list)  # of the robot that it leads

    @field_validator("structure")
    @classmethod
    def _structure_parses(cls, text: str, info: ValidationInfo) -> str:
        return super()._structure_parses(text, info) if text else text

    @model_validator(mode="after")
    def _is_a_table(self) -> Self:
        try:
            table = self._table
        except CsvError as error:
            raise Problem("file", str(error)).error() from None
        if self.structure and self.columns.keys() - {TIME}:
            raise ValueError("structure and columns: expected one of them")
        begin, end = self.start or 0.0, float(table.times[-1] - table.times[0])
        if begin > end:
            raise mismatch(begin, f"at most {end:g}, where it ends", key="start")
        if self.stop is not None and not begin < self.stop:
            raise mismatch(self.stop, f"more than {begin:g}, in s", key="stop")
        return self

    @property
    def _table(self) -> Table:
        time = self.columns.get(TIME, "")
        return cached_table(
            self.file, rate=self.rate, time=time if isinstance(time, str) else time[0]
        )

    def led_to(self, joints: Sequence[LedJoint]) -> None:
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
        """Opens the table as if it were a recording of its rows; raises CsvError."""
        declared = self.original.decoding_fields()
        return TableFile(self._table, self._events_of_rows, self.layout, declared)
