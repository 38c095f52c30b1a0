"""Reads a table as a run, for `compare`, `plot` and `identify`."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ...base.errors import CsvError, Problem, RecordingError, UsageError
from ...base.frames import Array
from ...data.drive.wiring import wired_source
from ...data.receive.source import Source
from ...data.record.csv_files import Columns, column_names, prefix_before
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from ...simulate.runs.recorded_signals import series_of
from ...simulate.runs.run_log import MEASURED, TIME, RunLog, event_of, recorded_event
from ...simulate.runs.run_recording import (
    declared_in,
    mirrored_run,
    warn_of_degrees,
    with_velocities,
)
from .joints import robots_in
from .table import Table, read_cached

_COLUMN = re.compile(r"(\w+)\[(.+)\]")
_SHOWN = 4  # maximum number of columns in an error
_LOGGED = {"commanded_angles": "target_angles"}  # names of signals in runs, if they differ


def read_run_table(
    path: Path | str,
    scene: Scene,
    source: str | None = None,
    columns: Columns = MappingProxyType({}),
) -> RunLog:
    """Reads a table of a simulation (`simulate --csv`), of packets (`export`), or of joint signals.

    Returns the same as `read_run`; raises CsvError or UsageError.

    Args:
        scene: scene with the robots, and with routes from packets to them.
        source: source in the scene whose packets are in the table; None for the only source with
            such columns.
        columns: declared columns of joint signals; see `robots_in`. If columns are declared, times
            are relative to the first row.
    """
    path = Path(path)
    if source is not None and source not in scene.sources:
        where, known = "in the scene", scene.sources
        raise UsageError(Problem("", "no source", found=source, of=where, available=known))
    table = read_cached(path, columns)
    numbers = {name: table.columns[name] for name in table.columns if name not in table.wrong}
    run = None if columns else run_of_columns(path, table.times, numbers, scene.robots)
    if run is not None:
        warn_of_degrees(path, run)
        return replace(run, signals=with_velocities(run.robots, run.signals, run.times))
    names = scene.sources if source is None else [source]
    wanted = {name: wired_source(scene, name, scene.sources[name]) for name in names}
    sent = {name: columns_of_events(numbers, each.events) for name, each in wanted.items()}
    sent = {} if columns else sent
    possible = {name: events for name, events in sent.items() if events}
    if len(possible) > 1:
        first, *_ = possible
        found = ", ".join(possible)
        raise UsageError(f"{path} fits the sources {found}. Choose one with --source {first}")
    if not possible:
        return _run_of_joints(table, scene, columns, _expected_columns(table, scene, wanted))
    ((name, events),) = possible.items()
    series = series_of(wanted[name], events, table.times)
    try:
        return mirrored_run(path, {name: wanted[name]}, lambda _: series, declared_in(scene))
    except RecordingError as error:
        raise CsvError(path, error.reason) from None


def _run_of_joints(table: Table, scene: Scene, columns: Columns, expected: str) -> RunLog:
    try:
        moved = robots_in(table, scene.robots, columns)
    except CsvError as error:
        if columns or not expected:
            raise
        raise CsvError(table.path, f"{expected}; {error.reason}") from None
    is_declared = any(key.rpartition(".")[2].startswith("torques") for key in columns)
    # `signals_of` returns commanded torques also as `torques`; a run must not have these.
    for each in moved.values():
        torques, commanded = each.get("torques"), each.get("commanded_torques")
        if commanded is None or torques is None or is_declared:
            continue
        if np.array_equal(torques, commanded, equal_nan=True):
            del each["torques"]
    robots = {name: scene.robots[name] for name in moved}
    signals = {event_of(name, _LOGGED.get(signal, signal)): values
               for name, each in moved.items() for signal, values in each.items()}  # fmt: skip
    times = table.times - table.times[0]
    run = RunLog(robots, with_velocities(robots, signals, times), times, table.path.stem)
    warn_of_degrees(table.path, run)
    return run


def _expected_columns(table: Table, scene: Scene, sources: Mapping[str, Source]) -> str:
    # Returns the missing columns of a source of which more than half of the columns exist.
    for name, source in sources.items():
        names = column_names(source.events)
        missing = [each for each in names if each not in table.columns]
        if len(missing) < len(names) / 2:
            more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
            return f"has no columns {', '.join(missing[:_SHOWN])}{more} of source '{name}'"
    return ""


def run_of_columns(
    path: Path, times: Array, columns: Mapping[str, Array], robots: Mapping[str, SerialRobot]
) -> RunLog | None:
    """Returns the run in columns such as `lwr_torques[0]`; None if there are no such columns.

    Brackets contain the name of a joint, or its number from 0. Columns with joint names need no
    robot name (`torques[elbow]`). `export` writes such tables for ROS messages.

    Args:
        times: times of the rows, shape (T,), s. The column `time[0]`, the simulation time in
            exported recordings of simulations, takes precedence.
        columns: values of columns by name, shape (T,).
        robots: robots by name.

    Returns:
        A run with the signals that have a column for each joint, and the robots with such signals.
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
    # Returns the labels of all joints of a robot, in order, or [] if a label is missing.
    prefix = prefix_before(robot.names, [*labels])
    named, numbers = [prefix + name for name in robot.names], [*map(str, range(robot.n))]
    if set(labels).issuperset(named):
        return named
    return numbers if numbered and set(labels) == set(numbers) else []


def columns_of_events(
    columns: Mapping[str, Array], events: Mapping[str, tuple[int, ...]]
) -> dict[str, Array]:
    """Returns the events of a source in a table, shape (T, count), or {} if a column is missing."""
    names = {event: column_names({event: shape}) for event, shape in events.items()}
    if not all(name in columns for each in names.values() for name in each):
        return {}
    return {event: np.stack([columns[name] for name in each], axis=1)
            for event, each in names.items()}  # fmt: skip
