"""Reads tables of numbers in text files, with any of the usual separators."""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...base.errors import (
    CsvError,
    did_you_mean,
    mismatch,
)
from ...base.frames import Array
from ...base.paths import open_file
from ...data.record.csv_files import TIME, Columns

if TYPE_CHECKING:
    from _csv import Reader

_COMMENT = "#"
_WESTERN = "cp1252"  # of Windows, where programs write a degree sign, say
_SEPARATORS = (";", "\t", ",", " ")  # in the order in which they are tried
_SHOWN = 20  # names of columns
_HEAD = 200  # lines in which the first two rows are looked for
_TIME_UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
# Units that may be in brackets behind the name of a column; an index or a name there is none.
_UNITS = frozenset(
    [*_TIME_UNITS, "rad", "mrad", "deg", "degree", "degrees", "°", "m", "mm", "rad/s", "deg/s",
     "°/s", "m/s", "mm/s", "Nm", "mNm", "N", "A", "mA", "V", "C", "°C", "Hz", "%"]
)  # fmt: skip
# Names of columns with the time, without their unit, in lower case.
_TIMES = ("time", "timestamp", "time_stamp", "stamp", "t")
_UNIT = re.compile(r"\s*[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")
_TIME_SUFFIX = re.compile(rf"[ _.]({'|'.join(_TIME_UNITS)})$")
# In SI, seconds since 1970 are below the first; in ms, us and ns below the next ones.
_EPOCHS = ((1e11, 1.0), (1e14, 1e-3), (1e17, 1e-6), (math.inf, 1e-9))
# Second columns of `franka::logToCSV`, whose times are in ms (libfranka, robot_state_log.cpp).
_LIBFRANKA = ("success_rate", "success rate")

_Number = Callable[[str], float | None]


def split_unit(name: str) -> tuple[str, str]:
    """The name of a column without the unit in brackets behind it, and that unit or ""."""
    found = _UNIT.search(name)
    if found is None or found[1] not in _UNITS or not found.start():
        return name, ""
    return name[: found.start()], found[1]


@dataclass(frozen=True)
class Table:
    """The numbers of a table.

    Attributes:
        time: name of the column with the times; empty where a rate was given.
        times: of the rows, s, (T,), non-decreasing; those since 1970 count from there.
        columns: name to values, (T,), of the other columns; NaN and infinity are read as such,
            empty cells and text as NaN.
        wrong: name of a column with text to its first cell that is no number.
    """

    path: Path
    time: str
    times: Array
    columns: dict[str, Array]
    wrong: dict[str, CsvError]

    def column(self, name: str) -> Array:
        """The values of a column, (T,); raises CsvError if there is none, or it has text."""
        if name in self.wrong:
            raise self.wrong[name]
        if name not in self.columns:
            raise CsvError(self.path, f"there is no column '{name}'{self._near(name)}")
        return self.columns[name]

    def _near(self, name: str) -> str:
        return did_you_mean(name, self.columns)


def read_csv(
    path: Path | str, *, rate: float | None = None, instead: str = ""
) -> tuple[Array, dict[str, Array]]:
    """Reads a table in which every cell is a number or empty; see `read_table`.

    Returns:
        the times of the rows, s, (T,), and name to column, (T,).

    Raises:
        CsvError: as of `read_table`, or a cell that is no number.
        ValueError: a rate that is not above 0.
    """
    table = read_table(path, rate=rate, instead=instead)
    if table.wrong:
        raise min(table.wrong.values(), key=lambda error: error.line or 0)
    return table.times, table.columns


def read_table(
    path: Path | str, *, rate: float | None = None, time: str = "", instead: str = ""
) -> Table:
    """Reads a table, with cells separated by semicolons, tabs, commas or blanks.

    The first line may name the columns, also after `#`, as written by numpy; without names they
    are `1`, `2`, ... A second column of a name gets `.1` behind it, as in pandas. A first column
    that is the only one without a name is an index, as in pandas, and is left out. Empty lines and
    comments, which begin with `#`, are skipped. Numbers may have decimal commas where commas do not
    separate.

    The times are in the column `time`, else in one called `timestamp` or `t`, in any letter case
    and with or without a unit (`Timestamp`, `t_ms`, `time [us]`), else in the first column with a
    unit of time (`Zeit [s]`). Without a unit they are in s. Numbers of 1e11 and more are ms, us or
    ns since 1970, by their size. Dates with times are read as ISO 8601. Tables of libfranka are in
    ms.

    Args:
        rate: rows per s, instead of a column of times, which is then left out.
        time: name of the column of the times; found as above when empty.
        instead: how a rate can be given, for the message about missing times.

    Raises:
        CsvError: the file, with line and column, what was found, and what would be right.
        ValueError: a rate that is not above 0.
    """
    if rate is not None and not 0.0 < rate < math.inf:
        raise mismatch(rate, "rows per s, above 0", key="rate")
    path = Path(path)
    encoding = "utf-8-sig"
    while True:
        try:
            with io.TextIOWrapper(open_file(path), newline="", encoding=encoding) as file:
                return _Rows(path, rate, time, instead).read(file)
        except UnicodeDecodeError as error:
            if encoding == _WESTERN or b"\0" in error.object:
                raise CsvError(path, f"is no text in UTF-8: {error.reason}") from error
            encoding = _WESTERN
        except OSError as error:
            raise CsvError(path, f"cannot be read: {error.strerror}") from error


