"""Reads a table as a run: what `simulate --csv` wrote, or a table of somebody else."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from ..errors import CsvError
from ..record.read_csv import read_csv
from ..runs.run_log import RunLog, event_of

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
    found: dict[str, dict[int, NDArray[np.float64]]] = {}
    for name, values in columns.items():
        if (match := _COLUMN.fullmatch(name)) is not None:
            found.setdefault(match[1], {})[int(match[2])] = values
    signals, known = {}, {}
    for robot, declared in robots.items():
        start = event_of(robot, "")
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
