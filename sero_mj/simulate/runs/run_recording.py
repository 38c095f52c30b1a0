"""Reads a recording as the run of a simulation, or of robots that a scene's routes move."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ...base import paths
from ...base.errors import (
    DeclarationError,
    Problem,
    RecordingError,
    UnknownName,
    UsageError,
    did_you_mean,
    without_warnings,
)
from ...base.frames import Array
from ...base.toml_file import parse_toml
from ...data.drive.wiring import topics_of
from ...data.receive.source import Source
from ...data.record.formats import look_into, open_recording
from ...data.record.recording import PacketFile
from ...data.record.replay import receiver_of
from ...data.record.scene_files import table_names
from ...robots.declared.degrees import degrees_warning
from ...robots.declared.group_model import Expanded, expand_groups
from ...robots.declared.robot import SerialRobot, build_robot
from ...robots.declared.scene import MOST_ENTRIES, Scene
from ...robots.importers.importer import read_robot_file
from .recorded_signals import Series, follow_routes, read_events
from .run_log import MEASURED, TIME, RunLog, event_of, recorded_event

log = logging.getLogger(__name__)

_MODEL_FILES = (paths.ROBOT_FILE, paths.GROUP_FILE)
# Model names of a group's members. In a recording, all models are in adjacent folders.
_MODEL_NAMED = re.compile(r"""(\bmodel\s*=\s*)["']([^"'\n]+)["']""")
_ANGLES, _OLD_ANGLES = "_joint_angles", "_angles"
# Prefixes of `angles` in old events of the same robot.
_DERIVED = ("actual_", "target_")


def read_run(path: Path | str, source: str | None = None, *, scene: Scene | None = None) -> RunLog:
    """Reads a recording of a simulation, or of robots that a scene mirrors.

    A source with the events `time` and `ROBOT_joint_angles` is a logged run. For other sources, the
    scene's routes determine the robot inputs. Time starts with the simulation, or with the first
    packet at which the poses of all robots are known.

    Args:
        source: name of a source (default: all sources).
        scene: scene with the robots and routes (default: the recorded scene).

    Returns:
        run with `joint_angles` and `joint_velocities` (differentiated if they are not recorded). If
            recorded, it also has `torques`, `commanded_torques` and all signals of a simulation.

    Raises:
        RecordingError: the file cannot be read, is not a recording, or has no robot.
        UsageError: there is no such source, or one of several must be selected.
    """
    path = Path(path)
    topics = None
    if scene is not None:
        scene = look_into(path).move_robot(scene, source)
        topics = topics_of(scene)
    with _opened(path, topics) as recording:
        names = _chosen(recording, source)
        if recording.names_joints and scene is not None and not scene.sources:
            names = [recording.choose_source(source or "", by="--source NAME")]
        runs = [name for name in names if _robots_of(recording.sources[name].events)]
        if len(runs) > 1:
            found = ", ".join(runs)
            raise UsageError(
                f"{path} has several runs: {found}; choose one with --source {runs[0]}"
            )
        if runs:
            return _simulated(recording, runs[0], scene)
        declared = _recorded(recording) if scene is None else declared_in(scene)
        robots = declared.robots
        if not robots:
            found = f"found {', '.join(recording.attachments) or 'no files'}"
            if recording.names_joints:
                found = "no robot description, and no included robot has these joints"
            reason = f"has no robot: {found}; pass a scene"
            raise RecordingError(path, reason, needs_scene=True)
        receivers = {name: _receiver_of(recording, name) for name in names}
        return mirrored_run(
            path, receivers, lambda name: read_events(recording, receivers[name], name), declared
        )


@contextmanager
def _opened(path: Path, topics: Mapping[str, Source] | None) -> Iterator[PacketFile]:
    with open_recording(path, topics) as recording:
        try:
            yield recording
        finally:  # a fault may be the reason of an error
            for fault in recording.faults:
                log.warning("%s: %s", path, fault)


def mirrored_run(
    path: Path,
    receivers: Mapping[str, Source],
    read: Callable[[str], Series],
    declared: Declared,
) -> RunLog:
    """Returns the run of robots that routes move. `read` returns the packets of a source."""
    robots = declared.robots
    signals, times = follow_routes(
        path, receivers, read, robots, declared.routes, declared.doubles, declared.groups
    )
    known = {name: robots[name] for name in robots if event_of(name, "joint_angles") in signals}
    run = RunLog(known, with_velocities(known, signals, times), times, path.stem)
    warn_of_degrees(path, run)
    return run


def warn_of_degrees(path: Path, run: RunLog) -> None:
    """Logs a warning for each robot whose joint angles look like degrees."""
    for name, robot in run.robots.items():
        if warning := degrees_warning(robot, run.of(name, "joint_angles")):
            log.warning("%s: %s", path, warning)


def _chosen(recording: PacketFile, source: str | None) -> list[str]:
    names = list(recording.sources)
    if source is not None and source not in names:
        where = f"in {recording.path}"
        raise UsageError(Problem("", "no source", found=source, of=where, available=names))
    if not names:
        raise RecordingError(recording.path, recording.why_no_source())
    return names if source is None else [source]


def _robots_of(events: Iterable[str]) -> list[str]:
    """Returns the names of robots in the events of a logged run, or [] if it is not such a run."""
    events = list(events)
    if TIME not in events:
        return []
    prefixes = [event.removesuffix(_ANGLES) for event in events if event.endswith(_ANGLES)]
    if prefixes:
        return prefixes
    prefixes = [event.removesuffix(_OLD_ANGLES) for event in events if event.endswith(_OLD_ANGLES)]
    return [
        prefix
        for prefix in prefixes
        if not any(
            f"{prefix}_".endswith(f"_{derived}")
            and f"{prefix}_".removesuffix(f"_{derived}") in prefixes
            for derived in _DERIVED
        )
    ]


def _receiver_of(recording: PacketFile, name: str) -> Source:
    receiver = receiver_of(recording.path, recording.sources[name], name)
    receiver.debug_level = 0
    return receiver


def _simulated(recording: PacketFile, name: str, scene: Scene | None) -> RunLog:
    receiver = _receiver_of(recording, name)
    receiver.allow_nan([event for event in receiver.events if event != TIME])
    series = read_events(recording, receiver, name)
    if len(series.times) == 0:
        raise RecordingError(recording.path, f"has no valid packet of '{name}'")
    times = series.events[TIME][:, 0]
    rising = np.append(True, np.diff(np.maximum.accumulate(times)) > 0)
    declared = _recorded(recording).robots if scene is None else scene.robots
    signals = {
        event: values[rising].reshape(-1, *_row_shape(receiver.events[event]))
        for event, values in series.events.items()
    }
    robots = {}
    for prefix in _robots_of(receiver.events):
        for signal in MEASURED:
            event = event_of(prefix, signal)
            if (recorded := recorded_event(event, signals)) in signals:
                signals[event] = signals.pop(recorded)
        count = signals[f"{prefix}{_ANGLES}"].shape[1]
        try:
            chosen = _robot_of(recording.path, prefix, count, declared)
        except UnknownName as error:
            near = did_you_mean(prefix, error.available)
            reason = f"does not describe robot '{prefix}'{near}; pass a scene"
            if scene is not None:
                where = scene.file or f"the scene '{scene.name}'"
                reason = f"has a robot that is not in {where}: {error}"
            raise RecordingError(recording.path, reason, needs_scene=scene is None) from error
        robots[chosen.name] = chosen
    signals = with_velocities(robots, signals, times[rising])
    return RunLog(robots, signals, times[rising], recording.path.stem)


def _row_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    return shape[1:] if len(shape) > 1 and shape[0] == 1 else shape


def _robot_of(
    path: Path, prefix: str, count: int, robots: Mapping[str, SerialRobot]
) -> SerialRobot:
    """Returns the robot whose events have a prefix. Raises UnknownName if there is none."""
    by_event = {event_of(name, "joint_angles").removesuffix(_ANGLES): each
                for name, each in robots.items()}  # fmt: skip
    robot = by_event.get(prefix)
    if robot is None and len(robots) == 1:  # a robot file has no name for its robot
        only = next(iter(robots.values()))
        robot = only.model_copy(update={"name": prefix}) if only.n == count else None
    if robot is None:
        raise UnknownName("robot", prefix, by_event)
    if robot.n != count:
        reason = f"{prefix}{_ANGLES} are {count}; its robot '{robot.name}' has {robot.n} joints"
        raise RecordingError(path, reason)
    return robot


def with_velocities(
    robots: Mapping[str, SerialRobot], signals: Mapping[str, Array], times: Array
) -> dict[str, Array]:
    """Returns the signals with joint velocities, which are differentiated if missing."""
    found = dict(signals)
    rising = np.append(True, np.diff(times) > 0)[: len(times)]  # rows may have equal times
    for name in robots:
        event, angles = event_of(name, "joint_velocities"), event_of(name, "joint_angles")
        if event not in found and angles in found and rising.sum() > 1:
            velocities = np.gradient(found[angles][rising], times[rising], axis=0)
            found[event] = velocities[np.cumsum(rising) - 1]
    return found


@dataclass
class Declared:
    """The robots and routes of a scene.

    Attributes:
        robots: mapping from names to robots, including the robots of groups.
        routes: origins by input.
        doubles: tables of doubles by name.
        groups: tables with the robots of each group, by name.
    """

    robots: dict[str, SerialRobot] = field(default_factory=dict)
    routes: dict[str, Any] = field(default_factory=dict)
    doubles: dict[str, Any] = field(default_factory=dict)
    groups: dict[str, Any] = field(default_factory=dict)


def declared_in(scene: Scene) -> Declared:
    """Returns the robots, routes, doubles and groups of a scene."""
    doubles = {name: {"of": double.of} for name, double in scene.doubles.items()}
    groups = {name: {"robots": group.robots} for name, group in scene.groups.items()}
    return Declared(scene.robots, dict(scene.routes), doubles, groups)


def _recorded(recording: PacketFile) -> Declared:
    """Returns the robots and routes of the recorded scene.

    Without a recorded scene, robots have the names of their folders. If the recorded model is
    installed, its meshes are used. Otherwise link shapes are generated from the table.

    Raises:
        RecordingError: a recorded file is damaged, or its declaration is invalid.
    """
    files = _read_tables(recording)
    models = {name: name.split("/")[-2] for name in files if name.split("/")[-1] in _MODEL_FILES}
    scenes = [tables for name, tables in files.items() if name not in models]
    scenes = [tables for tables in scenes if {"robots", "groups"} & tables.keys()]
    found = Declared()
    for tables in scenes:
        found.routes = found.routes or _table(tables, "routes")
        found.doubles = found.doubles or _table(tables, "doubles")
    ending = f"/{paths.ROBOT_FILE}"
    of_robots = {folder: name for name, folder in models.items() if name.endswith(ending)}
    if not scenes:  # a single robot or group, which is named after its folder
        scenes = [{"robots": {folder: {"model": folder} for folder in of_robots}}]
        whole = next((models[name] for name in models if name not in of_robots.values()), None)
        if whole is not None:
            scenes[0]["groups"] = {whole: {"model": whole}}
    with TemporaryDirectory() as directory:
        for name, folder in models.items():
            text = recording.read_attachment(name).decode("utf-8-sig")
            path = Path(directory) / folder / name.split("/")[-1]
            path.parent.mkdir(exist_ok=True)
            path.write_text(
                _MODEL_NAMED.sub(lambda each: f'{each[1]}"{_folder(each[2])}"', text), "utf-8"
            )
        for tables in scenes:
            expanded = _expanded(recording, _table(tables, "groups"), Path(directory))
            found.groups |= expanded.groups
            for name, table in {**_table(tables, "robots"), **expanded.robots}.items():
                if name not in found.robots:
                    found.robots[name] = _robot(recording, name, dict(table), of_robots)
    return found


def _table(tables: Mapping[str, Any], key: str) -> dict[str, Any]:
    found = tables.get(key)
    return dict(found) if isinstance(found, dict) else {}


def _folder(model: str) -> str:
    """Returns the folder name of a model, or the name of its file if that name is unusual."""
    path = Path(model)
    return path.parent.name if path.name in _MODEL_FILES else path.name


def _expanded(recording: PacketFile, groups: dict[str, Any], directory: Path) -> Expanded:
    scene = directory / "scene.toml"  # does not exist; models are found relative to it
    found = expand_groups(_in_folders(groups), scene, MOST_ENTRIES)
    if found.problems:
        problem = found.problems[0]
        file = str(problem.file).removeprefix(f"{directory}/")
        reason = str(replace(problem, file=None if file == scene.name else file))
        reason = f"its groups are invalid: {reason}; pass a scene"
        raise RecordingError(recording.path, reason, needs_scene=True)
    return found


def _in_folders(tables: Mapping[str, Any]) -> dict[str, Any]:
    found = {
        key: _in_folders(value) if isinstance(value, Mapping) else value
        for key, value in tables.items()
    }
    model = tables.get("model")
    return {**found, "model": _folder(model)} if isinstance(model, str) else found


def _read_tables(recording: PacketFile) -> dict[str, dict[str, Any]]:
    """Returns the tables of recorded scene and robot files by file name. Raises RecordingError."""
    found = {}
    for name in table_names(recording):
        if name.endswith(".toml"):
            try:
                found[name] = parse_toml(recording.read_attachment(name).decode("utf-8-sig"))
            except ValueError as error:
                reason = f"its file '{name}' is not TOML: {error}"
                raise RecordingError(recording.path, reason) from error
        elif name.lower().endswith(paths.scene_endings()):
            with TemporaryDirectory() as directory:
                path = Path(directory) / name.split("/")[-1]
                path.write_bytes(recording.read_attachment(name))
                try:
                    found[name] = read_robot_file(path).tables
                except DeclarationError as error:
                    reason = f"its file '{name}' cannot be read: {error.problems[0].message}"
                    raise RecordingError(recording.path, reason) from error
    return found


def _robot(
    recording: PacketFile, name: str, table: dict[str, Any], models: Mapping[str, str]
) -> SerialRobot:
    model = table.pop("model", None)
    # Children may use files that are not recorded, unless they are shapes or frames of mounts.
    children = table.pop("children", None)
    if isinstance(children, list):
        table["children"] = [c for c in children if isinstance(c, Mapping) and c.get("shape")]
    fields = {**table, "name": name}
    if model is None:
        return _built(recording, name, _without_meshes(fields), None)
    folder = _folder(str(model))
    attached, file = models.get(folder), paths.ROBOT_FILE
    if attached is None:  # a robot file with another name, such as a URDF file
        file = folder
        attached = next((each for each in table_names(recording) if _is_robot(each, folder)), None)
    if attached is None:
        return _built(recording, name, fields, str(model))
    data = recording.read_attachment(attached)
    installed = _installed(str(model) if file == folder else folder)
    if installed is not None and installed.read_bytes() == data:
        return _built(recording, name, fields, str(installed))
    with TemporaryDirectory() as directory:
        path = Path(directory) / Path(folder).stem / file
        path.parent.mkdir()
        path.write_bytes(data)
        with without_warnings():  # for example of meshes, which are not needed
            return _built(recording, name, _without_meshes(fields), str(path))


def _is_robot(attached: str, file: str) -> bool:
    return Path(attached).name == file and file.lower().endswith((".toml", *paths.robot_endings()))


def _built(
    recording: PacketFile, name: str, fields: dict[str, Any], model: str | None
) -> SerialRobot:
    try:
        file = None if model is None else paths.find_model(model)
    except (UnknownName, DeclarationError) as error:
        reason = f"its robot '{name}' is neither recorded nor installed: {error}; pass a scene"
        raise RecordingError(recording.path, reason, needs_scene=True) from error
    try:
        return build_robot(fields, file)
    except DeclarationError as error:
        reason = f"its robot '{name}' is invalid: {error}"
        raise RecordingError(recording.path, reason) from error


def _without_meshes(fields: dict[str, Any]) -> dict[str, Any]:
    return {**fields, "filenames": [], "collisions": None, "mjcf": None, "directory": ""}


def _installed(model: str) -> Path | None:
    try:
        return paths.find_model(model)
    except (UnknownName, DeclarationError):
        return None