def read_cached(
    path: Path, columns: Columns, rate: float | None = None, instead: str = ""
) -> Table:
    """Calls `read_table`, and caches the table until the file changes.

    Args:
        columns: declared columns, with `time` if they name the column of the times.
    """
    time = columns.get(TIME, "")
    time = time if isinstance(time, str) else time[0]
    try:
        about = path.stat()
    except OSError:
        return read_table(path)  # raises the error with its reason
    state = path.absolute(), about.st_mtime_ns, about.st_size
    return _cached(path, state, rate, time, instead)


@lru_cache(4)
def _cached(path: Path, _: tuple[Any, ...], rate: float | None, time: str, instead: str) -> Table:
    return read_table(path, rate=rate, time=time, instead=instead)


class _Rows:
    """Reads the rows of one table; see `read_table`."""

    def __init__(self, path: Path, rate: float | None, time: str, instead: str) -> None:
        self._path, self._rate, self._wanted, self._instead = path, rate, time, instead
        self._names: list[str] = []
        self._has_index = False
        self._open_line = 0  # of names that end in a separator
        self._time, self._factor = "", 1.0
        self._wrong: dict[str, CsvError] = {}

    def read(self, lines: Iterator[str]) -> Table:
        reader, number = _reader(lines)
        numbers = array("d")
        earlier = -math.inf
        for line, cells, comment in self._filled_rows(reader):
            if not self._names and self._name_columns(line, cells, comment, number):
                continue
            for name, cell in zip(self._names, self._of_columns(line, cells), strict=True):
                value = number(cell)
                if name == self._time:
                    earlier = value = self._checked_time(line, cell, value, earlier)
                elif value is None:
                    reason = f"found '{cell.strip()}'; expected a number, or nan"
                    error = CsvError(self._path, reason, line=line, column=name)
                    self._wrong.setdefault(name, error)
                    value = math.nan
                numbers.append(value)
        if not numbers:
            raise CsvError(self._path, "has no row of numbers")
        rows = np.array(numbers).reshape(-1, len(self._names))
        columns = dict(zip(self._names, rows.T, strict=True))
        times = columns.pop(self._time, np.zeros(0)) * self._factor
        if self._rate is not None:
            times = np.arange(len(rows)) / self._rate
        return Table(self._path, self._time, times, columns, self._wrong)

    def _filled_rows(self, reader: Reader) -> Iterator[tuple[int, list[str], list[str]]]:
        comment: list[str] = []
        try:
            for cells in reader:
                if cells and cells[0].startswith(_COMMENT):
                    first = cells[0].lstrip("# ")
                    comment = [cell.strip() for cell in ([first] if first else []) + cells[1:]]
                elif any(cell.strip() for cell in cells):
                    yield reader.line_num, cells, comment
        except csv.Error as error:
            raise CsvError(self._path, f"is no table: {error}", line=reader.line_num) from error

    def _name_columns(
        self, line: int, cells: list[str], comment: list[str], number: _Number
    ) -> bool:
        dates = [_date(cell) is not None for cell in cells]
        is_header = _is_count(cells) or any(
            number(cell) is None and not is_date for cell, is_date in zip(cells, dates, strict=True)
        )
        if is_header:
            names = [cell.strip() for cell in cells]
        elif len(comment) == len(cells):
            names = comment
        else:
            names = [str(i) for i in range(1, len(cells) + 1)]
        if len(names) > 2 and not names[-1]:
            names, self._open_line = names[:-1], line
        self._has_index = not names[0] and len(names) > 1
        names = names[self._has_index :]
        for i, name in enumerate(names):
            if not name:
                found = f"column {i + 1 + self._has_index} has no name"
                raise CsvError(self._path, found, line=line)
            count = names[:i].count(name)
            self._names.append(f"{name}.{count}" if count else name)
        self._find_time()
        return is_header

    def _find_time(self) -> None:
        names, wanted = self._names, self._wanted
        if wanted and wanted not in names:
            near = did_you_mean(wanted, names)
            raise CsvError(self._path, f"there is no column '{wanted}', for the time{near}")
        found = next(filter(None, [wanted, time_column(names)]), "")
        if self._rate is None and not found:
            shown = ", ".join(names[:_SHOWN])
            reason = f"found the columns {shown}; expected one called {TIME}, in s{self._instead}"
            raise CsvError(self._path, reason)
        self._time = found
        self._factor = _factor_of(names, found) if found else 1.0

    def _checked_time(self, line: int, cell: str, value: float | None, earlier: float) -> float:
        if self._rate is not None:
            return math.nan
        value = _date(cell) if value is None else value
        if value is None:
            reason = f"found '{cell.strip()}'; expected a number, or nan"
            raise CsvError(self._path, reason, line=line, column=self._time)
        if not (math.isfinite(value) and value >= earlier):
            after = f" after {earlier!r}" if math.isfinite(earlier) else ""
            found = f"{cell.strip() or 'nothing'}{after}"
            reason = f"found {found}; expected s that never decrease"
            raise CsvError(self._path, reason, line=line, column=self._time)
        if math.isnan(self._factor):
            self._factor = next(each for below, each in _EPOCHS if abs(value) < below)
        return value

    def _of_columns(self, line: int, cells: list[str]) -> list[str]:
        wanted = len(self._names) + self._has_index
        if self._open_line and len(cells) == wanted + 1 and cells.pop().strip():
            reason = f"column {wanted + 1} has no name"
            raise CsvError(self._path, reason, line=self._open_line)
        if len(cells) != wanted:
            reason = f"found {len(cells)} values; expected {wanted}, one for each column"
            raise CsvError(self._path, reason, line=line)
        return cells[self._has_index :]


