"""`Structure`: a decoder and encoder for packets described by a structure string.

`are_frames` checks whether decoded matrices are rigid frames.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.errors import (
    Problem,
    UnknownName,
    mismatch,
)
from ...base.frames import Array, Ints
from .checksum import compute
from .language import Item, limits, parse

Rows = NDArray[np.uint8]  # packets, or addresses of their senders, one per row
# First and last byte, type, and the selected numbers in between; None for all of them.
_Block = tuple[int, int, np.dtype[Any], Ints | None]
_Bounds = tuple[_Block, Array]  # and the largest magnitudes of the selected numbers
Alignment = Literal[1, 2, 4, 8]
TorqueSign = Literal[-1, 1]

_ROTATION_TOLERANCE = 1e-3  # as in `nearest_rotation` for frames in files
# Much smaller: a transposed frame has its position there, which may be only 1 mm.
LAST_ROW_TOLERANCE = 1e-6
LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_IDENTITY = np.eye(3)
_DOUBLE = np.dtype(np.float64)


_ALIGNMENTS: tuple[Alignment, ...] = (1, 2, 4, 8)


class Structure:
    """A decoder and encoder for one packet layout, built once.

    Args:
        text: the structure string; STRUCTURE.md explains it.
        is_double: `F`, `V`, `M` and `T` are float64 when true, else float32.
        alignment: every item begins at a multiple of this many bytes from the packet's start, as in
            Simulink's Byte Pack.
        scale: every floating-point number is multiplied by it, except those checked against a
            constant; of matrices only the position.
        signs: event name to a factor of its numbers, 1 or -1, for senders with another convention
            of signs; not for matrices.

    Attributes:
        size: bytes of a packet.
        message: what packets are called that come encoded, of any size, and are turned into ones of
            `size` bytes by `unpack`; empty if they come as they are.
        dtype: numpy's record type of a packet: the raw numbers of every event.

    Raises:
        StructureError: points at the first invalid character.
        ValueError: the alignment is not 1, 2, 4 or 8, or the scale is not above 0.
    """

    message: str = ""
    fault: str = ""  # why the last message makes no packet

    def __init__(
        self,
        text: str,
        *,
        is_double: bool = True,
        column_major: bool = True,
        alignment: Alignment = 1,
        scale: float = 1.0,
        signs: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        if alignment not in _ALIGNMENTS:
            raise mismatch(alignment, "1, 2, 4 or 8", key="alignment")
        if not 0.0 < scale < math.inf:
            raise mismatch(scale, "a finite number above 0", key="scale")
        self.text = text
        self.is_double = is_double
        self.column_major = column_major
        self.alignment = alignment
        self.scale = scale
        self.signs = dict(signs)
        self.fields = tuple(parse(text, is_double=is_double, alignment=alignment))
        self.size = self.fields[-1].end
        self._by_event = {item.name: item for item in self.fields if item.name}
        self.events = {name: item.shape for name, item in self._by_event.items()}
        self.matrices = tuple(name for name, shape in self.events.items() if len(shape) == 3)
        self.dtype = np.dtype(
            {
                "names": list(self.events),
                "formats": [(item.type, item.wire_shape) for item in self._by_event.values()],
                "offsets": [item.offset for item in self._by_event.values()],
                "itemsize": self.size,
            }
        )
        self._constants = [
            (item, item.dtype.type(item.constant))
            for item in self.fields
            if item.constant is not None
        ]
        self.checksums = tuple(item for item in self.fields if item.checksum)
        # Event, type, first byte, count, and the conversion unless it is a view.
        self._plan = [
            (name, item.dtype, item.offset, item.numbers, self._unless_plain(item))
            for name, item in self._by_event.items()
        ]
        self._is_plain = not any(item for *_, item in self._plan)
        self._blocks: dict[frozenset[str], list[_Block]] = {}

    def unpack(self, rows: Rows, lengths: Ints) -> tuple[Rows, Ints]:
        """Turns packets as they come into those that this structure describes.

        Args:
            rows: as received, (n, any number of bytes).
            lengths: of the packets, (n,), bytes; may exceed the row.

        Returns:
            rows (n, `size` or more) and lengths (n,), which are not `size` where a packet cannot be
            read; here those given.
        """
        return rows, lengths

    def describe_wrong_size(self, packet: bytes, length: int) -> str:
        """Describes why a packet of that length, as it came, cannot be one of these.

        Args:
            packet: its first bytes at least.
            length: of all of it, bytes.
        """
        hint = self.for_size(length)
        return f"{length} bytes; expected {self.size}{hint and f'; {hint}'}"

    def for_size(self, size: int) -> str:
        """Suggests what would explain a different size: alignment, float32, padding.

        Empty if none of these does.
        """
        found = []
        for alignment in _ALIGNMENTS[_ALIGNMENTS.index(self.alignment) :]:
            for is_double in (self.is_double, not self.is_double):
                end = Structure(self.text, is_double=is_double, alignment=alignment).size
                # Padding of a C compiler at the end, so that the next element of an array is
                # aligned.
                padding = size - end
                if not 0 <= padding < _ALIGNMENTS[-1] or (padding and size % max(alignment, 4)):
                    continue
                parts = []
                if alignment != self.alignment:
                    parts.append(f"alignment = {alignment}")
                if is_double != self.is_double:
                    parts.append(f"double = {'true' if is_double else 'false'}")
                if padding:
                    parts.append(f"{padding}x at its end")
                if parts:
                    found.append((len(parts), padding, f"with {' and '.join(parts)} it has {size}"))
        return min(found)[-1] if found else ""

    def _unless_plain(self, item: Item) -> Item | None:
        is_plain = item.dtype == _DOUBLE and len(item.shape) == 1
        return None if is_plain and self._factor(item) == 1.0 else item

    def _factor(self, item: Item) -> float:
        is_scaled = item.is_float and item.constant is None
        return self.signs.get(item.name, 1.0) * (self.scale if is_scaled else 1.0)

    def decode(self, packet: bytes | bytearray | memoryview) -> dict[str, Array]:
        """Returns every event's array, float64, in the shapes of `events`; raises ValueError.

        Little-endian float64 is not copied: such arrays are views into the packet, and read-only if
        it is; 3 x 4 matrices are copied. Constants are not checked: see `find_wrong_constants`.
        """
        if len(packet) != self.size:
            raise mismatch(len(packet), f"{self.size} for '{self.text}'", of="bytes")
        values = {}
        if self._is_plain:  # without the cost of `errstate`
            for name, dtype, offset, count, _ in self._plan:
                values[name] = np.frombuffer(packet, dtype, count, offset)
            return values
        with np.errstate(invalid="ignore", over="ignore"):  # a signalling NaN would warn
            for name, dtype, offset, count, item in self._plan:
                numbers = np.frombuffer(packet, dtype, count, offset)
                values[name] = self._finished(item, numbers) if item else numbers
        return values

    def decode_rows(self, rows: Rows, events: Collection[str] | None = None) -> dict[str, Array]:
        """Decodes many packets together; every array has an additional first axis.

        Arrays not copied by `decode` are views into `rows` here.

        Args:
            rows: (n, `size` or more), one packet a row.
            events: the requested ones; all of them when None.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            return {
                name: self._finished(item := self._by_event[name], _numbers(rows, item))
                for name in (self._by_event if events is None else events)
                if name in self._by_event
            }

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        """Returns the state of the controller and the quality of its link; -1 if unknown."""
        return -1.0, -1.0

    @property
    def required_frames(self) -> tuple[str, ...]:
        """Matrices that make a packet malformed unless they are frames or NaN."""
        return self.matrices

    def field(self, event: str) -> Item:
        """The item of an event in the packet; raises UnknownName."""
        if event not in self._by_event:
            raise UnknownName("event", event, self.events)
        return self._by_event[event]

    def event_rows(self, rows: Rows, event: str) -> NDArray[Any]:
        """The raw numbers of an event in many packets, of their own type, (n, k)."""
        return _numbers(rows, self._by_event[event])

    def _finished(self, item: Item, numbers: NDArray[Any]) -> Array:
        """Numbers (..., k) of an item as float64, reshaped to (..., shape of the event)."""
        if item.is_bool:
            numbers = numbers != 0
        values: Array = numbers.astype(np.float64, copy=False)
        before, factor = numbers.shape[:-1], self._factor(item)
        if len(item.shape) == 3:
            frames = self._frames(values, item, before)
            if factor != 1.0:
                frames = frames.copy()
                frames[..., :3, 3] *= factor
            return frames
        if factor != 1.0:
            values = values * factor
        return values.reshape(*before, *item.shape) if len(item.shape) > 1 else values

    def _frames(self, values: Array, item: Item, before: tuple[int, ...]) -> Array:
        """Frames (..., count, 4, 4) from numbers (..., 12 or 16 times count)."""
        count, rows, columns = item.wire_shape
        if self.column_major:
            values = values.reshape(*before, count, columns, rows).swapaxes(-1, -2)
        else:
            values = values.reshape(*before, count, rows, columns)
        if rows == 4:
            return values
        frames = np.empty((*before, count, 4, 4))
        frames[..., :3, :] = values
        frames[..., 3, :] = LAST_ROW
        return frames

    def find_not_finite(self, rows: Rows, but: Collection[str] = ()) -> NDArray[np.bool_]:
        """Which packets have NaN or infinity outside the events `but`, (n,).

        A number that `scale` makes infinite counts as well.
        """
        bad = np.zeros(len(rows), bool)
        scaled = self.scale > 1.0
        for start, end, dtype, columns in self._float_blocks(frozenset(but)):
            numbers = rows[:, start:end].view(dtype)
            if columns is not None:
                numbers = numbers[:, columns]
            if scaled:
                with np.errstate(invalid="ignore", over="ignore"):
                    numbers = numbers.astype(np.float64) * self.scale
            bad |= ~np.isfinite(numbers).all(axis=1)
        return bad

    def bounds(self, limits: Mapping[str, float]) -> list[_Bounds]:
        """Prepares `find_odd`.

        Args:
            limits: event name to the largest magnitude of its numbers, as decoded.
        """
        factor = max(self.scale, 1.0)
        found: list[_Bounds] = []
        for block in self._float_blocks(frozenset()):
            start, end, dtype, _ = block
            most = float(np.finfo(dtype).max)
            bounds = [
                min(limits.get(name, most), most) / factor
                for name, item in self._by_event.items()
                if item.is_float and item.constant is None and item.dtype == dtype
                if start <= item.offset < end and (item.offset - start) % item.item_bytes == 0
                for _ in range(item.numbers)
            ]
            found.append((block, np.array(bounds, dtype.newbyteorder("="))))
        for name, limit in limits.items():
            item = self._by_event.get(name)  # type: ignore[assignment]
            if item is not None and not (item.is_float or item.is_bool) and _limit(item) > limit:
                count = item.numbers * item.item_bytes
                block = item.offset, item.offset + count, item.dtype, None
                found.append((block, np.full(item.numbers, limit)))
        return found

    def find_odd(self, rows: Rows, bounds: Sequence[_Bounds]) -> NDArray[np.bool_]:
        """Which packets may have NaN, infinity or a number beyond its bound, (n,); a quick check.

        Args:
            rows: (n, `size` or more), one packet a row.
            bounds: what `bounds` returned.
        """
        odd = np.zeros(len(rows), bool)
        for (start, end, dtype, columns), bound in bounds:
            numbers = rows[:, start:end].view(dtype)
            if columns is not None:
                numbers = numbers[:, columns]
            if dtype.kind != "f":
                numbers = numbers.astype(np.float64)
            odd |= ~(np.abs(numbers) <= bound).all(axis=1)
        return odd

    def _float_blocks(self, but: frozenset[str]) -> list[_Block]:
        """Blocks that can be checked together: numbers of one type, aligned to its size."""
        known = self._blocks.get(but)
        if known is not None:
            return known
        groups: dict[tuple[np.dtype[Any], int], list[Item]] = {}
        for name, item in self._by_event.items():
            if item.is_float and item.constant is None and name not in but:
                key = (item.dtype, item.offset % item.item_bytes)
                groups.setdefault(key, []).append(item)
        blocks: list[_Block] = []
        for (dtype, _), items in groups.items():
            start, end = items[0].offset, items[-1].end
            columns = np.concatenate(
                [np.arange(item.offset - start, item.end - start, dtype.itemsize) for item in items]
            )
            columns //= dtype.itemsize
            is_all = len(columns) * dtype.itemsize == end - start
            blocks.append((start, end, dtype, None if is_all else columns))
        if len(self._blocks) > 8:  # frequent changes of where NaN is allowed
            self._blocks = {}
        self._blocks[but] = blocks
        return blocks

    def find_wrong_constants(self, rows: Rows) -> NDArray[np.bool_]:
        """Which packets have a number different from its constant, (n,)."""
        bad = np.zeros(len(rows), bool)
        for item, constant in self._constants:
            bad |= _is_wrong(rows, item, constant).any(axis=1)
        return bad

    def describe_wrong_constant(self, rows: Rows) -> str:
        """Describes the first packet's wrong constants; empty if correct."""
        for item, constant in self._constants:
            if (wrong := _is_wrong(rows[:1], item, constant)[0]).any():
                index = int(np.argmax(wrong))
                found = _numbers(rows[:1], item)[0, index]
                name = f"{item.name} " if item.name else ""
                place = item.offset + index * item.item_bytes
                said = f"{name}at byte {place} is {_shown(found)}; expected {_shown(constant)}"
                if item.item_bytes > 1 and found.byteswap() == constant:
                    other = "<" if item.dtype.byteorder == ">" else ">"
                    said += f"; these are its bytes in reverse order: '{other}'?"
                return said
        return ""

    def find_wrong_checksums(self, rows: Rows) -> NDArray[np.bool_]:
        """Which packets have a wrong checksum, (n,)."""
        bad = np.zeros(len(rows), bool)
        for item in self.checksums:
            bad |= _numbers(rows, item)[:, 0] != _checksums(rows, item)
        return bad

    def describe_wrong_checksum(self, rows: Rows) -> str:
        """Describes the first packet's wrong checksum; empty if all are right."""
        for item in self.checksums:
            found, expected = _numbers(rows[:1], item)[0, 0], _checksums(rows[:1], item)[0]
            if found != expected:
                begin, end = item.covers
                said = f"{item.checksum} of bytes {begin} to {end - 1} is 0x{int(expected):x}"
                said += f"; found 0x{int(found):x} at byte {item.offset}"
                if item.item_bytes > 1 and found.byteswap() == expected:
                    other = "<" if item.dtype.byteorder == ">" else ">"
                    said += f", which is the same with its bytes reversed: '{other}'?"
                return said
        return ""

    def seal(self, rows: Rows) -> None:
        """Writes the checksums of packets into them; needed after they were changed.

        Args:
            rows: (n, `size`), one packet a row.
        """
        for item in self.checksums:
            _numbers(rows, item)[:, 0] = _checksums(rows, item)

    def encode(self, values: Mapping[str, ArrayLike]) -> bytes:
        """Returns the packet of these events; missing events are zero.

        Constants and checksums are written, `scale` and `signs` are undone, and integers are
        rounded.

        Args:
            values: event name to an array in the shape of `events`. A leading 1 may be omitted: (4,
                4) for (1, 4, 4).

        Raises:
            UnknownName: an event that this structure does not have.
            ValueError: an event has a wrong shape, or a number is out of the range of its type, or
                differs from its constant.
        """
        packet = np.zeros((1, self.size), np.uint8)
        for name, given in values.items():
            if name not in self.events:
                raise UnknownName("event", name, self.events)
            item = self._by_event[name]
            array = _as_numbers(item, given)
            allowed = [item.shape, item.shape[1:]] if item.count == 1 else [item.shape]
            if array.shape not in allowed:
                expected = " or ".join(map(str, allowed))
                raise mismatch(array.shape, expected, key=name)
            _numbers(packet, item)[:] = self._to_write(item, array.reshape(item.shape)).ravel()
        for item, constant in self._constants:
            if item.name in values and _is_wrong(packet, item, constant).any():
                found = _numbers(packet, item)[0]
                raise Problem(
                    item.name,
                    f"found {_shown(found[found != constant][0])}",
                    expected=f"{_shown(constant)}, as '{self.text}' demands",
                ).error()
            _numbers(packet, item)[:] = constant
        self.seal(packet)
        return packet.tobytes()

    def _to_write(self, item: Item, array: NDArray[Any]) -> NDArray[Any]:
        if len(item.shape) == 3:
            array = np.array(array, np.float64)
            if self._factor(item) != 1.0:
                array[:, :3, 3] = self._unscaled(item, array[:, :3, 3])
            if item.kind == "T":
                off = np.abs(array[:, 3] - LAST_ROW).max(axis=1)
                if (off > LAST_ROW_TOLERANCE).any():  # NaN is no data, and may be sent
                    row = ", ".join(f"{number:g}" for number in array[np.argmax(off), 3])
                    raise Problem(
                        item.name, f"found last row [{row}]", expected="[0, 0, 0, 1]"
                    ).error()
                array = array[:, :3]
            array = array.swapaxes(1, 2) if self.column_major else array
        elif self._factor(item) != 1.0:
            array = self._unscaled(item, array)
        return _fitted(item, array)

    def _unscaled(self, item: Item, array: NDArray[Any]) -> NDArray[Any]:
        with np.errstate(over="ignore"):
            unscaled = array / self._factor(item)
        if (wrong := np.isinf(unscaled) & np.isfinite(array)).any():
            expected = f"less, for scale {self.scale:g}"
            raise mismatch(array[wrong].flat[0], expected, key=item.name)
        return unscaled


