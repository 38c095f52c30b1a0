"""Finds the joints of a scene's robots in a table, and replaces the sources of a scene by it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...base.errors import SeroError, UsageError
from ...base.frames import Array
from ...data.drive.wiring import wired_source
from ...data.record.csv_files import TIME, Columns
from ...robots.declared.inputs import list_inputs
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from .replay import SOURCE, has_numbers
from .signals import signals_of, wrong_columns
from .table import Table, read_cached

_PACKETS = ("structure", "is_double", "column_major", "alignment", "scale")
_BY_OPTION = '--columns "SIGNAL=COLUMNS"'


def robots_in(
    table: Table, robots: Mapping[str, SerialRobot], columns: Columns
) -> dict[str, dict[str, Array]]:
    """Returns the joint signals, shape (T, n), of each robot whose joint angles are in a table.

    Raises CsvError or UsageError.

    Args:
        columns: declared columns as in `signals_of`. Keys are `ROBOT.SIGNAL`, or only the signal if
            there is one robot.
    """
    found = {}
    for name, robot in robots.items():
        counts = (robot.n, robot.coupled.k)
        own = _columns_of(name, robots, columns)
        signals = signals_of(table, robot.names, own, robot=name, counts=counts)
        for signal in own.keys() & signals.keys():
            if (count := signals[signal].shape[1]) not in counts:
                raise UsageError(
                    f"{table.path}: {signal} has {count} columns; expected {robot.n}, one for each "
                    f"joint of {name}"
                )
        if "joint_angles" in signals:
            full = robot.coupled.full
            found[name] = {key: full(key, values) for key, values in signals.items()}
    if not found:
        count = next(iter(robots.values())).n if len(robots) == 1 else 0
        raise wrong_columns(table, count, _BY_OPTION)
    return found


def _columns_of(name: str, robots: Mapping[str, SerialRobot], columns: Columns) -> Columns:
    own = {key: value for key, value in columns.items() if "." not in key and len(robots) == 1}
    for key, value in columns.items():
        robot, dot, signal = key.rpartition(".")
        if dot and robot == name:
            own[signal] = value
    return own


def move_by_table(
    scene: Scene,
    file: Path,
    columns: Columns,
    start: float | None = None,
    source: str | None = None,
) -> None:
    """Replaces sources of a scene by a table; raises CsvError or UsageError.

    If columns have the names of numbers in a source's packets, the table replaces that source.
    Otherwise, it must have joint signals of the robots, which replace all sources.

    Args:
        columns: declared columns; see `robots_in`.
        start: start time relative to the first row, s; None for the first row.
        source: source whose packets can be in the table; None for any source.
    """
    table = read_cached(file, columns)
    declared: dict[str, Any] = {"kind": "table", "file": str(file)}
    if start is not None:
        declared["start"] = start
    for name in [source] if source else scene.sources:
        packets = _packets_in(table, scene, name)
        if packets and not columns.keys() - {TIME}:
            times = {TIME: columns[TIME]} if TIME in columns else {}
            scene.sources[name] = {**declared, **packets, "columns": times}
            return
    moved = robots_in(table, scene.robots, columns)
    removed = tuple(f"{name}." for name in scene.sources)
    inputs = list_inputs(scene)
    routes = {to: of for to, of in scene.routes.items() if not any(n in str(of) for n in removed)}
    scene.sources, scene.robots = {}, dict(scene.robots)
    times = {TIME: columns[TIME]} if TIME in columns else {}
    for name, signals in moved.items():
        table_name = SOURCE if len(moved) == 1 else f"{SOURCE}_{name.replace('-', '_')}"
        own = {**_columns_of(name, scene.robots, columns), **times}
        scene.sources[table_name] = {**declared, "robot": name, "columns": own}
        for signal in signals:
            if f"{name}.{signal}" in inputs:
                routes[f"{name}.{signal}"] = f"{table_name}.{signal}"
        for double, of in scene.doubles.items():
            if of.of == name and of.path is None and "commanded_angles" in signals:
                routes[f"{double}.joint_angles"] = f"{table_name}.commanded_angles"
        shown: dict[str, Any] = {"joint_angles": signals["joint_angles"][0]}
        if "torques" in signals and "show_arrows" not in scene.robots[name].model_fields_set:
            shown["show_arrows"] = True
        scene.robots[name] = scene.robots[name].model_copy(update=shown)
    scene.routes = routes


def _packets_in(table: Table, scene: Scene, name: str) -> dict[str, Any]:
    events: Mapping[str, tuple[int, ...]] = {}
    with suppress(SeroError):  # invalid declarations are reported elsewhere
        source = wired_source(scene, name, scene.sources[name])
        events = source.events
    if not has_numbers(table, events):
        return {}
    if source.structure:
        return {key: getattr(source, key) for key in _PACKETS}
    letters = {1: "d", 2: "Vd", 3: "Md"}
    items = [
        f"{event}:{shape[0]}{letters[len(shape)]}"
        for event, shape in events.items()
        if has_numbers(table, {event: shape})
    ]
    return {"structure": " ".join(items)}
