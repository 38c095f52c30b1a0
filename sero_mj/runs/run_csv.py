"""A run as a CSV table: written by `simulate --csv`, read also where others wrote it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..assemble.robot import SerialRobot
from ..errors import CsvError
from ..frames import Array
from ..record.csv_files import column_names, csv_table, read_csv
from .run_log import MEASURED, RunLayout, RunLog, event_of, recorded_event

_COLUMN = re.compile(r"(\w+)\[(\d+)\]")


def read_run_csv(path: Path | str, robots: Mapping[str, SerialRobot]) -> RunLog:
    """Reads a table with a column `time`, s, and `ROBOT_SIGNAL[JOINT]`, as `lwr_torques[0]`.

    Args:
        path: the file.
        robots: by name; a table does not say what they are. Those without a column are left out.

    Returns:
        every signal that has a column for each joint; other columns are left out.

    Raises:
        CsvError: it cannot be read, or has no robot's columns.
    """
    times, columns = read_csv(path)
    found: dict[str, dict[int, Array]] = {}
    for name, values in columns.items():
        if (match := _COLUMN.fullmatch(name)) is not None:
            found.setdefault(match[1], {})[int(match[2])] = values
    signals, known = {}, {}
    for robot, declared in robots.items():
        start = event_of(robot, "")
        for signal in MEASURED:
            event = event_of(robot, signal)
            if (recorded := recorded_event(event, found)) in found:
                found[event] = found.pop(recorded)
        for event, of_joints in found.items():
            if event.startswith(start) and set(of_joints) == set(range(declared.n)):
                signals[event] = np.stack([of_joints[k] for k in range(declared.n)], axis=1)
                known[robot] = declared
    if not known:
        shown = ", ".join([*columns][:6])
        first = next(iter(robots.items()), None)
        start, n = (event_of(first[0], ""), first[1].n) if first else ("ROBOT_", 1)
        expected = f"{start}torques[0] to {start}torques[{n - 1}]"
        raise CsvError(path, f"found the columns {shown}, ...; expected such as {expected}")
    return RunLog(known, signals, times, Path(path).stem)


def write_run_csv(layout: RunLayout, rows: Array, path: Path) -> None:
    """Writes a log as a table: `time`, s, and `ROBOT_SIGNAL[JOINT]`, SI units.

    Args:
        layout: of the rows.
        rows: (T, width), the log.
        path: where to.

    Raises:
        CsvError: the file cannot be written.
    """
    events = layout.structure.events
    names = column_names({name: tuple(shape) for name, shape in events.items()})
    names[0] = "time"
    with csv_table(path) as table:
        table.writerow(names)
        for part in np.array_split(rows, max(len(rows) // 10_000, 1)):
            table.writerows(part.tolist())
