"""Tests whether the expectations of a scenario detect faults.

An expectation that always passes tests nothing. As in mutation testing of programs, each mutation
worsens the scenario in one way (half the stiffness, an undeclared load, a sensor bias), so that at
least one expectation should fail.

Source: DeMillo, Lipton, Sayward 1978, Hints on Test Data Selection: Help for the Practicing
Programmer, Computer 11(4).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ...base.errors import DeclarationError, Problem
from ...base.toml_file import located, read_toml
from .sweep_results import is_known, value_columns

COLUMN = "mutation"
_EXAMPLE = 'a table such as ["half as stiff"] with "controllers.lwr.stiffness" = 400'


@dataclass(frozen=True)
class Mutations:
    """A `Design` of a sweep: the unchanged scenario, and one variant per mutation.

    Args:
        file: TOML file with the mutations.
        tables: mapping from names of mutations to values by dotted key.
    """

    file: Path
    tables: Mapping[str, Mapping[str, Any]]

    @classmethod
    def read(cls, file: Path) -> Mutations:
        """Reads a TOML file with one table of dotted keys per mutation, like `[set]` of a scenario.

        Raises:
            DeclarationError: the file is invalid, or a mutation is empty.
        """
        tables = read_toml(file)
        problems = [
            Problem(name, "is empty" if table == {} else "is not a table", expected=_EXAMPLE)
            for name, table in tables.items()
            if not isinstance(table, dict) or not table
        ]
        if not tables:
            problems.append(Problem("", "has no mutations", expected=_EXAMPLE))
        if problems:
            raise DeclarationError(located(problems, file))
        return cls(file, {name: dict(_flat(table)) for name, table in tables.items()})

    @property
    def columns(self) -> list[str]:
        return [COLUMN]

    @cached_property
    def variants(self) -> list[dict[str, Any]]:
        """Overriding values of all variants by dotted key; empty for the unchanged scenario."""
        return [{}, *map(dict, self.tables.values())]

    def name(self, number: int) -> str:
        """Returns the name of a variant's mutation, or "" for the unchanged scenario."""
        return ["", *self.tables][number]

    def cells(self, number: int) -> dict[str, Any]:
        return {COLUMN: self.name(number)}

    def choices(self) -> list[dict[str, Any]]:
        """Returns the values of all mutations, because any value may be a file name."""
        return self.variants[1:]

    def settings(self) -> dict[str, Any]:
        return {"mutations": self.tables}

    def check(self, read: Callable[[Mapping[str, Any]], object], fixed: Mapping[str, Any]) -> None:
        """Checks that every mutation is a valid scenario."""
        problems: list[Problem] = []
        for name, values in self.tables.items():
            try:
                read(values)
            except DeclarationError as error:
                # The unchanged scenario is valid, so all problems come from the mutation.
                problems += (
                    replace(problem, key=f"{name}.{problem.key}".rstrip("."), file=None, line=None)
                    for problem in error.problems
                )
        if problems:
            raise DeclarationError(located(problems, self.file))


def _flat(table: Mapping[str, Any], before: str = "") -> list[tuple[str, Any]]:
    """Returns pairs of dotted key and value. The value of a quoted key with dots is not flattened.

    `"controllers.lwr" = { kind = "torque" }` replaces a table, and `controllers.lwr.kind` changes
    an entry of it.
    """
    found: list[tuple[str, Any]] = []
    for name, value in table.items():
        key = f"{before}{name}"
        if isinstance(value, dict) and "." not in name:
            found += _flat(value, f"{key}.")
        else:
            found.append((key, value))
    return found


@dataclass(frozen=True)
class Judged:
    """The expectations that detect a mutation.

    Attributes:
        noticed_by: failed expectations, or the error that stopped the run.
        moved: expectation whose value the mutation changes most in relative terms. If no
            expectation detects the mutation, tighten the bounds of this one. None if no value is
            known or changes.
        value: value of the expectation `moved` with the mutation.
        value_without: value of the expectation `moved` without the mutation.
    """

    noticed_by: list[str]
    moved: str | None
    value: float
    value_without: float


def judge(row: Mapping[str, Any], without: Mapping[str, Any]) -> Judged:
    """Returns the expectations that detect a mutation.

    Args:
        row: results of the mutation by column.
        without: results of the unchanged scenario by column; empty if unknown.
    """
    columns = value_columns([*row])
    expected = [name for name in columns if columns[name].startswith("expect.")]
    failed = [name for name in expected if row[f"expect.{name}"] is False]
    best: tuple[str | None, float, float] = (None, math.nan, math.nan)
    largest = 0.0
    for name in expected:
        if is_known(row, columns[name]) and is_known(without, columns[name]):
            value, other = float(row[columns[name]]), float(without[columns[name]])
            change = abs(value - other) / max(abs(other), 1e-12)
            if change > largest:
                best, largest = (name, value, other), change
    return Judged([str(row["error"])] if row["error"] else failed, *best)
