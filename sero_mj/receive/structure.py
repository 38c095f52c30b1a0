"""The packet language: what the bytes of a packet mean, as a string (the paper's section 3.2).

    structure = item { item }        e.g. "7F7F"
    item      = count "F"            count float values: one event valuesK, (count,)

Events are numbered in order: the first item is `values0`, the second `values1`. Numbers are
little-endian and stand without gaps; float64, or float32 when `is_double` is false.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import StructureError, UnknownName

Array = NDArray[np.float64]

MAX_PACKET_BYTES = 65_507  # the most that one UDP packet over IPv4 carries
_TOKEN = re.compile(r"[\s,]*(?:([0-9]+)\s*([A-Za-z]?))?")


class Structure:
    """A decoder and encoder for one packet layout, built once.

    Args:
        text: the structure string.
        is_double: float64 when true, else float32.

    Attributes:
        text: the structure string.
        events: event name to its number of values.
        size: bytes of a packet.

    Raises:
        StructureError: points at the first character that is wrong.
    """

    def __init__(self, text: str, *, is_double: bool = True) -> None:
        self.text = text
        self._dtype = np.dtype("<f8" if is_double else "<f4")
        self.events: dict[str, int] = {}
        self._slices: dict[str, slice] = {}
        start = 0
        for k, count in enumerate(_parse(text, self._dtype.itemsize)):
            name = f"values{k}"
            self.events[name] = count
            self._slices[name] = slice(start, start + count)
            start += count
        self.size = start * self._dtype.itemsize

    def decode(self, packet: bytes | bytearray | memoryview) -> dict[str, Array]:
        """Returns every event's values, float64, (count,).

        With float64 the arrays are views into the packet: nothing is copied.

        Raises:
            ValueError: the packet is not `size` bytes long.
        """
        if len(packet) != self.size:
            raise ValueError(f"found {len(packet)} bytes; expected {self.size} for '{self.text}'")
        with np.errstate(invalid="ignore"):  # widening a signalling NaN would warn
            values = np.frombuffer(packet, self._dtype).astype(np.float64, copy=False)
        return {name: values[part] for name, part in self._slices.items()}

    def encode(self, values: Mapping[str, ArrayLike]) -> bytes:
        """Returns the packet that carries these events; events that are not given are zero.

        Raises:
            UnknownName: an event that this structure does not have.
            ValueError: an event with another number of values.
        """
        packet = np.zeros(self.size // self._dtype.itemsize, self._dtype)
        for name, given in values.items():
            if name not in self._slices:
                raise UnknownName("event", name, self.events)
            part = self._slices[name]
            array = np.asarray(given)
            if array.shape != (self.events[name],):
                raise ValueError(f"{name}: found {array.shape}; expected ({self.events[name]},)")
            packet[part] = array
        return packet.tobytes()


def _parse(text: str, item_bytes: int) -> list[int]:
    """Returns the count of every item."""
    counts: list[int] = []
    position, size = 0, 0
    while True:
        token = _TOKEN.match(text, position)
        assert token is not None  # every part of the pattern is optional
        if token[1] is None:
            position = token.end()
            break
        if token[2] != "F":
            at = token.start(2) if token[2] else token.end()
            raise StructureError(text, at, "expected F for float values after a count (7F)")
        # int() refuses thousands of digits; the first nine are already too many for a packet.
        count = int(token[1].lstrip("0")[:9] or "0")
        size += count * item_bytes
        if count == 0:
            raise StructureError(text, token.start(1), "expected a count of 1 or more")
        if size > MAX_PACKET_BYTES:
            reason = f"the packet would be too long; expected at most {MAX_PACKET_BYTES} bytes"
            raise StructureError(text, token.start(1), reason)
        counts.append(count)
        position = token.end()
    if position < len(text) or not counts:
        raise StructureError(text, position, "expected a count and F, for example 7F7F")
    return counts
