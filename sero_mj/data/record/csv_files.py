"""Tables of comma-separated values: exports recordings, and reads tables to be sent."""

from __future__ import annotations

import contextlib
import csv
import io
import math
import os
import re
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...base.errors import CsvError, Problem, SeroError
from ...base.frames import Array
from ...base.paths import open_file
from ..ros.joined_packets import JOINT_EVENTS

if TYPE_CHECKING:
    from _csv import Reader, Writer

    from .recording import PacketFile


TIME = "time"
_COMMENT = "#"
_QUOTED = re.compile(r'"[^"]*"')


@contextlib.contextmanager
def csv_table(path: Path | str, failed: str = "cannot be written") -> Iterator[Writer]:
    """Yields a writer of rows; an existing file is replaced when all of them are written.

    Until then they are in a temporary file beside it, which is removed on failure. Pipes are
    written to directly.

    Args:
        path: the table.
        failed: message on failure, before the reason.

    Raises:
        CsvError: the file cannot be written.
    """
    path = Path(path)
    is_file = path.is_file() or not path.exists()
    whole = path.resolve() if is_file else path  # the target of a link, not the link
    partial = whole.with_name(f"{whole.name}.part") if is_file else whole
    try:
        with open(partial, "w", newline="", encoding="utf-8") as file:
            yield csv.writer(file, lineterminator="\n")
        if is_file:
            os.replace(partial, whole)
    except BaseException as error:
        if is_file:
            with contextlib.suppress(OSError):  # its folder may be missing
                partial.unlink()
        # Some of this package's own errors, of the rows' source, are OSErrors as well.
        if isinstance(error, OSError) and not isinstance(error, SeroError):
            raise CsvError(path, f"{failed}: {error.strerror}") from error
        raise


@dataclass
class Exported:
    """What was written to a table.

    Attributes:
        rows: packets, one row each.
        malformed: number of packets left out because they could not be decoded.
    """

    rows: int = 0
    malformed: int = 0


def column_names(events: Mapping[str, tuple[int, ...]], joints: Sequence[str] = ()) -> list[str]:
    """Returns a name for every number of a packet: `values0[0]`, `vectors0[0][2]`, ...

    Args:
        events: event to its shape.
        joints: names of the joints that messages tell of: `torques[elbow]`; empty for none.
    """
    return [
        f"{event}[{joints[index[0]]}]"
        if joints and event in JOINT_EVENTS
        else event + "".join(f"[{i}]" for i in index)
        for event, shape in events.items()
        for index in np.ndindex(*shape)
    ]


def export_csv(
    recording: PacketFile,
    name: str,
    path: Path | str,
    decode: Callable[[bytes], Mapping[str, NDArray[np.float64]] | None],
    *,
    joints: Sequence[str] = (),
    ordered: Sequence[str] = (),
    start: float = -math.inf,
    stop: float | None = None,
) -> Exported:
    """Writes a source's good packets to a table, a row each: time, then all numbers.

    Numbers have enough digits to be read back exactly; NaN is `nan`. The file appears when it is
    complete, and then replaces an existing one.

    Args:
        recording: to export.
        name: the source.
        path: the file to write.
        decode: a packet to its events; None, or ValueError, for a malformed one.
        joints: names of the joints that messages tell of, in the order of the packets.
        ordered: the same in the order of the columns; as in packets when empty.
        start: first time, s since the recording began.
        stop: end time, exclusive, likewise; None for the end.

    Returns:
        the numbers of rows and of packets left out.

    Raises:
        CsvError: the file cannot be written.
        RecordingError: the recording cannot be read.
        UnknownName: no such source was recorded.
    """
    packets = recording.packets(name, start, stop)
    events = recording.sources[name].events if name in recording.sources else {}
    written = Exported()
    order = [joints.index(name) for name in ordered] or slice(None)

    def rows() -> Iterator[list[float]]:
        for time, packet in packets:
            try:
                values = decode(packet)
            except ValueError:  # what `Structure.decode` raises for a packet of another size
                values = None
            if values is None:
                written.malformed += 1
                continue
            written.rows += 1
            row = [time]
            for event in events:
                numbers = values[event].ravel()
                row += (numbers[order] if joints and event in JOINT_EVENTS else numbers).tolist()
            yield row

    first = next(rows_of := rows(), None)  # recording errors come before a file is created
    with csv_table(path) as table:
        table.writerow([TIME, *column_names(events, ordered or joints)])
        if first is not None:
            table.writerow(first)
        table.writerows(rows_of)
    return written


