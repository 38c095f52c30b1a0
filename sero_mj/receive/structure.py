"""`Structure`: a decoder and encoder for the packets that a structure string describes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StructureError, UnknownName
from .language import KINDS, MAX_PACKET_BYTES, Item, parse

Array = NDArray[np.float64]
Rows = NDArray[np.uint8]
Alignment = Literal[1, 2, 4, 8]

_LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_DOUBLE = np.dtype("<f8")


@dataclass(frozen=True)
class Field:
    """Where an item of the string stands in the packet.

    Attributes:
        item: what it is.
        offset: its first byte.
        shape: of its event's array.
    """

    item: Item
    offset: int
    shape: tuple[int, ...]

    @property
    def wire_shape(self) -> tuple[int, ...]:
        """How its numbers stand in the packet, row by row."""
        if self.item.kind == "x":
            return (self.item.count,)
        return (self.item.count, *KINDS[self.item.kind][1])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of its numbers in the packet."""
        return np.dtype(self.item.type)

    @property
    def end(self) -> int:
        """The byte after its last."""
        return self.offset + self.item.numbers * self.item.item_bytes

    @property
    def is_float(self) -> bool:
        """Whether NaN can stand there, and whether `scale` is applied to it."""
        return self.dtype.kind == "f"


class Structure:
    """A decoder and encoder for one packet layout, built once.

    Args:
        text: the structure string; STRUCTURE.md explains it.
        is_double: `F`, `V`, `M` and `T` are float64 when true, else float32.
        column_major: matrices come column by column when true, else row by row.
        alignment: every item starts at a multiple of this many bytes from the packet's start, as
            Simulink's Byte Pack has it.
        scale: every floating-point number is multiplied by it; of matrices only the position.

    Attributes:
        text: the structure string.
        column_major: how matrices come.
        scale: see above.
        fields: all items of the string, with their places.
        events: event name to the shape of its array.
        matrices: names of the events that are matrices.
        size: bytes of a packet.

    Raises:
        StructureError: points at the first character that is wrong.
    """

    def __init__(
        self,
        text: str,
        *,
        is_double: bool = True,
        column_major: bool = True,
        alignment: Alignment = 1,
        scale: float = 1.0,
    ) -> None:
        self.text = text
        self.column_major = column_major
        self.scale = scale
        self.fields: list[Field] = []
        self.size = 0
        for item in parse(text, is_double=is_double):
            offset = -(-self.size // alignment) * alignment
            shape = (item.count, *(KINDS[item.kind][1] if item.kind in KINDS else ()))
            self.fields.append(Field(item, offset, (*shape[:1], 4, 4) if shape[1:] else shape))
            if item.kind == "V":
                self.fields[-1] = Field(item, offset, shape)
            self.size = self.fields[-1].end
            if self.size > MAX_PACKET_BYTES:
                reason = f"the packet would be too long; expected at most {MAX_PACKET_BYTES} bytes"
                raise StructureError(text, item.at, reason)
        self._by_event = {field.item.name: field for field in self.fields if field.item.name}
        self.events = {name: field.shape for name, field in self._by_event.items()}
        self.matrices = tuple(name for name, shape in self.events.items() if len(shape) == 3)
        self.dtype = np.dtype(
            {
                "names": list(self.events),
                "formats": [(f.dtype, f.wire_shape) for f in self._by_event.values()],
                "offsets": [field.offset for field in self._by_event.values()],
                "itemsize": self.size,
            }
        )
        # Event, type, first byte, count, and whether nothing but a view is needed.
        self._plan = [
            (name, field.dtype, field.offset, field.item.numbers, self._is_plain(field))
            for name, field in self._by_event.items()
        ]

    def _is_plain(self, field: Field) -> bool:
        scaled = field.is_float and self.scale != 1.0
        return field.dtype == _DOUBLE and len(field.shape) == 1 and not scaled

    def decode(self, packet: bytes | bytearray | memoryview) -> dict[str, Array]:
        """Returns every event's array, float64, in the shapes of `events`.

        Little-endian float64 is not copied: such arrays are views into the packet. Constants are
        not looked at: see `find_wrong_constant`.

        Raises:
            ValueError: the packet is not `size` bytes long.
        """
        if len(packet) != self.size:
            raise ValueError(f"found {len(packet)} bytes; expected {self.size} for '{self.text}'")
        values = {}
        for name, dtype, offset, count, is_plain in self._plan:
            numbers = np.frombuffer(packet, dtype, count, offset)
            values[name] = numbers if is_plain else self._finished(name, numbers[None])[0]
        return values

    def decode_rows(self, rows: Rows) -> dict[str, Array]:
        """Decodes many packets at once; every array has one more axis at the front.

        Args:
            rows: (n, `size` or more), one packet a row.
        """
        return {
            name: self._finished(name, self._numbers(rows, field))
            for name, field in self._by_event.items()
        }

    def field(self, event: str) -> Field:
        """Where an event stands in the packet; raises UnknownName."""
        if event not in self._by_event:
            raise UnknownName("event", event, self.events)
        return self._by_event[event]

    def event_rows(self, rows: Rows, event: str) -> NDArray[Any]:
        """One event's numbers of many packets as they stand there, of their own type, (n, ...)."""
        return self._numbers(rows, self._by_event[event])

    def _numbers(self, rows: Rows, field: Field) -> NDArray[Any]:
        return rows[:, field.offset : field.end].view(field.dtype)

    def _finished(self, name: str, numbers: NDArray[Any]) -> Array:
        """Numbers (n, count) of an event as float64 in the event's shape behind n."""
        field = self._by_event[name]
        shape = field.shape
        if field.item.is_bool:
            numbers = numbers != 0
        with np.errstate(invalid="ignore", over="ignore"):  # a signalling NaN would warn
            values = numbers.astype(np.float64, copy=False)
            if len(shape) == 3:
                values = self._matrices(values, field)
                if self.scale != 1.0 and field.is_float:
                    values = values.copy()
                    values[..., :3, 3] *= self.scale
                return values
            if self.scale != 1.0 and field.is_float:
                values = values * self.scale
        return values.reshape(len(values), *shape) if len(shape) > 1 else values

    def _matrices(self, values: Array, field: Field) -> Array:
        """Frames (n, count, 4, 4) from numbers (n, count * 12 or 16)."""
        rows = 4 if field.item.kind == "M" else 3
        n, count = len(values), field.item.count
        if self.column_major:
            values = values.reshape(n, count, 4, rows).swapaxes(-1, -2)
        else:
            values = values.reshape(n, count, rows, 4)
        if rows == 4:
            return values
        frames = np.empty((n, count, 4, 4))
        frames[..., :3, :] = values
        frames[..., 3, :] = _LAST_ROW
        return frames

    def find_not_finite(self, rows: Rows, but: Collection[str] = ()) -> NDArray[np.bool_]:
        """Which packets have NaN or infinity outside the events `but`, (n,)."""
        bad = np.zeros(len(rows), bool)
        with np.errstate(invalid="ignore", over="ignore"):
            for start, end, dtype in self._float_blocks(frozenset(but)):
                numbers = rows[:, start:end].view(dtype)
                if self.scale != 1.0:
                    numbers = numbers.astype(np.float64) * max(self.scale, 1.0)
                bad |= ~np.isfinite(numbers).all(axis=1)
        return bad

    def _float_blocks(self, but: frozenset[str]) -> list[tuple[int, int, np.dtype[Any]]]:
        """First and last byte of what one look can check: neighbours of one type together."""
        cached = getattr(self, "_blocks", None)
        if cached is not None and cached[0] == but:
            return list(cached[1])
        blocks: list[tuple[int, int, np.dtype[Any]]] = []
        for name, field in self._by_event.items():
            if not field.is_float or name in but:
                continue
            if blocks and blocks[-1][1] == field.offset and blocks[-1][2] == field.dtype:
                blocks[-1] = (blocks[-1][0], field.end, field.dtype)
            else:
                blocks.append((field.offset, field.end, field.dtype))
        self._blocks = (but, blocks)
        return blocks

    def find_wrong_constants(self, rows: Rows) -> NDArray[np.bool_]:
        """Which packets have another number where the string demands one, (n,)."""
        bad = np.zeros(len(rows), bool)
        for field, constant in self._constants():
            bad |= (self._numbers(rows, field) != constant).any(axis=1)
        return bad

    def tell_wrong_constant(self, rows: Rows) -> str:
        """Says what is wrong with the first packet's constants; empty when nothing is."""
        for field, constant in self._constants():
            numbers = self._numbers(rows[:1], field)[0]
            if (wrong := numbers != constant).any():
                found, expected = numbers[wrong][0], constant
                hexed = f" (0x{int(found):x})" if field.dtype.kind in "iu" and found >= 0 else ""
                name = f"{field.item.name} " if field.item.name else ""
                return f"{name}at byte {field.offset} is {found}{hexed}; expected {expected}"
        return ""

    def _constants(self) -> list[tuple[Field, Any]]:
        found = []
        for field in self.fields:
            if field.item.is_size or field.item.constant is not None:
                value = self.size if field.item.is_size else field.item.constant
                found.append((field, field.dtype.type(value)))
        return found

    def encode(self, values: Mapping[str, ArrayLike]) -> bytes:
        """Returns the packet that carries these events; events that are not given are zero.

        Constants are written, `scale` is undone.

        Args:
            values: event name to an array in the shape of `events`. A leading 1 may be left out:
                (4, 4) will do for (1, 4, 4).

        Raises:
            UnknownName: an event that this structure does not have.
            ValueError: an event of another shape, or a number that its type cannot hold.
        """
        packet = np.zeros(self.size, np.uint8)
        for field, constant in self._constants():
            packet[field.offset : field.end].view(field.dtype)[:] = constant
        for name, given in values.items():
            if name not in self.events:
                raise UnknownName("event", name, self.events)
            shape = self.events[name]
            allowed = [shape, shape[1:]] if shape[0] == 1 else [shape]
            array = np.asarray(given)
            if array.shape not in allowed:
                expected = " or ".join(map(str, allowed))
                raise ValueError(f"{name}: found {array.shape}; expected {expected}")
            self._write(packet, name, array.reshape(shape))
        return packet.tobytes()

    def _write(self, packet: Rows, name: str, array: NDArray[Any]) -> None:
        field = self._by_event[name]
        if len(field.shape) == 3:
            array = np.array(array[:, : 4 if field.item.kind == "M" else 3], np.float64)
            if self.scale != 1.0 and field.is_float:
                array[:, :3, 3] /= self.scale
            array = array.swapaxes(1, 2) if self.column_major else array
        elif self.scale != 1.0 and field.is_float:
            array = array / self.scale
        if field.dtype.kind in "iu":
            limits = np.iinfo(field.dtype)
            with np.errstate(invalid="ignore"):
                array = np.rint(array) if array.dtype.kind == "f" else array
                fits = (array >= limits.min) & (array < float(limits.max) + 1.0)
            if not fits.all():
                raise ValueError(
                    f"{name}: found {array[~fits].flat[0]}; expected whole numbers from "
                    f"{limits.min} to {limits.max}"
                )
        with np.errstate(over="ignore", invalid="ignore"):
            packet[field.offset : field.end].view(field.dtype)[:] = array.ravel()