def are_frames(matrices: Array) -> NDArray[np.bool_]:
    """Whether each of the matrices (n, 4, 4) is a rigid frame, (n,).

    The last row is 0 0 0 1 within 1e-6, the upper left 3 x 3 orthonormal within 1e-3 and not a
    reflection.
    """
    # Entries far above 1 are still far from a rotation, and their squares do not overflow.
    rotations = np.minimum(np.maximum(matrices[:, :3, :3], -2.0), 2.0)  # np.clip is slower
    off = np.abs(rotations @ rotations.swapaxes(1, 2) - _IDENTITY).max(axis=(1, 2))
    last_row_off = np.abs(matrices[:, 3] - LAST_ROW).max(axis=1)
    good: NDArray[np.bool_] = (off <= _ROTATION_TOLERANCE) & (last_row_off <= LAST_ROW_TOLERANCE)
    good[good] = np.linalg.det(rotations[good]) > 0.0  # of NaN it would warn
    return good


def _numbers(rows: Rows, item: Item) -> NDArray[Any]:
    return rows[:, item.offset : item.end].view(item.dtype)


def _checksums(rows: Rows, item: Item) -> NDArray[np.uint64]:
    begin, end = item.covers
    covered = rows[:, begin:end]
    if begin <= item.offset < end:
        covered = covered.copy()
        covered[:, item.offset - begin : item.end - begin] = 0
    return compute(item.checksum, covered, 8 * item.item_bytes)


