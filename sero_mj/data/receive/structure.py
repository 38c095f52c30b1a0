"""Decoder and encoder for packets that a structure string describes.

`are_frames` checks whether decoded matrices are rigid frames.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.errors import Problem, UnknownName, mismatch
from ...base.frames import Array, Ints
from .checksum import compute
from .language import Item, limits, parse

Rows = NDArray[np.uint8]  # packets, or sender addresses, one per row
# First byte, end, type, and the indices of the selected numbers in between, or None for all.
_Block = tuple[int, int, np.dtype[Any], Ints | None]
_Bounds = tuple[_Block, Array]  # block, and the maximum magnitudes of the selected numbers
Alignment = Literal[1, 2, 4, 8]
TorqueSign = Literal[-1, 1]

_ROTATION_TOLERANCE = 1e-3  # as in `nearest_rotation` for frames in files
# Much smaller, because the last row of a transposed frame is its position, possibly only 1 mm.
LAST_ROW_TOLERANCE = 1e-6
LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_IDENTITY = np.eye(3)
_DOUBLE = np.dtype(np.float64)
_ALIGNMENTS: tuple[Alignment, ...] = (1, 2, 4, 8)


class Structure:
    """A decoder and encoder for one packet layout.

    Raises StructureError, which marks the first invalid character, or ValueError.

    Args:
        text: structure string; STRUCTURE.md describes the language.
        is_double: whether `F`, `V`, `M` and `T` are float64 instead of float32.
        alignment: alignment of items from the start of the packet, in bytes, as in Simulink's Byte
            Pack.
        scale: factor of all floating-point numbers without a constant. In matrices, it applies to
            the position only.
        signs: mapping from event names to the factor of their numbers, 1 or -1, for senders with
            other sign conventions. Matrices are not changed.

    Attributes:
        size: size of a packet in bytes.
        message: kind of the encoded messages that `unpack` converts to packets; empty if packets
            are received unencoded.
        dtype: NumPy record type of a packet, with the raw numbers of every event.
    """

    message: str = ""
    fault: str = ""  # reason why the last message could not be converted to a packet

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
        # Event, type, first byte, count, and the item if its numbers must be converted.
        self._plan = [
            (name, item.dtype, item.offset, item.numbers, self._unless_plain(item))
            for name, item in self._by_event.items()
        ]
        self._is_plain = not any(item for *_, item in self._plan)
        self._blocks: dict[frozenset[str], list[_Block]] = {}

    def unpack(self, rows: Rows, lengths: Ints) -> tuple[Rows, Ints]:
        """Converts n received messages to packets. The base class returns them unchanged.

        Args:
            rows: received messages, shape (n, any).
            lengths: lengths in bytes, shape (n,); greater than a row for truncated messages.

        Returns:
            packets, shape (n, `size` or more), and their lengths, shape (n,). A message that cannot
            be converted has a length other than `size`.
        """
        return rows, lengths

    def describe_wrong_size(self, packet: bytes, length: int) -> str:
        """Returns the reason why a message of `length` bytes is not a packet of this structure.

        `packet` contains at least the first bytes of the message.
        """
        hint = self.explain_size(length)
        return f"{length} bytes; expected {self.size}{hint and f'; {hint}'}"

    def explain_size(self, size: int) -> str:
        """Suggests options with which packets have a size, such as an alignment; "" for none."""
        found = []
        for alignment in _ALIGNMENTS[_ALIGNMENTS.index(self.alignment) :]:
            for is_double in (self.is_double, not self.is_double):
                end = Structure(self.text, is_double=is_double, alignment=alignment).size
                # C compilers pad structs, so that the next element of an array is aligned.
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
        """Decodes a packet to one float64 array per event; raises ValueError for a wrong size.

        Arrays of little-endian float64 are views of the packet, except for 3 x 4 matrices. They are
        read-only if the packet is. Constants are not checked, see `find_wrong_constants`.
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
        """Decodes n packets, shape (n, `size` or more), to one array (n, ...) per event.

        Args:
            events: names of the events to decode; None for all events.
        """
        with np.errstate(invalid="ignore", over="ignore"):
            return {
                name: self._finished(item := self._by_event[name], _numbers(rows, item))
                for name in (self._by_event if events is None else events)
                if name in self._by_event
            }

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        """Returns the state of the robot's controller and the link quality; -1 if unknown."""
        return -1.0, -1.0

    @property
    def required_frames(self) -> tuple[str, ...]:
        """Events whose matrices must be rigid frames or NaN; otherwise, a packet is malformed."""
        return self.matrices

    def field(self, event: str) -> Item:
        """Returns the item of an event; raises UnknownName."""
        if event not in self._by_event:
            raise UnknownName("event", event, self.events)
        return self._by_event[event]

    def event_rows(self, rows: Rows, event: str) -> NDArray[Any]:
        """Returns the k raw numbers of an event in n packets, shape (n, k), without conversion."""
        return _numbers(rows, self._by_event[event])

    def _finished(self, item: Item, numbers: NDArray[Any]) -> Array:
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
        """Returns a mask (n,) of the packets with NaN or infinity in events other than `but`.

        Numbers that become infinite by `scale` are detected, too.
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
        """Converts limits of decoded numbers to the bounds for `find_out_of_bounds`.

        Args:
            limits: mapping from event names to the maximum magnitude of their decoded numbers.
        """
        factor = max(self.scale, 1.0)
        found: list[_Bounds] = []
        for block in self._float_blocks(frozenset()):
            start, end, dtype, _ = block
            largest = float(np.finfo(dtype).max)
            bounds = [
                min(limits.get(name, largest), largest) / factor
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

    def find_out_of_bounds(self, rows: Rows, bounds: Sequence[_Bounds]) -> NDArray[np.bool_]:
        """Returns a mask (n,) of packets that may contain NaN, infinity or numbers out of bounds.

        This check is quick. It can select valid packets, but misses no invalid packet.
        """
        is_beyond = np.zeros(len(rows), bool)
        for (start, end, dtype, columns), bound in bounds:
            numbers = rows[:, start:end].view(dtype)
            if columns is not None:
                numbers = numbers[:, columns]
            if dtype.kind != "f":
                numbers = numbers.astype(np.float64)
            is_beyond |= ~(np.abs(numbers) <= bound).all(axis=1)
        return is_beyond

    def _float_blocks(self, but: frozenset[str]) -> list[_Block]:
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
        if len(self._blocks) > 8:  # limits the memory if `but` changes often
            self._blocks = {}
        self._blocks[but] = blocks
        return blocks

    def find_wrong_constants(self, rows: Rows) -> NDArray[np.bool_]:
        """Returns a mask (n,) of the packets with a number that differs from its constant."""
        bad = np.zeros(len(rows), bool)
        for item, constant in self._constants:
            bad |= _is_wrong(rows, item, constant).any(axis=1)
        return bad

    def describe_wrong_constant(self, rows: Rows) -> str:
        """Describes the first wrong constant of the first packet; returns "" if none is wrong."""
        for item, constant in self._constants:
            if (wrong := _is_wrong(rows[:1], item, constant)[0]).any():
                index = int(np.argmax(wrong))
                found = _numbers(rows[:1], item)[0, index]
                name = f"{item.name} " if item.name else ""
                place = item.offset + index * item.item_bytes
                text = f"{name}at byte {place} is {_shown(found)}; expected {_shown(constant)}"
                return text + _reversed_bytes(item, found, constant)
        return ""

    def find_wrong_checksums(self, rows: Rows) -> NDArray[np.bool_]:
        """Returns a mask (n,) of the packets with a wrong checksum."""
        bad = np.zeros(len(rows), bool)
        for item in self.checksums:
            bad |= _numbers(rows, item)[:, 0] != _checksums(rows, item)
        return bad

    def describe_wrong_checksum(self, rows: Rows) -> str:
        """Describes the first wrong checksum of the first packet; returns "" if none is wrong."""
        for item in self.checksums:
            found, expected = _numbers(rows[:1], item)[0, 0], _checksums(rows[:1], item)[0]
            if found != expected:
                begin, end = item.covers
                text = f"{item.checksum} of bytes {begin} to {end - 1} is 0x{int(expected):x}"
                text += f"; found 0x{int(found):x} at byte {item.offset}"
                return text + _reversed_bytes(item, found, expected)
        return ""

    def seal(self, rows: Rows) -> None:
        """Writes the checksums into packets (n, `size`). Call this after changing packets."""
        for item in self.checksums:
            _numbers(rows, item)[:, 0] = _checksums(rows, item)

    def encode(self, values: Mapping[str, ArrayLike]) -> bytes:
        """Encodes the values of events as a packet. Missing events are encoded as zeros.

        Numbers are divided by `scale` and `signs`, and rounded for integer types. The packet
        includes constants and checksums.

        Args:
            values: mapping from event names to arrays in the shapes of `events`. A leading axis of
                length 1 can be omitted.

        Raises:
            UnknownName: the structure has no event with one of the names.
            ValueError: an event has a wrong shape, or a number is out of the range of its type, or
                differs from its constant.
        """
        packet = np.zeros((1, self.size), np.uint8)
        for name, numbers in values.items():
            if name not in self.events:
                raise UnknownName("event", name, self.events)
            item = self._by_event[name]
            array = _as_numbers(item, numbers)
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
                    expected=f"{_shown(constant)}, as declared in '{self.text}'",
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
                if (off > LAST_ROW_TOLERANCE).any():  # false for NaN, which means missing data
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
            expected = f"a smaller number, because it is divided by scale {self.scale:g}"
            raise mismatch(array[wrong].flat[0], expected, key=item.name)
        return unscaled


def are_frames(matrices: Array) -> NDArray[np.bool_]:
    """Returns a mask (n,) of the matrices (n, 4, 4) that are rigid frames.

    The last row must be 0 0 0 1 within 1e-6. The upper left 3 x 3 part must be orthonormal within
    1e-3, and not a reflection.
    """
    # Entries far above 1 are still far from a rotation, and their squares do not overflow.
    rotations = np.minimum(np.maximum(matrices[:, :3, :3], -2.0), 2.0)  # np.clip is slower
    off = np.abs(rotations @ rotations.swapaxes(1, 2) - _IDENTITY).max(axis=(1, 2))
    last_row_off = np.abs(matrices[:, 3] - LAST_ROW).max(axis=1)
    good: NDArray[np.bool_] = (off <= _ROTATION_TOLERANCE) & (last_row_off <= LAST_ROW_TOLERANCE)
    good[good] = np.linalg.det(rotations[good]) > 0.0  # `det` would warn about NaN
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


def _reversed_bytes(item: Item, found: Any, expected: Any) -> str:
    if item.item_bytes == 1 or found.byteswap() != expected:
        return ""
    other = "<" if item.dtype.byteorder == ">" else ">"
    return f". The bytes are in reverse order; is '{other}' missing in the structure?"


def _shown(number: Any) -> str:
    if isinstance(number, np.integer) and number > 9:
        return f"{number} (0x{int(number):x})"
    return str(number)


def _as_numbers(item: Item, numbers: ArrayLike) -> NDArray[Any]:
    try:
        array = np.asarray(numbers)
        # Lists of 64-bit integers remain Python integers, which NumPy might round.
        if array.dtype.kind not in "biuf" or (item.item_bytes == 8 and isinstance(numbers, list)):
            objects = np.asarray(numbers, object)
            if all(isinstance(number, int) for number in objects.flat):
                array = objects.astype(np.float64) if item.is_float else objects
            elif array.dtype.kind not in "biuf":
                raise TypeError
    except (TypeError, ValueError, OverflowError):
        problem = Problem(item.name, found=numbers, expected="numbers in rows of equal length")
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
