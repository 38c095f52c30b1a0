"""Summaries of a sweep for the terminal and as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from textwrap import shorten
from typing import Any, Protocol

from ...cli.arguments import print_table
from .mutations import Judged, Mutations, judge
from .sweep import Sweep
from .sweep_results import Rows, summarise_sweep

_MAX_NAMES = 3  # maximum number of shown expectations per mutation
_WIDTH = 100  # maximum width of expectations or of an error, characters
_ERRORS = 5  # maximum number of shown errors


class Report(Protocol):
    """A summary of the completed variants of a sweep.

    Attributes:
        is_good: whether all variants passed, or all mutations were detected.
    """

    is_good: bool

    def show(self) -> None: ...

    def as_json(self) -> dict[str, Any]: ...


def report_of(sweep: Sweep, rows: Rows) -> Report:
    """Returns the summary of a sweep."""
    if isinstance(sweep.design, Mutations):
        return _OfMutations(sweep.design, rows)
    return _OfSamples(sweep, rows)


class _OfSamples:
    """A summary with the lowest and highest outcomes, and the number of variants that passed."""

    def __init__(self, sweep: Sweep, rows: Rows) -> None:
        self._sweep = sweep
        self._summary = summarise_sweep(rows, sweep.columns)
        self.is_good = self._summary.held == self._summary.count

    def show(self) -> None:
        from rich.table import Table

        summary = self._summary
        shown = Table(box=None, pad_edge=False)
        shown.add_column("")
        for heading in ("held", "lowest", "at", "median", "highest", "at"):
            shown.add_column(heading, justify="left" if heading == "at" else "right")
        for each in summary.outcomes:
            held = "" if each.held is None else f"{each.held}/{summary.count}"
            lowest, median, highest = (
                "" if math.isnan(value) else f"{value:.4g}"
                for value in (each.lowest[0], each.median, each.highest[0])
            )
            low, high = (self._values(number) for _, number in (each.lowest, each.highest))
            shown.add_row(each.name, held, lowest, low, median, highest, high)
        print_table(shown)
        for number, error in list(summary.errors.items())[:_ERRORS]:
            print(f"  stopped {self._values(number)}: {error}")
        if len(summary.errors) > _ERRORS:
            print(f"  stopped ... {len(summary.errors) - _ERRORS} more")
        failed = summary.count - summary.held - len(summary.errors)
        print(
            f"{summary.held} passed, {failed} failed, {len(summary.errors)} stopped with an error"
        )

    def _values(self, number: int) -> str:
        if number < 0:
            return ""
        parts = []
        for key, value in self._sweep.variants[number].items():
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
            parts.append(f"{key.rpartition('.')[2]} {text}")
        return ", ".join(parts)

    def as_json(self) -> dict[str, Any]:
        def at(value: float, number: int) -> Any:
            if math.isnan(value):
                return None
            return {"value": value, "variant": number, "values": self._sweep.variants[number]}

        return {
            "variants": self._summary.count,
            "held": self._summary.held,
            "errors": {str(number): error for number, error in self._summary.errors.items()},
            "outcomes": {
                each.name: {
                    "held": each.held,
                    "known": each.known,
                    "lowest": at(*each.lowest),
                    "median": each.median,
                    "highest": at(*each.highest),
                }
                for each in self._summary.outcomes
            },
        }


class _OfMutations:
    """A summary of detected and undetected mutations."""

    def __init__(self, design: Mutations, rows: Rows) -> None:
        without = rows.get(0, {})
        found = {design.name(number): judge(row, without) for number, row in sorted(rows.items())}
        # Expectations that fail without a mutation.
        self._failing = found.pop("").noticed_by if without else []
        self._found: Mapping[str, Judged] = found
        self._unnoticed = [name for name, judged in found.items() if not judged.noticed_by]
        self.is_good = not (self._unnoticed or self._failing)

    def show(self) -> None:
        from rich.table import Table
        from rich.text import Text

        shown = Table(box=None, pad_edge=False)
        shown.add_column("mutation")
        shown.add_column("detected by")
        for name, judged in sorted(self._found.items(), key=lambda each: not each[1].noticed_by):
            nothing = Text.assemble(("nothing", "bold"), _moved(judged))
            shown.add_row(name, _named(judged.noticed_by) or nothing)
        print_table(shown)
        if self._failing:
            failing = ", ".join(self._failing)
            print(f"these expectations fail without a mutation: {failing}")
        noticed = len(self._found) - len(self._unnoticed)
        print(f"{noticed} detected, {len(self._unnoticed)} not detected")

    def as_json(self) -> dict[str, Any]:
        return {
            "mutations": len(self._found),
            "unnoticed": self._unnoticed,
            "found": {name: asdict(judged) for name, judged in self._found.items()},
            "failing_without": self._failing,
        }


def _named(noticed_by: list[str]) -> str:
    count = len(noticed_by) - _MAX_NAMES
    more = f" and {count} more" if count > 0 else ""
    return shorten(", ".join(noticed_by[:_MAX_NAMES]), _WIDTH, placeholder=" ...") + more


def _moved(judged: Judged) -> str:
    if judged.moved is None:
        return ""
    return f"; {judged.moved} {judged.value:.4g}, without it {judged.value_without:.4g}"