def _is_wrong(rows: Rows, item: Item, constant: Any) -> NDArray[np.bool_]:
    numbers = _numbers(rows, item)
    wrong: NDArray[np.bool_] = (numbers != 0 if item.is_bool else numbers) != constant
    return wrong


def _shown(number: Any) -> str:
    if isinstance(number, np.integer) and number > 9:
        return f"{number} (0x{int(number):x})"
    return str(number)


def _as_numbers(item: Item, given: ArrayLike) -> NDArray[Any]:
    """An array of numbers; 64-bit integers as Python integers, which numpy might round."""
    try:
        array = np.asarray(given)
        if array.dtype.kind not in "biuf" or (item.item_bytes == 8 and isinstance(given, list)):
            objects = np.asarray(given, object)
            if all(isinstance(number, int) for number in objects.flat):
                array = objects.astype(np.float64) if item.is_float else objects
            elif array.dtype.kind not in "biuf":
                raise TypeError
    except (TypeError, ValueError, OverflowError):
        problem = Problem(item.name, found=given, expected="numbers, all rows of one length")
        raise problem.error() from None
    return array


def _limit(item: Item) -> float:
    return float(max(map(abs, limits(item))))


def _fitted(item: Item, array: NDArray[Any]) -> NDArray[Any]:
    low, high = (0, 255) if item.is_bool else limits(item)
    if item.is_float:
        with np.errstate(over="ignore", invalid="ignore"):
            fitted = array.astype(item.type)
            fits = np.isfinite(fitted) | ~np.isfinite(array.astype(np.float64))
        expected = f"numbers from {low:g} to {high:g}"
    else:
        whole = np.rint(array) if array.dtype.kind == "f" else array
        # In float64 the maximum int64 is 2**63, which is one too large.
        above = float(high) if array.dtype.kind == "f" and high >= 2**53 else None
        with np.errstate(invalid="ignore"):
            fits = (whole >= low) & (whole <= high if above is None else whole < above)
        fitted = (whole != 0) if item.is_bool else whole
        expected = f"whole numbers from {low} to {high}"
    if not fits.all():
        raise mismatch(array[~fits].flat[0], expected, key=item.name)
    return fitted
