"""Runs as CSV tables, written by `simulate --csv` and by other programs."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from ...base.frames import Array
from ...data.record.csv_files import column_names, csv_table, prefix_before
from ...robots.declared.robot import SerialRobot
from .run_log import MEASURED, TIME, RunLayout, RunLog, event_of, recorded_event

_COLUMN = re.compile(r"(\w+)\[(.+)\]")


def run_of_columns(
    path: Path, times: Array, columns: Mapping[str, Array], robots: Mapping[str, SerialRobot]
) -> RunLog | None:
    """Returns the run in a table with columns `ROBOT_SIGNAL[JOINT]`, or None if there is no run.

    JOINT is an index from 0 or a joint's name, as in `lwr_torques[0]`. With names, as in exported
    ROS messages, ROBOT may be missing: `torques[elbow]`.

    Args:
        times: shape (T,), s. A column `time[0]`, the simulated time, has priority.
        columns: name to values, shape (T,).
        robots: by name. Robots without columns are left out.

    Returns:
        all signals that have a column for each joint.
    """
    found: dict[str, dict[str, Array]] = {}
    for name, values in columns.items():
        if (match := _COLUMN.fullmatch(name)) is not None:
            found.setdefault(match[1], {})[match[2]] = values
    times = found.pop(TIME, {"0": times})["0"]
    signals, known = {}, {}
    for robot, declared in robots.items():
        start = event_of(robot, "")
        for signal in MEASURED:
            event = event_of(robot, signal)
            if (recorded := recorded_event(event, found)) in found:
                found[event] = found.pop(recorded)
        for event, of_joints in found.items():
            own = event.startswith(start)
            labels = _labels(declared, of_joints, numbered=own)
            if labels and (own or event in MEASURED):
                signals[event if own else start + event] = np.stack(
                    [of_joints[label] for label in labels], axis=1
                )
                known[robot] = declared
    rising = np.append(True, np.diff(np.maximum.accumulate(times)) > 0)
    signals = {event: values[rising] for event, values in signals.items()}
    return RunLog(known, signals, times[rising], path.stem) if known else None


def _labels(robot: SerialRobot, labels: Collection[str], *, numbered: bool) -> list[str]:
    """Returns the labels of a robot's joints among the names or numbers in brackets, or []."""
    prefix = prefix_before(robot.names, [*labels])
    named, numbers = [prefix + name for name in robot.names], [*map(str, range(robot.n))]
    if set(labels).issuperset(named):
        return named
    return numbers if numbered and set(labels) == set(numbers) else []


def columns_of_events(
    columns: Mapping[str, Array], events: Mapping[str, tuple[int, ...]]
) -> dict[str, Array]:
    """Returns the events of a source in a table, (T, count) each; empty if a column is missing."""
    names = {event: column_names({event: shape}) for event, shape in events.items()}
    if not all(name in columns for each in names.values() for name in each):
        return {}
    return {event: np.stack([columns[name] for name in each], axis=1)
            for event, each in names.items()}  # fmt: skip


def write_run_csv(layout: RunLayout, rows: Array, path: Path) -> None:
    """Writes a log as a table with `time` in seconds and `ROBOT_SIGNAL[JOINT]` in SI units.

    Args:
        rows: the log, shape (T, width).

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
