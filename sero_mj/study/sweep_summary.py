"""What a sweep comes to: how many held, and where values were lowest and highest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Rows = Mapping[int, Mapping[str, Any]]


@dataclass(frozen=True)
class Outcomes:
    """One outcome over all variants.

    Attributes:
        name: of the expectation, or `ROBOT.peak_torque_error` and the like.
        held: in how many variants it held; None where nothing is expected.
        known: in how many variants there is a value.
        lowest: value and number of the variant.
        median: of the values.
        highest: value and number of the variant.
    """

    name: str
    held: int | None
    known: int
    lowest: tuple[float, int]
    median: float
    highest: tuple[float, int]


@dataclass(frozen=True)
class Summary:
    """All of a sweep.

    Attributes:
        count: of variants that are known.
        held: in how many all held.
        errors: number to error of those that were stopped or could not begin.
        outcomes: one after the other.
    """

    count: int
    held: int
    errors: dict[int, str]
    outcomes: list[Outcomes]


def value_columns(columns: list[str]) -> dict[str, str]:
    """Name of every outcome that has numbers, to its column."""
    found = {}
    for column in columns[columns.index("held") + 3 :]:
        if column.startswith("expect."):
            if column.removesuffix(".value") in columns and column.endswith(".value"):
                found[column.removeprefix("expect.").removesuffix(".value")] = column
        else:
            found[column] = column
    return found


def summarise(rows: Rows, columns: list[str]) -> Summary:
    """Sums up the rows of a table.

    Args:
        rows: by number of the variant.
        columns: of the table.
    """
    outcomes = []
    for name, column in value_columns(columns).items():
        values = [
            (float(row[column]), k) for k, row in sorted(rows.items()) if is_known(row, column)
        ]
        flag = f"expect.{name}"
        held = sum(row[flag] is True for row in rows.values()) if flag in columns else None
        if not values:
            nothing = (math.nan, -1)
            outcomes.append(Outcomes(name, held, 0, nothing, math.nan, nothing))
            continue
        median = float(np.median([value for value, _ in values]))
        outcomes.append(Outcomes(name, held, len(values), min(values), median, max(values)))
    errors = {k: str(row["error"]) for k, row in sorted(rows.items()) if row["error"]}
    held_all = sum(row["held"] is True for row in rows.values())
    return Summary(len(rows), held_all, errors, outcomes)


def is_known(row: Mapping[str, Any], column: str) -> bool:
    """Whether a row has a finite number there."""
    value = row.get(column)
    return isinstance(value, int | float) and math.isfinite(value)
