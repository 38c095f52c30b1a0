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
_WESTERN = "cp1252"  # for example, for degree signs written by Windows programs
_SEPARATORS = (";", "\t", ",", " ")  # in the order in which they are tried
_SHOWN = 20  # maximum number of column names in an error
_HEAD = 200  # maximum number of lines that are searched for the first two rows
_TIME_UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
# Units that can follow the name of a column in brackets. Other text in brackets is kept.
_UNITS = frozenset(
    [*_TIME_UNITS, "rad", "mrad", "deg", "degree", "degrees", "°", "m", "mm", "rad/s", "deg/s",
     "°/s", "m/s", "mm/s", "Nm", "mNm", "N", "A", "mA", "V", "C", "°C", "Hz", "%"]
)  # fmt: skip
# Names of time columns without the unit, in lower case.
_TIMES = ("time", "timestamp", "time_stamp", "stamp", "t")
_UNIT = re.compile(r"\s*[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")
_TIME_SUFFIX = re.compile(rf"[ _.]({'|'.join(_TIME_UNITS)})$")
# Upper bounds of times since 1970 in s, ms, us and ns, and the factors to s.
_EPOCHS = ((1e11, 1.0), (1e14, 1e-3), (1e17, 1e-6), (math.inf, 1e-9))
# Second column of tables from `franka::logToCSV`, which have times in ms (libfranka,
# robot_state_log.cpp).
_LIBFRANKA = ("success_rate", "success rate")

_Number = Callable[[str], float | None]


def split_unit(name: str) -> tuple[str, str]:
    """Returns the name of a column without its unit, and the unit; "" if there is no unit."""
    found = _UNIT.search(name)
    if found is None or found[1] not in _UNITS or not found.start():
        return name, ""
    return name[: found.start()], found[1]


@dataclass(frozen=True)
class Table:
    """The numbers of a table.

    Attributes:
        time: name of the time column; empty if a rate is declared.
        times: non-decreasing times of the rows, shape (T,), s; absolute times are relative to 1970.
        columns: values of the other columns by name, shape (T,). Empty cells and text are NaN.
        wrong: errors by column name, for columns with text. Each one describes the first cell with
            text in the column.
    """

    path: Path
    time: str
    times: Array
    columns: dict[str, Array]
    wrong: dict[str, CsvError]

    def column(self, name: str) -> Array:
        """Returns the values of a column, shape (T,).

        Raises CsvError if the column is missing or has text.
        """
        if name in self.wrong:
            raise self.wrong[name]
        if name not in self.columns:
            near = did_you_mean(name, self.columns)
            raise CsvError(self.path, f"no column '{name}'{near}")
        return self.columns[name]


def read_csv(
    path: Path | str, *, rate: float | None = None, instead: str = ""
) -> tuple[Array, dict[str, Array]]:
    """Reads a table like `read_table`, but raises CsvError for cells with text.

    Returns:
        Times of the rows, shape (T,), s, and values of the columns by name, shape (T,).
    """
    table = read_table(path, rate=rate, instead=instead)
    if table.wrong:
        raise min(table.wrong.values(), key=lambda error: error.line or 0)
    return table.times, table.columns


def read_table(
    path: Path | str, *, rate: float | None = None, time: str = "", instead: str = ""
) -> Table:
    """Reads a table with cells separated by semicolons, tabs, commas or spaces.

    - The first line can have the names of the columns, also after `#`, as written by NumPy.
      Without names, columns are called `1`, `2` and so on. `.1` is appended to a repeated name, as
      in pandas.
    - If only the first column has no name, it is an index, as in pandas, and is skipped.
    - Empty lines, and comments that begin with `#`, are skipped.
    - Decimal commas are read if commas do not separate cells.
    - The time column is called `time`, `timestamp`, `stamp` or `t`, in any letter case, with or
      without a unit (`Timestamp`, `t_ms`, `time [us]`). Otherwise, it is the first column with a
      unit of time (`Zeit [s]`).
    - Times without a unit are in s. If they are at least 1e11, their magnitude shows whether they
      are ms, us or ns since 1970. Tables of libfranka have times in ms. Dates with times are read
      as ISO 8601.

    Raises CsvError, or ValueError if `rate` is not above 0.

    Args:
        rate: rows per second; replaces the time column, which is then skipped.
        time: name of the time column; empty to find it automatically.
        instead: option that declares a rate, for the error about a missing time column.
    """
    if rate is not None and not 0.0 < rate < math.inf:
        raise mismatch(rate, "a finite number of rows per second above 0", key="rate")
    path = Path(path)
    encoding = "utf-8-sig"
    while True:
        try:
            with io.TextIOWrapper(open_file(path), newline="", encoding=encoding) as file:
                return _Rows(path, rate, time, instead).read(file)
        except UnicodeDecodeError as error:
            if encoding == _WESTERN or b"\0" in error.object:
                raise CsvError(path, f"is not text in UTF-8: {error.reason}") from error
            encoding = _WESTERN
        except OSError as error:
            raise CsvError(path, f"cannot be read: {error.strerror}") from error


def read_cached(
    path: Path, columns: Columns, rate: float | None = None, instead: str = ""
) -> Table:
    """Reads a table with the time column in `columns`; caches it until the file changes."""
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
    """The reader of the rows of one table for `read_table`."""

    def __init__(self, path: Path, rate: float | None, time: str, instead: str) -> None:
        self._path, self._rate, self._wanted, self._instead = path, rate, time, instead
        self._names: list[str] = []
        self._has_index = False
        self._open_line = 0  # line of names that end in a separator
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
            raise CsvError(self._path, "has no rows with numbers")
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
            reason = f"is not a table: {error}"
            raise CsvError(self._path, reason, line=reader.line_num) from error

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
            raise CsvError(self._path, f"no time column '{wanted}'{near}")
        found = next(filter(None, [wanted, time_column(names)]), "")
        if self._rate is None and not found:
            shown = ", ".join(names[:_SHOWN])
            reason = f"found the columns {shown}; expected a column {TIME} in s{self._instead}"
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
            reason = f"found {found}; expected times in s that never decrease"
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
    """Returns the time column as `read_table` finds it; "" if there is none."""
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
    # Returns NaN if the magnitude of the first time determines the factor.
    if names[1:2] and names[1] in _LIBFRANKA and time == names[0]:
        return 1e-3
    unit = _time_unit(time)[1]
    return _TIME_UNITS[unit] if unit else math.nan


def _reader(lines: Iterator[str]) -> tuple[Reader, _Number]:
    # The separator is the first one with which all cells of the second row are numbers. Otherwise,
    # it is the first one with which the first two rows have the same number of cells.
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
    # Column names of pandas: an index without a name, followed by 0, 1, ...
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
    try:
        return datetime.fromisoformat(cell.strip()).timestamp() if ":" in cell else None
    except ValueError:
        return None
