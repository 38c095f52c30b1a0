"""Stores, summarizes and plots the results of a sweep."""

from __future__ import annotations

import csv
import io
import json
import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from ...base.errors import CsvError, Problem, RenderError, UsageError
from ...data.record.csv_files import csv_table
from ...study.figure import check_suffix
from .samples import Samples, Vary
from .sweep import Sweep
from .variant import UNITS

_MAX_ROWS, _MAX_COLUMNS = 8, 5  # maximum numbers of rows and columns of the plot
_LABEL_WIDTH = 22  # width of labels, characters
_HELD, _FAILED = "#2a7f62", "#c8553d"
_BOUND: dict[str, Any] = {"color": "#777777", "lw": 0.9, "ls": "--"}
# Units by the last part of a key, if all keys with this last part have the same unit.
_UNITS_OF_KEYS = {
    **dict.fromkeys(("begin", "end", "duration", "timestep", "delay", "after", "before"), "s"),
    "mass": "kg",
    "delay_ms": "ms",
    "offset_deg": "deg",
}


class SweepTable:
    """The results of all variants of a sweep, in memory and in a CSV file.

    OUT.csv.json contains the settings of the sweep. Rows are written immediately. When all variants
    are done, the rows are sorted, so that the file does not depend on the number of processes. Use
    the table as a context manager.

    Args:
        path: output file; None to store the results in memory only.
        resume: whether to continue an existing file.
        overwrite: whether to replace an existing file.

    Attributes:
        rows: cells by variant number and column; None for unknown values.

    Raises:
        UsageError: the file exists, and neither `resume` nor `overwrite` is set, or it belongs to
            another sweep.
        CsvError: the file cannot be written, or is not a table of a sweep.
    """

    def __init__(
        self,
        sweep: Sweep,
        path: Path | None = None,
        *,
        resume: bool = False,
        overwrite: bool = False,
    ) -> None:
        self.rows: dict[int, dict[str, Any]] = {}
        self._sweep, self._path = sweep, path
        self._columns = sweep.columns
        self._file: Any = None
        if path is None:
            return
        about = path.with_name(f"{path.name}.json")
        try:
            if path.exists() and resume:
                self._check_settings(path, f"--resume {path}", "--overwrite")
                self._read(path)
            elif path.exists() and not overwrite:
                expected = "--resume to continue it, or --overwrite"
                raise UsageError(Problem("", "already exists", str(path), expected=expected))
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                about.write_text(json.dumps(sweep.settings, indent=2) + "\n", encoding="utf-8")
                path.write_text(_line(self._columns), encoding="utf-8")
            self._file = open(path, "a", encoding="utf-8", newline="")  # noqa: SIM115
        except OSError as error:
            raise CsvError(path, f"cannot be written: {error.strerror}") from error

    def _check_settings(self, path: Path, option: str, expected: str | None = None) -> None:
        about = path.with_name(f"{path.name}.json")
        try:
            found = json.loads(about.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            message = f"cannot be continued: {about.name} with its settings is missing"
            raise UsageError(Problem("", message, str(path), expected=expected)) from None
        wanted = json.loads(json.dumps(self._sweep.settings))
        differences = _differences(found, wanted)
        if differences:
            text = "; ".join(differences[:6])
            message = f"it belongs to another sweep: {text}"
            raise UsageError(Problem(option, message))

    def _read(self, path: Path) -> None:
        contents = path.read_bytes()
        whole = contents[: contents.rfind(b"\n") + 1]
        if len(whole) < len(contents):
            with open(path, "r+b") as file:
                file.truncate(len(whole))
        if not whole:  # the sweep was killed before the first line
            path.write_text(_line(self._columns), encoding="utf-8")
            return
        self.rows |= self._rows_of(path, whole)

    def take(self, part: Path) -> None:
        """Adds the rows of another table of this sweep, for example of a shard.

        Raises:
            UsageError: the table belongs to another sweep, or has another result for a variant.
            CsvError: the file cannot be read, or is not a table of a sweep.
        """
        try:
            contents = part.read_bytes()
        except OSError as error:
            raise CsvError(part, f"cannot be read: {error.strerror}") from error
        self._check_settings(part, f"--merge {part}")
        for number, row in self._rows_of(part, contents[: contents.rfind(b"\n") + 1]).items():
            if number not in self.rows:
                self.add(number, row)
            elif _cells(row, self._columns) != _cells(self.rows[number], self._columns):
                message = f"has a different result for variant {number} than an earlier table"
                raise UsageError(Problem(f"--merge {part}", message))

    def _rows_of(self, path: Path, whole: bytes) -> dict[int, dict[str, Any]]:
        rows = {}
        lines = list(csv.reader(io.StringIO(whole.decode("utf-8"), newline="")))
        if not lines:
            return {}
        if lines[0] != self._columns:
            found = f"found columns {','.join(lines[0])[:80]}"
            raise CsvError(path, Problem("", found, expected="the columns of this sweep"))
        for number, cells in enumerate(lines[1:], start=2):
            if len(cells) != len(self._columns) or not cells[0].isdecimal():
                expected = f"the number of a variant and {len(self._columns) - 1} other entries"
                problem = Problem(found=len(cells), of="entries", expected=expected)
                raise CsvError(path, problem, line=number)
            variant = int(cells[0])
            if variant >= len(self._sweep.variants):
                expected = f"a number below {len(self._sweep.variants)}"
                problem = Problem("", "found variant", found=variant, expected=expected)
                raise CsvError(path, problem, line=number)
            own = self._sweep.design.cells(variant)
            row = dict(zip(self._columns, (_value(cell) for cell in cells), strict=True))
            rows[variant] = {**row, "error": cells[self._columns.index("error")], **own}
        return rows

    def add(self, number: int, result: Mapping[str, Any]) -> None:
        """Adds the results of a variant. Raises CsvError if the disk is full."""
        row = {"variant": number, **self._sweep.design.cells(number), **result}
        self.rows[number] = {column: row.get(column) for column in self._columns}
        if self._file is None:
            return
        try:
            self._file.write(_line(_cells(self.rows[number], self._columns)))
            self._file.flush()
        except OSError as error:
            assert self._path is not None
            raise CsvError(self._path, f"cannot be written: {error.strerror}") from error

    def close(self) -> None:
        """Sorts the rows if all variants are done."""
        if self._file is None or self._path is None:
            return
        self._file.close()
        self._file = None
        if len(self.rows) < len(self._sweep.variants):
            return
        # If this fails, the rows remain unsorted.
        with csv_table(self._path, "cannot be sorted") as table:
            table.writerow(self._columns)
            for number in sorted(self.rows):
                table.writerow(_cells(self.rows[number], self._columns))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _line(cells: list[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def _cells(row: Mapping[str, Any], columns: list[str]) -> list[str]:
    return [_cell(row[column]) for column in columns]


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def _value(cell: str) -> Any:
    if cell in ("", "true", "false"):
        return {"": None, "true": True, "false": False}[cell]
    try:
        return int(cell) if cell.lstrip("-").isdecimal() else float(cell)
    except ValueError:
        return cell


def _differences(found: Any, wanted: Any, key: str = "") -> list[str]:
    if isinstance(found, dict) and isinstance(wanted, dict):
        keys = dict.fromkeys([*found, *wanted])
        return [
            text
            for each in keys
            for text in _differences(
                found.get(each), wanted.get(each), f"{key}.{each}" if key else each
            )
        ]
    if found == wanted:
        return []
    if key.startswith("files."):
        return [f"{key.removeprefix('files.')} has changed"]
    was, now = ("nothing" if value is None else value for value in (found, wanted))
    return [f"{key} was {was} and is {now}"]


Rows = Mapping[int, Mapping[str, Any]]


@dataclass(frozen=True)
class Outcomes:
    """The range of one outcome over all variants.

    Attributes:
        name: name of the expectation, or for example `ROBOT.peak_torque_error`.
        held: number of variants that passed the expectation; None for other outcomes.
        known: number of variants with a known value.
        lowest: lowest value, and number of the variant.
        highest: highest value, and number of the variant.
    """

    name: str
    held: int | None
    known: int
    lowest: tuple[float, int]
    median: float
    highest: tuple[float, int]


@dataclass(frozen=True)
class SweepSummary:
    """The summary of a sweep.

    Attributes:
        count: number of completed variants.
        held: number of variants that passed.
        errors: errors by number of the variant.
    """

    count: int
    held: int
    errors: dict[int, str]
    outcomes: list[Outcomes]


def value_columns(columns: list[str]) -> dict[str, str]:
    """Returns a mapping from the names of numeric outcomes to columns."""
    found = {}
    for column in columns[columns.index("held") + 3 :]:
        if column.startswith("expect."):
            if column.removesuffix(".value") in columns and column.endswith(".value"):
                found[column.removeprefix("expect.").removesuffix(".value")] = column
        else:
            found[column] = column
    return found


def summarise_sweep(rows: Rows, columns: list[str]) -> SweepSummary:
    """Returns the summary of a sweep from its rows, by number of the variant."""
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
    return SweepSummary(len(rows), held_all, errors, outcomes)


def is_known(row: Mapping[str, Any], column: str) -> bool:
    """Whether a row has a finite value in a column."""
    value = row.get(column)
    return isinstance(value, int | float) and math.isfinite(value)


def plot_sweep(sweep: Sweep, rows: Mapping[int, Mapping[str, Any]], path: Path) -> None:
    """Plots the outcomes of a sweep over the varied values.

    Green points passed, and red points failed. Points of robots are green if all expectations of
    the variant passed. Crosses at the lower edge are variants without a value. Dashed lines are
    expected bounds. At most eight outcomes over five keys are plotted, expectations first.

    Args:
        sweep: sweep with the design `Samples`.
        rows: cells by variant number and column.
        path: output file: .png, .pdf or .svg.

    Raises:
        RenderError: the file cannot be written.
        UsageError: the suffix is wrong, or matplotlib is not installed.
    """
    check_suffix(path)
    from matplotlib.figure import Figure  # without pyplot: no window, no global state

    names = value_columns(sweep.columns)
    expected = [name for name in names if names[name].startswith("expect.")]
    others = [
        name
        for name in names
        if name not in expected and any(row.get(names[name]) for row in rows.values())
    ]
    shown = (expected + others)[:_MAX_ROWS]
    assert isinstance(sweep.design, Samples)
    varied = sweep.design.varied[:_MAX_COLUMNS]
    figure = Figure(figsize=(1.2 + 3.3 * len(varied), 1.0 + 1.6 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), len(varied), squeeze=False, sharex="col", sharey="row")
    for line, name in zip(axes, shown, strict=True):
        for axis, vary in zip(line, varied, strict=True):
            _draw(axis, vary, rows, names[name])
            _draw_bounds(axis, sweep, name)
        label = textwrap.fill(_with_unit(name.replace("_", " "), _unit(sweep, name)), _LABEL_WIDTH)
        line[0].set_ylabel(label, fontsize=8)
    for axis, vary in zip(axes[-1], varied, strict=True):
        unit = _UNITS_OF_KEYS.get(vary.key.rpartition(".")[2], "")
        axis.set_xlabel(_with_unit(vary.key, unit), fontsize=8)
    figure.legend(handles=_legend(sweep, shown, rows), loc="outside lower center", ncols=4,
                  fontsize=8, frameon=False)  # fmt: skip
    held = sum(row["held"] is True for row in rows.values())
    figure.suptitle(f"{sweep.base.name}: {held} of {len(rows)} passed", fontsize=11)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise RenderError(f"{path} cannot be written: {error}") from error


def _draw(axis: Any, vary: Vary, rows: Mapping[int, Mapping[str, Any]], column: str) -> None:
    known = [row for _, row in sorted(rows.items()) if is_known(row, column)]
    places = _places(vary, known)
    heights = np.array([float(row[column]) for row in known])
    own = column.removesuffix(".value") if column.startswith("expect.") else "held"
    held = np.array([row[own] is True for row in known], bool)
    for chosen, colour in ((held, _HELD), (~held, _FAILED)):
        axis.scatter(places[chosen], heights[chosen], s=14, c=colour, alpha=0.8)
    lost = _places(vary, [row for row in rows.values() if not is_known(row, column)])
    low = np.full(len(lost), 0.03)
    axis.scatter(lost, low, s=18, c=_FAILED, marker="x", transform=axis.get_xaxis_transform())
    if vary.scale == "log":
        axis.set_xscale("log")
    if vary.values and not _are_numbers(vary.values):
        axis.set_xticks(range(len(vary.values)), [str(value) for value in vary.values], fontsize=7)
    axis.tick_params(which="both", labelsize=7)
    axis.grid(alpha=0.25)


def _unit(sweep: Sweep, name: str) -> str:
    """Returns the unit of an outcome; empty for a number of findings."""
    expect = sweep.base.expect.get(name)
    return UNITS.get(name.rpartition(".")[2], "") if expect is None else expect.unit


def _with_unit(text: str, unit: str) -> str:
    return f"{text}, {unit}" if unit else text


def _legend(sweep: Sweep, shown: list[str], rows: Mapping[int, Mapping[str, Any]]) -> list[Any]:
    from matplotlib.lines import Line2D

    columns = value_columns(sweep.columns)
    lacks = any(not is_known(row, columns[name]) for row in rows.values() for name in shown)
    fails = any(row["held"] is not True for row in rows.values())
    has_bounds = any(sweep.base.expect.get(name) is not None for name in shown)
    point = {"linestyle": "", "markersize": 5}
    entries = [(True, {"marker": "o", "color": _HELD, "label": "passed", **point}),
               (fails, {"marker": "o", "color": _FAILED, "label": "failed", **point}),
               (lacks, {"marker": "x", "color": _FAILED, "label": "no value", **point}),
               (has_bounds, {**_BOUND, "label": "expected bound"})]  # fmt: skip
    return [Line2D([], [], **look) for is_there, look in entries if is_there]


def _places(vary: Vary, rows: list[Mapping[str, Any]]) -> Any:
    values = [row[vary.key] for row in rows]
    if vary.values and not _are_numbers(vary.values):
        values = [vary.values.index(value) for value in values]
    return np.array(values, np.float64)


def _are_numbers(values: tuple[Any, ...]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _draw_bounds(axis: Any, sweep: Sweep, name: str) -> None:
    expect = sweep.base.expect.get(name)
    if expect is None:
        return
    for bound in (expect.below, expect.above, expect.within):
        if bound is not None:
            axis.axhline(bound, **_BOUND)
