"""Columns of lines that end in a number: name, label, number aligned at its point, and unit."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

Width = Callable[[str], float]

_VALUE = re.compile(
    r"(?P<head>.*?) +(?:(?P<whole>[-+]?\d+)(?P<rest>\.\d*(?:e[-+]?\d+)?)?(?P<unit> \S+)?"
    r"|(?P<none>no data|none))"
)
_GAP = " "  # before the numbers


@dataclass(frozen=True)
class Value:
    """A line that ends in a number.

    Attributes:
        whole: of the number, before the point; `no data` where there is none.
        rest: of the number, from the point on.
        unit: with a space before it.
    """

    name: str
    label: str
    whole: str
    rest: str
    unit: str

    @property
    def is_missing(self) -> bool:
        return not self.whole[-1].isdigit()

    @property
    def tail(self) -> str:
        return self.rest + self.unit


@dataclass(frozen=True)
class ValueColumns:
    """Lines in columns, pixels from the left and right edge of their text.

    Attributes:
        label: where labels start.
        tail: distance of the points from the right edge.
        width: of all columns.
    """

    rows: list[Value | str]
    label: float
    tail: float
    width: float


def value_columns(lines: Sequence[bytes], width: Width) -> ValueColumns:
    """Returns lines in columns.

    Args:
        width: of a text, pixels.
    """
    rows = [_parsed(line.decode("utf-8", "replace")) for line in lines]
    values = [row for row in rows if isinstance(row, Value)]
    names = max((width(row.name) for row in values), default=0.0)
    label = names + (2 * width(" ") if any(row.label for row in values) else 0.0)
    heads = max((label + width(row.label) for row in values if row.label), default=names)
    wholes = max((width(row.whole) for row in values if not row.is_missing), default=0.0)
    tail = max((width(row.tail) for row in values), default=0.0)
    missing = max((width(row.whole) for row in values if row.is_missing), default=0.0)
    inside = heads + width(_GAP) + max(wholes + tail, missing) if values else 0.0
    plain = max((width(row) for row in rows if isinstance(row, str)), default=0.0)
    return ValueColumns(rows, label, tail, max(inside, plain))


def _parsed(line: str) -> Value | str:
    found = _VALUE.fullmatch(line)
    if found is None:
        return line
    head = found["head"]
    name, _, label = head.rstrip().partition("  ")
    return Value(
        name, label.strip(), found["whole"] or found["none"], found["rest"] or "",
        found["unit"] or "",
    )  # fmt: skip
