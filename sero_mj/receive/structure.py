"""The packet language: what the bytes of a packet mean, as a string (the paper's section 3.2).

    structure = item { item }    spaces and commas may stand between and around items
    item      = count kind       count: 1 or more
    kind      = "F"              values: one event valuesK, (count,)
              | "V"              3-vectors x, y, z: one event vectorsK, (count, 3)
              | "M"              homogeneous 4 x 4 matrices: one event matricesK, (count, 4, 4)

Events are numbered by kind in order. `7F1V7F1M` is, one after the other, `values0` (7,),
`vectors0` (1, 3), `values1` (7,) and `matrices0` (1, 4, 4): 33 numbers, 264 bytes.

Numbers are little-endian and stand without gaps; float64, or float32 when `is_double` is false.
Matrices come column by column, or row by row when `column_major` is false. In memory that makes
no difference: the position of a frame T is T[:3, 3].
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StructureError, UnknownName

Array = NDArray[np.float64]

MAX_PACKET_BYTES = 65_507  # the most that one UDP packet over IPv4 carries
_TOKEN = re.compile(r"[\s,]*(?:([0-9]+)\s*([A-Za-z]?))?")
# By letter: the name of the events, and the shape of one of their items.
_KINDS: dict[str, tuple[str, tuple[int, ...]]] = {
    "F": ("values", ()),
    "V": ("vectors", (3,)),
    "M": ("matrices", (4, 4)),
}


class Structure:
    """A decoder and encoder for one packet layout, built once.

    Args:
        text: the structure string.
        is_double: float64 when true, else float32.
        column_major: matrices come column by column when true, else row by row.

    Attributes:
        text: the structure string.
        column_major: how matrices come.
        events: event name to the shape of its array.
        matrices: names of the events that are matrices.
        size: bytes of a packet.

    Raises:
        StructureError: points at the first character that is wrong.
    """

    def __init__(self, text: str, *, is_double: bool = True, column_major: bool = True) -> None:
        self.text = text
        self.column_major = column_major
        self._dtype = np.dtype("<f8" if is_double else "<f4")
        self.events: dict[str, tuple[int, ...]] = {}
        self._slices: dict[str, slice] = {}
        numbered = dict.fromkeys(_KINDS, 0)
        start = 0
        for count, letter in _parse(text, self._dtype.itemsize):
            kind, shape = _KINDS[letter]
            name = f"{kind}{numbered[letter]}"
            numbered[letter] += 1
            self.events[name] = (count, *shape)
            self._slices[name] = slice(start, start + count * _numbers_in(letter))
            start = self._slices[name].stop
        self._nested = {name: shape for name, shape in self.events.items() if len(shape) > 1}
        self.matrices = tuple(name for name, shape in self.events.items() if len(shape) == 3)
        self.size = start * self._dtype.itemsize

    def decode(self, packet: bytes | bytearray | memoryview) -> dict[str, Array]:
        """Returns every event's array, float64, in the shapes of `events`.

        With float64 the arrays are views into the packet: nothing is copied.

        Raises:
            ValueError: the packet is not `size` bytes long.
        """
        if len(packet) != self.size:
            raise ValueError(f"found {len(packet)} bytes; expected {self.size} for '{self.text}'")
        with np.errstate(invalid="ignore"):  # widening a signalling NaN would warn
            return self._views(np.frombuffer(packet, self._dtype).astype(np.float64, copy=False))

    def encode(self, values: Mapping[str, ArrayLike]) -> bytes:
        """Returns the packet that carries these events; events that are not given are zero.

        Args:
            values: event name to an array in the shape of `events`. A leading 1 may be left out:
                (4, 4) will do for (1, 4, 4).

        Raises:
            UnknownName: an event that this structure does not have.
            ValueError: an event of another shape.
        """
        packet = np.zeros(self.size // self._dtype.itemsize, self._dtype)
        views = self._views(packet)
        for name, given in values.items():
            if name not in views:
                raise UnknownName("event", name, self.events)
            shape = self.events[name]
            allowed = [shape, shape[1:]] if shape[0] == 1 else [shape]
            array = np.asarray(given)
            if array.shape not in allowed:
                expected = " or ".join(map(str, allowed))
                raise ValueError(f"{name}: found {array.shape}; expected {expected}")
            views[name][...] = array
        return packet.tobytes()

    def _views(self, numbers: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Every event's part of a packet's numbers, in its shape."""
        views = {name: numbers[part] for name, part in self._slices.items()}
        for name, shape in self._nested.items():
            views[name] = views[name].reshape(shape)
        if self.column_major:
            for name in self.matrices:
                views[name] = views[name].swapaxes(1, 2)
        return views


def _numbers_in(letter: str) -> int:
    return int(np.prod(_KINDS[letter][1], dtype=int))


def _parse(text: str, number_bytes: int) -> list[tuple[int, str]]:
    """Returns the count and the letter of every item."""
    items: list[tuple[int, str]] = []
    position, size = 0, 0
    while True:
        token = _TOKEN.match(text, position)
        assert token is not None  # every part of the pattern is optional
        if token[1] is None:
            position = token.end()
            break
        letter = token[2]
        if letter not in _KINDS:
            at = token.start(2) if letter else token.end()
            raise StructureError(text, at, "expected F, V or M after a count, for example 7F1M")
        # int() refuses thousands of digits; the first nine are already too many for a packet.
        count = int(token[1].lstrip("0")[:9] or "0")
        size += count * _numbers_in(letter) * number_bytes
        if count == 0:
            raise StructureError(text, token.start(1), "expected a count of 1 or more")
        if size > MAX_PACKET_BYTES:
            reason = f"the packet would be too long; expected at most {MAX_PACKET_BYTES} bytes"
            raise StructureError(text, token.start(1), reason)
        items.append((count, letter))
        position = token.end()
    if position < len(text) or not items:
        reason = "expected a count and F, V or M, for example 7F1M"
        raise StructureError(text, position, reason)
    return items
