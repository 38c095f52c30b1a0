"""A recording's packets as a table of comma-separated values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .recording import Recording
from .write_csv import csv_table

TIME = "time"


@dataclass(frozen=True)
class Exported:
    """What was written to a table.

    Attributes:
        rows: packets, one row each.
        malformed: packets that are not in it, because they could not be decoded.
    """

    rows: int
    malformed: int


def column_names(events: Mapping[str, tuple[int, ...]]) -> list[str]:
    """Returns a name for every number of a packet: `values0[0]`, `vectors0[0][2]`, ..."""
    return [
        event + "".join(f"[{i}]" for i in index)
        for event, shape in events.items()
        for index in np.ndindex(*shape)
    ]


def export_csv(
    recording: Recording,
    name: str,
    path: Path | str,
    decode: Callable[[bytes], Mapping[str, NDArray[np.float64]] | None],
    *,
    start: float = -math.inf,
    stop: float | None = None,
) -> Exported:
    """Writes a source's good packets into a table, a row each: time, then all of its numbers.

    Numbers have as many digits as it takes to read the same ones again; NaN is `nan`. The file is
    there when all of it is there: a file of this name is replaced then.

    Args:
        recording: where from.
        name: the source.
        path: the file to write.
        decode: a packet to its events; None, or ValueError, for a malformed one.
        start: from when on, s since the recording began.
        stop: until before when, likewise; None to the end.

    Returns:
        How many rows it has, and how many packets it has not.

    Raises:
        CsvError: the file cannot be written.
        RecordingError: the recording cannot be read.
        UnknownName: no such source was recorded.
    """
    packets = recording.packets(name, start, stop)
    events = recording.sources[name].events if name in recording.sources else {}
    counted = {"rows": 0, "malformed": 0}

    def rows() -> Iterator[list[float]]:
        for time, packet in packets:
            try:
                values = decode(packet)
            except ValueError:  # what `Structure.decode` raises for a packet of another size
                values = None
            if values is None:
                counted["malformed"] += 1
                continue
            counted["rows"] += 1
            row = [time]
            for event in events:
                row += values[event].ravel().tolist()
            yield row

    first = next(rows_of := rows(), None)  # what is wrong with the recording comes before a file
    with csv_table(path) as table:
        table.writerow([TIME, *column_names(events)])
        if first is not None:
            table.writerow(first)
        table.writerows(rows_of)
    return Exported(**counted)
