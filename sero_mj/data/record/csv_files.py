"""Names of columns in tables of numbers, and writing CSV tables."""

from __future__ import annotations

import contextlib
import csv
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...base.errors import CsvError, SeroError

if TYPE_CHECKING:
    from _csv import Writer

    from .recording import PacketFile

# Events with one number per joint, whose columns can be named after the joints.
JOINT_EVENTS = ("joint_angles", "joint_velocities", "torques", "commanded_torques")
TIME = "time"
TABLE_ENDINGS = (".csv", ".tsv", ".txt")
# Mapping from signals to table columns: a column name, a pattern with `*`, or a list of names.
Columns = Mapping[str, str | Sequence[str]]


def is_table(path: Path | str) -> bool:
    """Returns whether a file name has the extension of a table."""
    return str(path).lower().endswith(TABLE_ENDINGS)


def parse_columns(texts: Sequence[str]) -> dict[str, str | list[str]]:
    """Parses values of `--columns`, such as `joint_angles=q_*`; raises ValueError."""
    found: dict[str, str | list[str]] = {}
    for text in texts:
        signal, equals, columns = text.partition("=")
        if not (equals and signal.strip() and columns.strip()):
            expected = "SIGNAL=COLUMNS, for example joint_angles=q_* or time=stamp"
            raise ValueError(f"found '{text}'; expected {expected}")
        names = [each.strip() for each in columns.split(",")]
        found[signal.strip()] = names[0] if len(names) == 1 else names
    return found


@contextlib.contextmanager
def csv_table(path: Path | str, failed: str = "cannot be written") -> Iterator[Writer]:
    """Context manager that yields a CSV writer of a temporary file, which finally replaces `path`.

    Pipes are written directly. Raises CsvError if the file cannot be written.
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
        # Errors from reading the rows may be both an OSError and a SeroError.
        if isinstance(error, OSError) and not isinstance(error, SeroError):
            raise CsvError(path, f"{failed}: {error.strerror}") from error
        raise


@dataclass
class Exported:
    """Numbers of written rows and of malformed packets, which were skipped."""

    rows: int = 0
    malformed: int = 0


def column_names(events: Mapping[str, tuple[int, ...]], joints: Sequence[str] = ()) -> list[str]:
    """Returns a name for each number of a packet, such as `values0[0]` or `vectors0[0][2]`.

    Args:
        joints: joint names that replace indices in `JOINT_EVENTS`, for example `torques[elbow]`.
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
    """Writes the time and all numbers of each valid packet of a source to a row of a table.

    Numbers have enough digits to be read back exactly; NaN is `nan`. A file is replaced only when
    the table is complete. Raises CsvError, RecordingError or UnknownName.

    Args:
        decode: function that decodes a packet. For a malformed packet, it returns None or raises
            ValueError.
        joints: joint names in the order of the packets, for recordings of messages.
        ordered: joint names in the order of the columns (default: the order of the packets).
        start: minimum time of packets in seconds since the start of the recording.
        stop: time in seconds at which the table ends; None for the end of the recording.
    """
    packets = recording.packets(name, start, stop)
    events = recording.sources[name].events if name in recording.sources else {}
    written = Exported()
    order = [joints.index(name) for name in ordered] or slice(None)

    def rows() -> Iterator[list[float]]:
        for time, packet in packets:
            try:
                values = decode(packet)
            except ValueError:  # from `Structure.decode`, for a packet of another size
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

    first = next(rows_of := rows(), None)  # errors of the recording are raised before writing
    with csv_table(path) as table:
        table.writerow([TIME, *column_names(events, ordered or joints)])
        if first is not None:
            table.writerow(first)
        table.writerows(rows_of)
    return written


def prefix_before(wanted: Sequence[str], names: Sequence[str]) -> str:
    """Returns the prefix with which `names` contains all wanted joint names, or "".

    If a wanted name occurs without a prefix, the result is "".
    """
    known = set(names)
    if not wanted or not known.isdisjoint(wanted):
        return ""
    before = [name.removesuffix(wanted[0]) for name in names if name.endswith(wanted[0])]
    found = [text for text in before if known.issuperset(text + name for name in wanted)]
    return found[0] if len(found) == 1 else ""
