"""`PacketDeclaration`: the fields that declare the layout of a source's packets."""

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

# The fields that recordings store, because packets are decoded by them.
_DECODING = (
    "is_double", "column_major", "alignment", "scale", "structure", "sequence", "time",
    "time_scale",
)  # fmt: skip
_SIGNS = ("torque_sign",)  # only some kinds have it


class PacketDeclaration(Declaration):
    """The layout of packets, and the events with their sequence number and send time.

    Attributes:
        structure: layout of the packets, such as `7F1M`; see STRUCTURE.md.
        is_double: whether `F`, `V`, `M` and `T` in the structure are float64 instead of float32
            (key `double` in files).
        column_major: matrices are column-major, otherwise row-major.
        alignment: alignment of items in bytes: 1, 2, 4 or 8.
        scale: factor of all floating-point numbers; for matrices, of the position only.
        sequence: event with the sequence number, of any type (also 1d), to detect loss.
        time: event with the send time, to measure jitter and delay.
        time_scale: seconds per unit of `time`.
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
    # Description of where the structure comes from, for kinds that do not declare it.
    _structure_is: ClassVar[str] = ""
    _nan_allowed: frozenset[str] = PrivateAttr(frozenset())

    @field_validator(*_DECODING, mode="before")
    @classmethod
    def _check_fixed(cls, value: Any, info: ValidationInfo) -> Any:
        assert info.field_name is not None
        if cls._fixed_by and value not in cls._fixed(info.field_name):
            reason = f"{cls._fixed_by} determines this field. Leave it out"
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
                raise ValueError(f"is {cls._structure_is}. Leave it out")
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
        """Event name to shape: (n,) for values, (n, 3) for vectors, (n, 4, 4) for matrices."""
        return self.layout.events

    @property
    def size(self) -> int:
        return self.layout.size

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        """Returns the state of the robot's controller and the link quality; -1 if unknown."""
        return self.layout.link_state(values)

    def describe_link(self, values: Mapping[str, Array]) -> str:
        """Returns the state of the robot's controller in words; empty if a packet has none."""
        return ""

    def link_faults(self, state: float, quality: float) -> list[str]:
        """Returns descriptions of the faults that values of `link_state` mean."""
        return []

    def decoding_fields(self) -> dict[str, Any]:
        """Returns the fields by which packets are decoded, and required fields, as JSON types."""
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
        """Decodes n packets, in rows as for `Intake.take`, without counting them.

        Returns:
            event name to arrays (m, ...), and the rows of the m valid packets, (m,).
        """
        checker = self._new_checker()
        good, numbers = checker.take(rows, lengths, np.arange(len(rows), dtype=float))
        return checker.decode(good), numbers.astype(np.intp)


def _structure_of(text: str, info: ValidationInfo) -> Structure:
    is_double, alignment = info.data.get("is_double", True), info.data.get("alignment", 1)
    return Structure(text, is_double=is_double, alignment=alignment)
