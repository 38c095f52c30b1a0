"""`PacketDeclaration`: what the packets of a source mean, wherever they come from."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from ...base.declaration import Declaration
from ...base.errors import Problem, StructureError, shown
from ...base.frames import Array, Ints
from .intake import Intake, pad_packets
from .structure import Alignment, Rows, Structure

# The fields that determine the meaning of packets, not their origin.
_DECODING = (
    "is_double", "column_major", "alignment", "scale", "structure", "sequence", "time",
    "time_scale",
)  # fmt: skip
_SIGNS = ("torque_sign",)  # of the kinds that have it, where files may set it


class PacketDeclaration(Declaration):
    """The layout of packets, and which of their events number and date them.

    Attributes:
        structure: layout of the packets, e.g. `7F1M`; see STRUCTURE.md.
        is_double: `F`, `V`, `M` and `T` are float64, else float32 (`double` in files).
        column_major: matrices are column-major, else row-major.
        alignment: of items, bytes: 1, 2, 4 or 8.
        scale: factor of every floating-point number, of matrices the position; not `sequence`,
            `time`.
        sequence: event that numbers the packets, of any type (also 1d), to detect loss.
        time: event with a packet's send time, to measure jitter and delay.
        time_scale: s per unit of `time`.
    """

    is_double: bool = Field(True, alias="double")  # before structure, whose size depends on them
    column_major: bool = True
    alignment: Alignment = 1
    scale: float = Field(1.0, gt=0, lt=1e100)
    structure: str
    sequence: str = ""
    time: str = ""
    time_scale: float = Field(1.0, gt=0, lt=1e100)

    # What fixes these fields, so that no file may: `FRI`, or nothing.
    _fixed_by: ClassVar[str] = ""
    # The origin of the structure, for kinds whose structure cannot be declared.
    _structure_is: ClassVar[str] = ""
    _nan_allowed: frozenset[str] = PrivateAttr(frozenset())

    @field_validator(*_DECODING, mode="before")
    @classmethod
    def _is_fixed(cls, value: Any, info: ValidationInfo) -> Any:
        assert info.field_name is not None
        if cls._fixed_by and value not in cls._fixed(info.field_name):
            raise ValueError(f"found {shown(value)}; {cls._fixed_by} fixes it: leave it out")
        return value

    @classmethod
    def _fixed(cls, field: str) -> Collection[Any]:
        return (cls.model_fields[field].default,)

    @field_validator("structure")
    @classmethod
    def _structure_parses(cls, text: str, info: ValidationInfo) -> str:
        if cls._structure_is:
            if text:
                raise ValueError(f"is {cls._structure_is}; leave it out")
            return text
        try:
            _structure_of(text, info)
        except StructureError as error:
            raise ValueError(str(error)) from None
        return text

    @field_validator("sequence", "time")
    @classmethod
    def _is_one_number(cls, event: str, info: ValidationInfo) -> str:
        if not event or cls._structure_is or "structure" not in info.data:
            return event
        events = _structure_of(info.data["structure"], info).events
        if event not in events:
            where = "in the structure"
            raise Problem("", "no event", found=event, of=where, available=events).error()
        if events[event] != (1,):
            found = " x ".join(map(str, events[event]))
            raise ValueError(f"'{event}' has {found} numbers; expected one, as in {event}:1I")
        return event

    @cached_property
    def layout(self) -> Structure:
        return Structure(
            self.structure,
            is_double=self.is_double,
            column_major=self.column_major,
            alignment=self.alignment,
            scale=self.scale,
        )

    @property
    def events(self) -> Mapping[str, tuple[int, ...]]:
        """Event name to its shape: (n,) values, (n, 3) vectors, (n, 4, 4) matrices."""
        return self.layout.events

    @property
    def size(self) -> int:
        return self.layout.size

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        """State of the robot's controller and quality of the link to it; -1 where unknown."""
        return self.layout.link_state(values)

    def describe_link(self, values: Mapping[str, Array]) -> str:
        """What a packet says of the robot's controller, in words; empty if nothing."""
        return ""

    def link_faults(self, state: float, quality: float) -> list[str]:
        """What is wrong with the robot's controller or the link to it, one per line.

        Args:
            state: as in `link_state`.
        """
        return []

    def decoding_fields(self) -> dict[str, Any]:
        """The fields that determine the meaning of packets, as JSON types; for recordings.

        Required fields (such as `block`) are included.
        """
        required = {key for key, field in type(self).model_fields.items() if field.is_required()}
        kept = required.union(_DECODING, _SIGNS)
        fields = self.model_dump(mode="json", include=kept, exclude_defaults=True)
        return {key: value for key, value in fields.items() if value != ""}

    def _judge(self) -> Intake:
        return Intake(self.layout, nan_allowed=self._nan_allowed)

    def decode(self, packet: bytes) -> dict[str, Array] | None:
        """Decodes one packet without counting it; None if it would not be applied."""
        judge = self._judge()
        rows, _ = judge.take(*pad_packets([packet], self.size), np.zeros(1))
        if not len(rows):
            return None
        return {event: array[0] for event, array in judge.decode(rows).items()}

    def decode_rows(self, rows: Rows, lengths: Ints) -> tuple[dict[str, Array], Ints]:
        """Decodes packets separately, without counting them.

        Args:
            rows: (n, bytes), a packet each, as passed to taps.
            lengths: of the packets, (n,).

        Returns:
            event name to its arrays (m, ...), and the indices of their rows, (m,).
        """
        judge = self._judge()
        good, numbers = judge.take(rows, lengths, np.arange(len(rows), dtype=float))
        return judge.decode(good), numbers.astype(np.intp)


def _structure_of(text: str, info: ValidationInfo) -> Structure:
    """The structure of a declaration, given its previously validated fields."""
    is_double, alignment = info.data.get("is_double", True), info.data.get("alignment", 1)
    return Structure(text, is_double=is_double, alignment=alignment)
