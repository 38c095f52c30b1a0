"""Parses structure strings; STRUCTURE.md in this folder describes the language."""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...base.errors import StructureError, did_you_mean
from .checksum import ALIASES, CRCS, SUMS, find_checksum, width_of

MAX_PACKET_BYTES = 65_507  # maximum payload of a UDP packet over IPv4

# Names of events, and shape of one item in the packet, by kind.
KINDS: dict[str, tuple[str, tuple[int, ...]]] = {
    "F": ("values", ()),
    "V": ("vectors", (3,)),
    "M": ("matrices", (4, 4)),
    "T": ("matrices", (3, 4)),
}
# NumPy types by the letters of Python's struct module.
TYPES = {
    "f": "f4", "d": "f8", "b": "i1", "B": "u1", "h": "i2", "H": "u2",
    "i": "i4", "I": "u4", "q": "i8", "Q": "u8", "?": "u1",
}  # fmt: skip
RESERVED = ("receiving", "receive_trigger")  # events that every source has
_GAP = re.compile(r"[\s,]*")
_SPACES = re.compile(r"\s*")
_NAME = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)\s*:\s*")
_COUNT = re.compile(r"[0-9]+")
_EQUALS = re.compile(r"\s*(=)\s*")
_NUMBER = re.compile(r"[+-]?(?:0[xX][0-9a-fA-F]+|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)")
_WORD = re.compile(r"[~-]?[A-Za-z][A-Za-z0-9/_-]*")
_RANGE = re.compile(r"\s*\[\s*([0-9]*)\s*:\s*([0-9]*)\s*\]")
_MAX_NUMBER = 40  # characters; Python does not parse thousands of digits
_NUMBERED = re.compile(r"(values|vectors|matrices)[0-9]+")
_CHECK = "expected a number, the word size or a checksum, for example 1H=0x2006 or 1H=CRC-16/MODBUS"
_EXPECTED = "expected a count and F, V, M, T, x or a type, for example 7F1M"
_TOO_LONG = f"the packet would be too long; expected at most {MAX_PACKET_BYTES} bytes"


@dataclass(frozen=True)
class Item:
    """One item of a structure string.

    Attributes:
        name: declared or numbered name of the event; empty for items without an event.
        kind: `F`, `V`, `M` or `T`, or `x` for skipped bytes.
        type: NumPy name of the type, with byte order; `u1` for skipped bytes.
        is_bool: whether every byte other than 0 stands for 1.
        constant: required value of every number; None for any value.
        is_size: whether the constant is the size of the packet.
        checksum: name of the required checksum; empty for none.
        covers: first byte and end of the range that the checksum covers. The bytes of the
            checksum count as 0.
        at: position of the item in the structure string. For a size or checksum, the position of
            the word after `=`.
    """

    name: str
    kind: str
    count: int
    type: str
    offset: int = 0
    is_bool: bool = False
    constant: int | float | None = None
    is_size: bool = False
    checksum: str = ""
    covers: tuple[int, int] = (0, 0)
    at: int = 0

    @cached_property
    def wire_shape(self) -> tuple[int, ...]:
        """Shape of the numbers in the packet, for row-major matrices."""
        return (self.count, *(KINDS[self.kind][1] if self.kind in KINDS else ()))

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Shape of the event's array, in which matrices are 4 x 4."""
        return (self.count, 4, 4) if self.kind == "T" else self.wire_shape

    @cached_property
    def numbers(self) -> int:
        return math.prod(self.wire_shape)

    @cached_property
    def item_bytes(self) -> int:
        return int(self.type[-1])

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(self.type)

    @cached_property
    def end(self) -> int:
        return self.offset + self.numbers * self.item_bytes

    @cached_property
    def is_float(self) -> bool:
        return self.type[-2] == "f"


def parse(text: str, *, is_double: bool = True, alignment: int = 1) -> list[Item]:
    """Parses a structure string into its items; raises StructureError.

    Args:
        is_double: whether `F`, `V`, `M` and `T` without a type are float64 instead of float32.
        alignment: alignment of items in bytes.
    """
    return _Parser(text, is_double, alignment).items()


