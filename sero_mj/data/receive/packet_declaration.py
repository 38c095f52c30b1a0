"""Declaration of the packets of a source."""

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

# Fields that recordings store, because they are required for decoding packets.
_DECODING = (
    "is_double", "column_major", "alignment", "scale", "structure", "sequence", "time",
    "time_scale",
)  # fmt: skip
_SIGNS = ("torque_sign",)  # a field that only some kinds of sources have


class PacketDeclaration(Declaration):
    """Declaration of the packets of a source: their layout, sequence number and send time.

    Attributes:
        structure: layout of the packets, such as `7F1M`; see STRUCTURE.md.
        is_double: whether `F`, `V`, `M` and `T` in the structure are float64 instead of float32
            (key `double` in files).
        column_major: whether matrices are column-major instead of row-major.
        alignment: alignment of items in bytes: 1, 2, 4 or 8.
        scale: factor of all floating-point numbers, but only of the position in matrices.
        sequence: event with the sequence number, which can have any type, for detecting loss.
        time: event with the send time, for measuring jitter and delay.
        time_scale: unit of the send time in seconds.
    """

    is_double: bool = Field(True, alias="double")  # before structure, whose size depends on them
    column_major: bool = True
    alignment: Alignment = 1
    scale: float = Field(1.0, gt=0, lt=1e100)
    structure: str
    sequence: str = ""
    time: str = ""
    time_scale: float = Field(1.0, gt=0, lt=1e100)

    # Name of the protocol that determines these fields, so that files must not set them.
    _fixed_by: ClassVar[str] = ""
    # Origin of the structure, for kinds that do not declare it.
    _structure_is: ClassVar[str] = ""
    _nan_allowed: frozenset[str] = PrivateAttr(frozenset())

    @field_validator(*_DECODING, mode="before")
    @classmethod
    def _check_fixed(cls, value: Any, info: ValidationInfo) -> Any:
        assert info.field_name is not None
        if cls._fixed_by and value not in cls._fixed(info.field_name):
            reason = f"{cls._fixed_by} determines this field. Remove it"
            raise ValueError(f"found {shown(value)}; {reason}")
        return value

    @classmethod
    def _fixed(cls, field: str) -> Collection[Any]:
        return (cls.model_fields[field].default,)

    @field_validator("structure")
    @classmethod
    def _check_structure(cls, text: str, info: ValidationInfo) -> str:
        if cls._structure_is:
            if text:
                raise ValueError(f"is {cls._structure_is}. Remove it")
            return text
        try:
            _structure_of(text, info)
        except StructureError as error:
            raise ValueError(str(error)) from None
        return text

    @field_validator("sequence", "time")
    @classmethod
    def _check_number_event(cls, event: str, info: ValidationInfo) -> str:
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
        """Shapes by event name: (n,) for values, (n, 3) for vectors, (n, 4, 4) for matrices."""
        return self.layout.events

    @property
    def size(self) -> int:
        return self.layout.size

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        """Returns the state of the robot's controller and the link quality; -1 if unknown."""
        return self.layout.link_state(values)

    def describe_link(self, values: Mapping[str, Array]) -> str:
        """Returns a description of the robot controller's state; empty if a packet has none."""
        return ""

    def link_faults(self, state: float, quality: float) -> list[str]:
        """Returns descriptions of the faults that the values from `link_state` indicate."""
        return []

    def decoding_fields(self) -> dict[str, Any]:
        """Returns the fields that recordings store for decoding packets later, as JSON types."""
        required = {key for key, field in type(self).model_fields.items() if field.is_required()}
        kept = required.union(_DECODING, _SIGNS)
        fields = self.model_dump(mode="json", include=kept, exclude_defaults=True)
        return {key: value for key, value in fields.items() if value != ""}

    def _new_checker(self) -> Intake:
        return Intake(self.layout, nan_allowed=self._nan_allowed)

    def decode(self, packet: bytes) -> dict[str, Array] | None:
        """Decodes a packet without counting it; returns None if it would not be applied."""
        checker = self._new_checker()
        rows, _ = checker.take(*pad_packets([packet], self.size), np.zeros(1))
        if not len(rows):
            return None
        return {event: array[0] for event, array in checker.decode(rows).items()}

    def decode_rows(self, rows: Rows, lengths: Ints) -> tuple[dict[str, Array], Ints]:
        """Decodes n packets without counting them. The arguments are those of `Intake.take`.

        Returns:
            mapping from event names to arrays, shape (m, ...), and row indices of the m valid
            packets, shape (m,).
        """
        checker = self._new_checker()
        good, numbers = checker.take(rows, lengths, np.arange(len(rows), dtype=float))
        return checker.decode(good), numbers.astype(np.intp)


def _structure_of(text: str, info: ValidationInfo) -> Structure:
    is_double, alignment = info.data.get("is_double", True), info.data.get("alignment", 1)
    return Structure(text, is_double=is_double, alignment=alignment)
