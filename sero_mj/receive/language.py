"""Reads structure strings; STRUCTURE.md, beside this file, is their one page of documentation."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from ..errors import StructureError, did_you_mean

MAX_PACKET_BYTES = 65_507  # the most that one UDP packet over IPv4 carries

# By letter: the name of the events, and the numbers that one of their items has in the packet.
KINDS: dict[str, tuple[str, tuple[int, ...]]] = {
    "F": ("values", ()),
    "V": ("vectors", (3,)),
    "M": ("matrices", (4, 4)),
    "T": ("matrices", (3, 4)),
}
# By letter, as in Python's struct module: numpy's type.
TYPES = {
    "f": "f4", "d": "f8", "b": "i1", "B": "u1", "h": "i2", "H": "u2",
    "i": "i4", "I": "u4", "q": "i8", "Q": "u8", "?": "u1",
}  # fmt: skip
RESERVED = ("receiving", "receive_trigger")  # events that every source has
_GAP = re.compile(r"[\s,]*")
_NAME = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)\s*:\s*")
_COUNT = re.compile(r"[0-9]+")
_CONSTANT = re.compile(r"\s*=\s*")
_NUMBER = re.compile(
    r"size\b|[+-]?(?:0[xX][0-9a-fA-F]+|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
)
_NUMBERED = re.compile(r"(values|vectors|matrices)[0-9]+")
_EXPECTED = "expected a count and F, V, M, T, x or a type, for example 7F1M"


@dataclass(frozen=True)
class Item:
    """One item of a structure string.

    Attributes:
        name: the event's name, given or numbered; empty for what makes no event.
        kind: `F`, `V`, `M` or `T`; `x` for bytes that are skipped.
        count: how many.
        type: numpy's name of the number's type, with byte order; `u1` when skipped.
        is_bool: whether any byte but 0 is 1.
        constant: what every number of it must be; None where anything may stand.
        is_size: whether that constant is the packet's size.
        at: where it begins in the text.
    """

    name: str
    kind: str
    count: int
    type: str
    is_bool: bool = False
    constant: float | None = None
    is_size: bool = False
    at: int = 0

    @property
    def numbers(self) -> int:
        """How many numbers it has in the packet."""
        return self.count * (math.prod(KINDS[self.kind][1]) if self.kind in KINDS else 1)

    @property
    def item_bytes(self) -> int:
        """Bytes of one of its numbers."""
        return int(self.type[-1])


def parse(text: str, *, is_double: bool = True) -> list[Item]:
    """Returns the items of a structure string.

    Args:
        text: see STRUCTURE.md.
        is_double: what `F`, `V`, `M` and `T` are where they name no type.

    Raises:
        StructureError: points at the first character that is wrong.
    """
    return _Parser(text, is_double).items()


class _Parser:
    """Reads one string from left to right."""

    def __init__(self, text: str, is_double: bool) -> None:
        self.text = text
        self.at = 0
        self.order = "<"
        self.default = "d" if is_double else "f"
        self.numbered = dict.fromkeys(("values", "vectors", "matrices"), 0)
        self.size = 0
        self.names: set[str] = set()

    def items(self) -> list[Item]:
        items = []
        while self.skip_gap() < len(self.text):
            if self.text[self.at] in "<>!":
                self.order = "<" if self.text[self.at] == "<" else ">"
                self.at += 1
            elif self.text[self.at] in "=@":
                raise self.wrong("expected < (little-endian) or > (big-endian)")
            else:
                items.append(self.item())
        if not any(item.name for item in items):
            raise self.wrong(_EXPECTED if not items else "expected something that makes an event")
        return items

    def wrong(self, reason: str, at: int | None = None) -> StructureError:
        return StructureError(self.text, self.at if at is None else at, reason)

    def skip_gap(self) -> int:
        gap = _GAP.match(self.text, self.at)
        self.at = gap.end() if gap else self.at
        return self.at

    def item(self) -> Item:
        start = self.at
        name = self.name()
        count_at = self.at
        count = self.count()
        kind, letter = self.kind()
        if kind == "x":
            if name:
                raise self.wrong("skipped bytes have no name", start)
            item = Item("", "x", count, "u1", at=start)
        else:
            constant, is_size = self.constant(TYPES[letter], kind)
            if name and name in self.names:
                raise self.wrong(f"two fields have the name '{name}'", start)
            if not name and constant is None and not is_size:
                events = KINDS[kind][0]
                name = f"{events}{self.numbered[events]}"
                self.numbered[events] += 1
            self.names.add(name)
            order = "" if TYPES[letter] in ("u1", "i1") else self.order
            item = Item(
                name, kind, count, order + TYPES[letter], letter == "?", constant, is_size, start
            )
        self.size += item.numbers * item.item_bytes
        if self.size > MAX_PACKET_BYTES:
            reason = f"the packet would be too long; expected at most {MAX_PACKET_BYTES} bytes"
            raise self.wrong(reason, count_at)
        return item

    def name(self) -> str:
        found = _NAME.match(self.text, self.at)
        if found is None:
            return ""
        if self.at and self.text[self.at - 1] not in " ,\t\n\r<>!":
            raise self.wrong("expected a space or a comma before a name")
        name = found[1]
        if _NUMBERED.fullmatch(name) or name in RESERVED:
            raise self.wrong(f"'{name}' has a meaning of its own; expected another name")
        self.at = found.end()
        return name

    def count(self) -> int:
        found = _COUNT.match(self.text, self.at)
        if found is None:
            raise self.wrong(self.expected_count())
        # int() refuses thousands of digits; the first nine are already too many for a packet.
        count = int(found[0].lstrip("0")[:9] or "0")
        if count == 0:
            raise self.wrong("expected a count of 1 or more")
        self.at = found.end()
        while self.text[self.at : self.at + 1].isspace():
            self.at += 1
        return count

    def expected_count(self) -> str:
        letter = self.text[self.at : self.at + 1]
        if letter and (letter in KINDS or letter in TYPES or letter == "x"):
            return f"expected a count before it, for example 1{letter}"
        return _EXPECTED

    def kind(self) -> tuple[str, str]:
        """The kind, and the letter of the type."""
        letter = self.text[self.at : self.at + 1]
        if letter == "x" and letter:
            self.at += 1
            return "x", "B"
        if letter in TYPES and letter:
            self.at += 1
            return "F", letter
        if letter not in KINDS or not letter:
            near = did_you_mean(letter.upper(), KINDS) if letter.isalpha() else ""
            hint = near if "did you mean" in near else ""
            kinds = "expected F, V, M, T, x or a type after a count"
            raise self.wrong(f"{kinds}, for example 7F1M{hint}")
        self.at += 1
        kind_of_number = self.text[self.at : self.at + 1]
        if kind_of_number and kind_of_number in TYPES:
            self.at += 1
            return letter, kind_of_number
        return letter, self.default

    def constant(self, number: str, kind: str) -> tuple[float | None, bool]:
        """What stands behind `=`, and whether it is the word `size`."""
        sign = _CONSTANT.match(self.text, self.at)
        if sign is None:
            return None, False
        at = sign.end()
        found = _NUMBER.match(self.text, at)
        if found is None:
            raise self.wrong("expected a number or the word size, for example 1H=0x2006", at)
        if kind in "MT":
            raise self.wrong("a matrix cannot be checked against one number", self.at)
        self.at = found.end()
        if found[0] == "size":
            return None, True
        is_hex = "x" in found[0].lower()
        value = float(int(found[0], 16)) if is_hex else float(found[0])
        low, high = _LIMITS[number]
        if not low <= value <= high:
            raise self.wrong(f"expected a number from {low:g} to {high:g}", at)
        if number[0] != "f" and value != int(value):
            raise self.wrong("expected a whole number for this type", at)
        return value, False


_LIMITS: dict[str, tuple[float, float]] = {"f4": (-3.4e38, 3.4e38), "f8": (-1.8e308, 1.8e308)}
_LIMITS |= {f"u{n}": (0.0, 2.0 ** (8 * n) - 1) for n in (1, 2, 4, 8)}
_LIMITS |= {f"i{n}": (-(2.0 ** (8 * n - 1)), 2.0 ** (8 * n - 1) - 1) for n in (1, 2, 4, 8)}