class _Parser:
    def __init__(self, text: str, is_double: bool, alignment: int) -> None:
        self.text = text
        self.at = 0
        self.order = "<"
        self.default = "d" if is_double else "f"
        self.alignment = alignment
        self.numbered = dict.fromkeys(("values", "vectors", "matrices"), 0)
        self.size = 0
        self.names: set[str] = set()

    def items(self) -> list[Item]:
        items: list[Item] = []
        while self.skip(_GAP) < len(self.text):
            if self.next in "<>!":
                self.order = "<" if self.next == "<" else ">"
                self.at += 1
            elif self.next in "=@":
                raise self.wrong(self.expected_instead_of_equals(items))
            else:
                items.append(self.item())
        if not any(item.name for item in items):
            raise self.wrong("expected an item that creates an event" if items else _EXPECTED)
        items = [self.with_size(item) if item.is_size else item for item in items]
        return [self.with_range(item, items) if item.checksum else item for item in items]

    @property
    def next(self) -> str:
        return self.text[self.at : self.at + 1]

    def wrong(self, reason: str, at: int | None = None) -> StructureError:
        return StructureError(self.text, self.at if at is None else at, reason)

    def skip(self, pattern: re.Pattern[str]) -> int:
        if found := pattern.match(self.text, self.at):
            self.at = found.end()
        return self.at

    def expected_instead_of_equals(self, items: list[Item]) -> str:
        if self.next == "=" and items and items[-1].kind == "x":
            return "skipped bytes cannot be checked; expected a type, for example 1B=0"
        return "expected < (little-endian) or > (big-endian)"

    def item(self) -> Item:
        start = self.at
        name = self.name()
        count_at = self.at
        count = self.count()
        self.skip(_SPACES)
        kind, letter = self.kind()
        order = self.order if TYPES[letter][1] != "1" else ""
        offset = -(-self.size // self.alignment) * self.alignment
        item = Item(name, kind, count, order + TYPES[letter], offset, letter == "?", at=start)
        if kind != "x":
            item = self.with_constant(item)
            if name in self.names:
                raise self.wrong(f"two items have the name '{name}'", start)
            item = self.with_name(item)
        elif name:
            raise self.wrong("skipped bytes cannot have a name", start)
        if item.end > MAX_PACKET_BYTES:
            raise self.wrong(_TOO_LONG, count_at)
        self.size = item.end
        return item

    def name(self) -> str:
        found = _NAME.match(self.text, self.at)
        if found is None:
            return ""
        before = self.text[self.at - 1 : self.at]
        if before and not (before.isspace() or before in ",<>!"):
            raise self.wrong("expected a space or a comma before a name")
        name = found[1]
        if _NUMBERED.fullmatch(name) or name in RESERVED:
            raise self.wrong(f"the name '{name}' is reserved; expected another name")
        self.at = found.end()
        return name

    def with_name(self, item: Item) -> Item:
        if item.name:
            self.names.add(item.name)
            return item
        if item.constant is not None or item.is_size or item.checksum:
            return item
        events = KINDS[item.kind][0]
        self.numbered[events] += 1
        return replace(item, name=f"{events}{self.numbered[events] - 1}")

    def count(self) -> int:
        found = _COUNT.match(self.text, self.at)
        if found is None:
            if self.next and (self.next in KINDS or self.next in TYPES or self.next == "x"):
                raise self.wrong(f"expected a count before '{self.next}', as in 1{self.next}")
            raise self.wrong(_EXPECTED)
        # int() rejects thousands of digits, and nine digits already exceed any packet.
        count = int(found[0].lstrip("0")[:9] or "0")
        if count == 0:
            raise self.wrong("expected a count of 1 or more")
        self.at = found.end()
        return count

    def kind(self) -> tuple[str, str]:
        letter = self.next
        self.at += 1
        if letter == "x":
            return "x", "B"
        if letter and letter in TYPES:
            return "F", letter
        if letter and letter in KINDS:
            if self.next and self.next in TYPES:
                self.at += 1
                return letter, self.text[self.at - 1]
            return letter, self.default
        near = did_you_mean(letter.upper(), KINDS) if letter.isalpha() else ""
        hint = near if "did you mean" in near else ""
        kinds = "expected F, V, M, T, x or a type after a count"
        raise self.wrong(f"{kinds}, for example 7F1M{hint}", self.at - 1)

    def with_constant(self, item: Item) -> Item:
        equals = _EQUALS.match(self.text, self.at)
        if equals is None:
            return item
        if item.kind in "MT":
            reason = "a matrix cannot be checked against one number"
            raise self.wrong(reason, equals.start(1))
        self.at = equals.end()
        if (word := _WORD.match(self.text, self.at)) is not None:
            if word[0] != "size":
                return self.with_checksum(item, word)
            item = replace(item, is_size=True, at=self.at)
            self.at = word.end()
            return item
        found = _NUMBER.match(self.text, self.at)
        if found is None:
            raise self.wrong(_CHECK)
        item = replace(item, constant=self.number(found[0], item))
        self.at = found.end()
        return item

    def with_checksum(self, item: Item, word: re.Match[str]) -> Item:
        name = find_checksum(word[0])
        if name is None:
            near = did_you_mean(word[0], ("size", *SUMS, *CRCS, *ALIASES))
            raise self.wrong(_CHECK + (near if "did you mean" in near else ""))
        bits = width_of(name)
        letter = {8: "B", 16: "H", 32: "I"}.get(bits or 0, "H")
        is_unsigned = item.type[-2] == "u" and not item.is_bool
        if item.numbers != 1 or not is_unsigned or bits not in (None, 8 * item.item_bytes):
            of = f" of {bits} bits" if bits else ""
            reason = f"a checksum is one unsigned number{of}; expected 1{letter}={name}"
            raise self.wrong(reason)
        at, self.at = self.at, word.end()
        covers = 0, -1  # `with_range` replaces -1 by the default
        if (found := _RANGE.match(self.text, self.at)) is not None:
            begin, end = ((int(each) if each else -1) if len(each) < 9 else MAX_PACKET_BYTES + 1
                          for each in found.groups())  # fmt: skip
            covers, self.at = (max(begin, 0), end), found.end()
        return replace(item, checksum=name, covers=covers, at=at)

    def number(self, text: str, item: Item) -> int | float:
        if len(text) > _MAX_NUMBER:
            raise self.wrong(f"expected a number of at most {_MAX_NUMBER} characters")
        digits = text.lstrip("+-")
        value: int | float
        if digits[:2].lower() == "0x":
            value = int(text, 16)
        else:
            value = int(text) if digits.isdecimal() else float(text)
        low, high = limits(item)
        if not low <= value <= high:
            shown = f"{low:g} to {high:g}" if item.is_float else f"{low} to {high}"
            raise self.wrong(f"expected a number from {shown}")
        if item.is_float:
            return float(value)
        if value != int(value):
            raise self.wrong("expected a whole number for this type")
        return int(value)

    def with_range(self, item: Item, items: list[Item]) -> Item:
        begin, end = item.covers
        if end < 0:
            end = item.offset if begin < item.offset else self.size
        if not begin < end <= self.size:
            found = f"the checksum covers the bytes {begin} to {end - 1}"
            raise self.wrong(f"{found}; expected a range within 0 to {self.size - 1}", item.at)
        later = [each.offset for each in items if each.checksum and each.offset > item.offset]
        if any(begin <= offset < end for offset in later):
            raise self.wrong("the checksum covers a later checksum", item.at)
        return replace(item, covers=(begin, end))

    def with_size(self, item: Item) -> Item:
        if self.size > limits(item)[1]:
            reason = f"the packet has {self.size} bytes; expected a type with this range"
            raise self.wrong(f"{reason}, for example 1H=size", item.at)
        return replace(item, constant=self.size)


def limits(item: Item) -> tuple[int | float, int | float]:
    """Returns the minimum and maximum finite number that the type of an item can represent."""
    if item.is_bool:
        return 0, 1
    if item.is_float:
        greatest = sys.float_info.max if item.item_bytes == 8 else (2.0 - 2.0**-23) * 2.0**127
        return -greatest, greatest
    bits = 8 * item.item_bytes
    return (0, 2**bits - 1) if item.type[-2] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