def read_csv(
    path: Path | str, *, rate: float | None = None, instead: str = ""
) -> tuple[Array, dict[str, Array]]:
    """Reads a table of numbers, separated by commas or semicolons, as programs write them.

    The first line may name the columns, also after `#`, as written by numpy; without names they are
    `1`, `2`, ... A column `time` has the time of each row. A first column that is the only one
    without a name is an index, as in pandas, and is left out. Empty lines and comments, which begin
    with `#`, are skipped. With semicolons numbers may have decimal commas.

    Args:
        path: the file.
        rate: rows per s, instead of a column `time`, which is then ignored.
        instead: how a rate can be given, for the message about a missing column `time`.

    Returns:
        the times of the rows, s, (n,), non-decreasing; and name to column, (n,). NaN and infinity
        are read as such, and empty cells as NaN.

    Raises:
        CsvError: the file, with line and column, what was found, and what would be right.
        ValueError: a rate that is not above 0.
    """
    if rate is not None and not 0.0 < rate < math.inf:
        raise Problem("rate", found=rate, expected="rows per s, above 0").error()
    path = Path(path)
    try:
        with io.TextIOWrapper(open_file(path), newline="", encoding="utf-8-sig") as file:
            names, numbers = _read_rows(path, _reader(file), timed=rate is None)
    except UnicodeDecodeError as error:
        raise CsvError(path, f"is no text in UTF-8: {error.reason}") from error
    except OSError as error:
        raise CsvError(path, f"cannot be read: {error.strerror}") from error
    columns = dict(zip(names, numbers.T, strict=True))
    times = columns.pop(TIME, None)
    if rate is not None:
        return np.arange(len(numbers)) / rate, columns
    if times is None:
        shown = ", ".join(names[:20])
        reason = f"found the columns {shown}; expected one called {TIME}, in s{instead}"
        raise CsvError(path, reason)
    return times, columns


def _reader(lines: Iterator[str]) -> Reader:
    """Reads cells separated by semicolons if the first non-comment line has any, else by commas."""
    head: list[str] = []
    for line in lines:
        head.append(line)
        if line.strip() and not line.startswith(_COMMENT):
            break
    first = _QUOTED.sub("", head[-1]) if head else ""
    return csv.reader(chain(head, lines), delimiter=";" if ";" in first else ",")


def _read_rows(path: Path, reader: Reader, *, timed: bool) -> tuple[list[str], Array]:
    """Returns the names of the columns, and the numbers, a row for each row."""
    names: list[str] = []
    numbers = array("d")
    earlier = -math.inf
    has_index = False
    number = _number if reader.dialect.delimiter == "," else _number_with_comma
    for line, cells, comment in _filled_rows(path, reader):
        if not names:
            is_header = any(number(cell) is None for cell in cells) or _is_count(cells)
            if is_header:
                names = [cell.strip() for cell in cells]
            elif len(comment) == len(cells):
                names = comment
            else:
                names = [str(i) for i in range(1, len(cells) + 1)]
            has_index = not names[0] and len(names) > 1
            names = names[has_index:]
            _check_names(path, line, names, first=1 + has_index)
            if is_header:
                continue
        if len(cells) != len(names) + has_index:
            wanted = len(names) + has_index
            reason = f"found {len(cells)} values; expected {wanted}, one for each column"
            raise CsvError(path, reason, line=line)
        for name, cell in zip(names, cells[has_index:], strict=True):
            value = number(cell)
            if value is None:
                reason = f"found '{cell.strip()}'; expected a number, or nan"
                raise CsvError(path, reason, line=line, column=name)
            if name == TIME and timed:
                if not (math.isfinite(value) and value >= earlier):
                    after = f" after {earlier!r}" if math.isfinite(earlier) else ""
                    found = f"{cell.strip() or 'nothing'}{after}"
                    reason = f"found {found}; expected s that never decrease"
                    raise CsvError(path, reason, line=line, column=name)
                earlier = value
            numbers.append(value)
    if not numbers:
        raise CsvError(path, "has no row of numbers")
    return names, np.array(numbers).reshape(-1, len(names))


def _filled_rows(path: Path, reader: Reader) -> Iterator[tuple[int, list[str], list[str]]]:
    """Line and cells of every non-empty row, and cells of the comment above the first."""
    comment: list[str] = []
    try:
        for cells in reader:
            if cells and cells[0].startswith(_COMMENT):
                comment = [cell.strip() for cell in (cells[0].lstrip("# "), *cells[1:])]
            elif any(cell.strip() for cell in cells):
                yield reader.line_num, cells, comment
    except csv.Error as error:
        raise CsvError(path, f"is no table: {error}", line=reader.line_num) from error


def _is_count(cells: list[str]) -> bool:
    """Whether a row names columns by numbers after an index, as in pandas."""
    counted = [str(i) for i in range(len(cells) - 1)]
    first, *others = (cell.strip() for cell in cells)
    return bool(others) and not first and others == counted


def _check_names(path: Path, line: int, names: list[str], first: int) -> None:
    """Raises `CsvError` for ambiguous column names; `first` is the number of the first column."""
    for i, name in enumerate(names):
        if not name:
            raise CsvError(path, f"column {i + first} has no name", line=line)
        if name in names[:i]:
            raise CsvError(path, "there are two columns of this name", line=line, column=name)


def _number(cell: str) -> float | None:
    """The number in a cell, NaN if it is empty; None for anything else."""
    try:
        return float(cell) if cell.strip() else math.nan
    except ValueError:
        return None


def _number_with_comma(cell: str) -> float | None:
    return _number(cell.replace(",", "."))
