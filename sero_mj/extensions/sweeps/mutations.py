"""`Mutations`: what may be wrong in a scenario, and whether what it expects notices each of them.

An expectation that holds whatever goes wrong tests nothing. As in mutation testing of programs, one
thing is made wrong at a time (half the stiffness, an undeclared load, a sensor that is off), and
something that is expected has to fail.

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
_EXAMPLE = 'a table, ["half as stiff"] say, with "controllers.lwr.stiffness" = 400'


@dataclass(frozen=True)
class Mutations:
    """A variant as the scenario is, and one for each mutation; a `Design` of a sweep.

    Args:
        tables: what each sets, dotted keys to their values, by its name.
    """

    file: Path
    tables: Mapping[str, Mapping[str, Any]]

    @classmethod
    def read(cls, file: Path) -> Mutations:
        """Reads a TOML file in which every mutation is a table of dotted keys, as `[set]` is.

        Raises:
            DeclarationError: it cannot be read, has none, or one that sets nothing.
        """
        tables = read_toml(file)
        problems = [
            Problem(name, "sets nothing" if table == {} else "is no table", expected=_EXAMPLE)
            for name, table in tables.items()
            if not isinstance(table, dict) or not table
        ]
        if not tables:
            problems.append(Problem("", "has no mutation", expected=_EXAMPLE))
        if problems:
            raise DeclarationError(located(problems, file))
        return cls(file, {name: dict(_flat(table)) for name, table in tables.items()})

    @property
    def columns(self) -> list[str]:
        """The name."""
        return [COLUMN]

    @cached_property
    def variants(self) -> list[dict[str, Any]]:
        """Nothing, and then what each mutation sets."""
        return [{}, *map(dict, self.tables.values())]

    def name(self, number: int) -> str:
        """The mutation of a variant; empty for the scenario as it is."""
        return ["", *self.tables][number]

    def cells(self, number: int) -> dict[str, Any]:
        """The name."""
        return {COLUMN: self.name(number)}

    def choices(self) -> list[dict[str, Any]]:
        """All: any may name a file."""
        return self.variants[1:]

    def settings(self) -> dict[str, Any]:
        """What each sets."""
        return {"mutations": self.tables}

    def check(self, read: Callable[[Mapping[str, Any]], object], fixed: Mapping[str, Any]) -> None:
        """Checks that every mutation can be read; what is refused at once needs no expectation."""
        problems: list[Problem] = []
        for name, values in self.tables.items():
            try:
                read(values)
            except DeclarationError as error:
                # The scenario as it is has none: whatever is wrong, in any file, is set here.
                problems += (
                    replace(problem, key=f"{name}.{problem.key}".rstrip("."), file=None, line=None)
                    for problem in error.problems
                )
        if problems:
            raise DeclarationError(located(problems, self.file))


def _flat(table: Mapping[str, Any], before: str = "") -> list[tuple[str, Any]]:
    """Dotted keys to values: one in quotes has a value as it is, others lead to what is inside.

    `"controllers.lwr" = { kind = "torque" }` replaces a table, and `controllers.lwr.kind` changes
    what is in it.
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
    """Whether what a scenario expects notices a mutation.

    Attributes:
        noticed_by: expectations that do not hold, or the error that stopped the run.
        moved: the expectation whose value is changed most, as a share of what it is without the
            mutation: where nothing is noticed, it is the one to be drawn tighter. None where no
            value is changed, or none is known.
        value: that of this expectation.
        value_without: its value without the mutation.
    """

    noticed_by: list[str]
    moved: str | None
    value: float
    value_without: float


def judge(row: Mapping[str, Any], without: Mapping[str, Any]) -> Judged:
    """Judges a mutation.

    Args:
        without: that of the scenario as it is; empty if it is not known.
    """
    columns = value_columns([*row])
    expected = [name for name in columns if columns[name].startswith("expect.")]
    failed = [name for name in expected if row[f"expect.{name}"] is False]
    best: tuple[str | None, float, float] = (None, math.nan, math.nan)
    most = 0.0
    for name in expected:
        if is_known(row, columns[name]) and is_known(without, columns[name]):
            value, other = float(row[columns[name]]), float(without[columns[name]])
            change = abs(value - other) / max(abs(other), 1e-12)
            if change > most:
                best, most = (name, value, other), change
    return Judged([str(row["error"])] if row["error"] else failed, *best)
