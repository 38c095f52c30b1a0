"""Writes a run as a CSV table (`simulate --csv`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...base.frames import Array
from ...data.record.csv_files import column_names, csv_table
from .run_log import TIME, RunLayout


def write_run_csv(layout: RunLayout, rows: Array, path: Path) -> None:
    """Writes a log as a table with `time` in seconds and `ROBOT_SIGNAL[JOINT]` in SI units.

    Args:
        rows: rows of the log, shape (T, width).

    Raises:
        CsvError: the file cannot be written.
    """
    events = layout.structure.events
    names = column_names({name: tuple(shape) for name, shape in events.items()})
    names[0] = TIME
    with csv_table(path) as table:
        table.writerow(names)
        for part in np.array_split(rows, max(len(rows) // 10_000, 1)):
            table.writerows(part.tolist())
