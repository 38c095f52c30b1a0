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
_SHOWN = 4  # columns in an error
_LOGGED = {"commanded_angles": "target_angles"}  # signals that have another name in runs


def read_run_table(
    path: Path | str,
    scene: Scene,
    source: str | None = None,
    columns: Columns = MappingProxyType({}),
) -> RunLog:
    """Reads a table of a simulation (`simulate --csv`), of packets (`export`), or of joints.

    Args:
        scene: the robots, and the routes that lead from packets to them: a table says neither.
        source: in the scene, whose packets they are; the only one with such columns when None.
        columns: which columns are which signals of the robots; see `robots_in`. Times then count
            from the first row.

    Returns:
        as of `read_run`.

    Raises:
        CsvError: it cannot be read, or its columns are neither.
        UsageError: no such source, or there are several and one has to be chosen.
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
        raise UsageError(f"{path} may be of {found}; choose one with --source {first}")
    if not possible:
        return _run_of_joints(table, scene, columns, _expected_columns(table, scene, wanted))
    ((name, events),) = possible.items()
    series = series_of(wanted[name], events, table.times)
    try:
        return mirrored_run(path, {name: wanted[name]}, lambda _: series, declared_in(scene))
    except RecordingError as error:
        raise CsvError(path, error.reason) from None


def _run_of_joints(table: Table, scene: Scene, columns: Columns, expected: str) -> RunLog:
    """The run in a table of joints; `expected` is what else would be missing, if anything."""
    try:
        led = robots_in(table, scene.robots, columns)
    except CsvError as error:
        if columns or not expected:
            raise
        raise CsvError(table.path, f"{expected}; {error.reason}") from None
    is_declared = any(key.rpartition(".")[2].startswith("torques") for key in columns)
    for each in led.values():  # commanded torques, which are shown like measured ones, are none
        torques, commanded = each.get("torques"), each.get("commanded_torques")
        if commanded is None or torques is None or is_declared:
            continue
        if np.array_equal(torques, commanded, equal_nan=True):
            del each["torques"]
    robots = {name: scene.robots[name] for name in led}
    signals = {event_of(name, _LOGGED.get(signal, signal)): values
               for name, each in led.items() for signal, values in each.items()}  # fmt: skip
    times = table.times - table.times[0]
    run = RunLog(robots, with_velocities(robots, signals, times), times, table.path.stem)
    warn_of_degrees(table.path, run)
    return run


def _expected_columns(table: Table, scene: Scene, sources: Mapping[str, Source]) -> str:
    """Which columns of a source's packets are missing; empty where no source was meant."""
    for name, source in sources.items():
        names = column_names(source.events)
        missing = [each for each in names if each not in table.columns]
        if len(missing) < len(names) / 2:
            more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
            return f"has no column {', '.join(missing[:_SHOWN])}{more}, of source '{name}'"
    return ""


def run_of_columns(
    path: Path, times: Array, columns: Mapping[str, Array], robots: Mapping[str, SerialRobot]
) -> RunLog | None:
    """The run in a table with `ROBOT_SIGNAL[JOINT]`, as `lwr_torques[0]`; None where there is none.

    A joint is a number, counted from 0, or its name. Signals of a table with the names of joints,
    as `export` writes it of messages of ROS, need no robot before them: `torques[elbow]`.

    Args:
        times: (T,), s; those of the simulation, `time[0]`, count where a recording of one was
            exported.
        columns: name to values, (T,).
        robots: by name; a table does not say what they are. Those without a column are left out.

    Returns:
        every signal that has a column for each joint; other columns are left out.
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
    """Returns the labels of a robot's joints, n, among those of an event; empty without them all.

    Args:
        labels: in brackets, names or numbers.
        numbered: whether they may be numbers.
    """
    prefix = prefix_before(robot.names, [*labels])
    named, numbers = [prefix + name for name in robot.names], [*map(str, range(robot.n))]
    if set(labels).issuperset(named):
        return named
    return numbers if numbered and set(labels) == set(numbers) else []


def columns_of_events(
    columns: Mapping[str, Array], events: Mapping[str, tuple[int, ...]]
) -> dict[str, Array]:
    """A source's events in a table, (T, count) each; nothing where one has no columns."""
    names = {event: column_names({event: shape}) for event, shape in events.items()}
    if not all(name in columns for each in names.values() for name in each):
        return {}
    return {event: np.stack([columns[name] for name in each], axis=1)
            for event, each in names.items()}  # fmt: skip