def time_column(names: Sequence[str]) -> str:
    """The column of the times among others, as `read_table` finds it; empty if there is none."""
    if names[1:2] and names[1] in _LIBFRANKA:
        return names[0]
    for name in (TIME, *names):
        stem, unit = _time_unit(name)
        if name in names and stem.lower().strip("_%") in _TIMES and unit is not None:
            return name
    return next((name for name in names if split_unit(name)[1] in _TIME_UNITS), "")


def _time_unit(name: str) -> tuple[str, str | None]:
    stem, unit = split_unit(name)
    if unit:
        return stem, unit if unit in _TIME_UNITS else None
    found = _TIME_SUFFIX.search(name)
    return (name[: found.start()], found[1]) if found else (name, "")


def _factor_of(names: Sequence[str], time: str) -> float:
    """The factor from a column of times to s; NaN where the first time tells."""
    if names[1:2] and names[1] in _LIBFRANKA and time == names[0]:
        return 1e-3
    unit = _time_unit(time)[1]
    return _TIME_UNITS[unit] if unit else math.nan


def _reader(lines: Iterator[str]) -> tuple[Reader, _Number]:
    """A reader of the cells, and what reads a number in one.

    Cells are separated by what makes the second row, the first that surely has numbers, one of
    numbers only; where nothing does, because there is text, by what makes as many of the first row.
    """
    head: list[str] = []
    rows: list[str] = []
    for line in itertools.islice(lines, _HEAD):
        head.append(line)
        if line.strip() and not line.startswith(_COMMENT):
            rows.append(line)
        if len(rows) == 2:
            break
    separator = _separator(rows)
    every: Iterator[str] = itertools.chain(head, lines)
    if separator == " ":
        every = (" ".join(line.split()) for line in every)
    reader = csv.reader(every, delimiter=separator)
    return reader, _number if separator == "," else _number_with_comma


def _separator(rows: list[str]) -> str:
    if not rows:
        return ","
    alike = []
    for separator in _SEPARATORS:
        first, last = _cells(rows[0], separator), _cells(rows[-1], separator)
        number = _number if separator == "," else _number_with_comma
        if len(last) > 1 and all(number(cell) is not None for cell in last):
            return separator
        if len(last) > 1 and len(first) == len(last):
            alike.append(separator)
    return next(iter(alike), ",")


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        line = " ".join(line.split())
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


def _is_count(cells: list[str]) -> bool:
    """Whether a row names columns by numbers after an index, as in pandas."""
    counted = [str(i) for i in range(len(cells) - 1)]
    first, *others = (cell.strip() for cell in cells)
    return bool(others) and not first and others == counted


def _number(cell: str) -> float | None:
    try:
        return float(cell) if cell.strip() else math.nan
    except ValueError:
        return None


def _number_with_comma(cell: str) -> float | None:
    return _number(cell.replace(",", "."))


def _date(cell: str) -> float | None:
    """Seconds since 1970 of a date with a time; None for anything else."""
    try:
        return datetime.fromisoformat(cell.strip()).timestamp() if ":" in cell else None
    except ValueError:
        return None
