"""A recording as a run: of a simulation, or of a robot that a scene's routes lead to."""

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
# What a group's file says of its members' models; in a recording all models are beside each other.
_MODEL_NAMED = re.compile(r"""(\bmodel\s*=\s*)["']([^"'\n]+)["']""")
_ANGLES, _OLD_ANGLES = "_joint_angles", "_angles"
# Before `angles`, in old events of a robot that has others as well.
_DERIVED = ("actual_", "target_")


def read_run(path: Path | str, source: str | None = None, *, scene: Scene | None = None) -> RunLog:
    """Reads a recording of a simulation, or of robots that a scene mirrors.

    A source with the events `time` and `ROBOT_joint_angles` is a run as it was logged. Of others
    the scene in the recording says what leads to which robot, in which unit. Time counts from the
    start of the simulation, or from the first packet that tells where the robots are.

    Args:
        source: which of its sources; all that matter when None.
        scene: the robots and the routes; those in the recording when None.

    Returns:
        The signals `joint_angles`, `joint_velocities` (by differences where they were not sent)
        and, where there are such, `torques`, `commanded_torques`, and all others of a simulation.

    Raises:
        RecordingError: it cannot be read, is no recording, or has no robot.
        UsageError: no such source, or there are several and one has to be chosen.
    """
    path = Path(path)
    topics = None
    if scene is not None:
        scene = look_into(path).lead(scene, source)
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
                found = "it describes none, and no shipped one has its joints"
            reason = f"has no robot in it: {found}; expected a scene, give one"
            raise RecordingError(path, reason)
        receivers = {name: _receiver_of(recording, name) for name in names}
        return mirrored_run(
            path, receivers, lambda name: read_events(recording, receivers[name], name), declared
        )


@contextmanager
def _opened(path: Path, topics: Mapping[str, Source] | None) -> Iterator[PacketFile]:
    with open_recording(path, topics) as recording:
        try:
            yield recording
        finally:  # it may be why the recording cannot be used
            for fault in recording.faults:
                log.warning("%s: %s", path, fault)


def mirrored_run(
    path: Path,
    receivers: Mapping[str, Source],
    read: Callable[[str], Series],
    declared: Declared,
) -> RunLog:
    """Returns the run of robots that routes move; `read` reads the packets of a source."""
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
    """Robots, as events call them, of a run that was logged; none when it is no such run."""
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
        raise RecordingError(recording.path, f"has no good packet of '{name}'")
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
            chosen = _meant(recording.path, prefix, count, declared)
        except UnknownName as error:
            near = did_you_mean(prefix, error.available)
            reason = f"does not say what robot '{prefix}' is{near}; give a scene"
            if scene is not None:
                given = scene.file or f"the scene '{scene.name}'"
                reason = f"is of another robot than {given} has: {error}"
            raise RecordingError(recording.path, reason) from error
        robots[chosen.name] = chosen
    signals = with_velocities(robots, signals, times[rising])
    return RunLog(robots, signals, times[rising], recording.path.stem)


def _row_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    return shape[1:] if len(shape) > 1 and shape[0] == 1 else shape


def _meant(path: Path, prefix: str, count: int, robots: Mapping[str, SerialRobot]) -> SerialRobot:
    """The robot that events mean; raises UnknownName where it is none of these."""
    by_event = {event_of(name, "joint_angles").removesuffix(_ANGLES): each
                for name, each in robots.items()}  # fmt: skip
    robot = by_event.get(prefix)
    if robot is None and len(robots) == 1:  # its file alone does not tell how it was called
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
    """Returns the signals with joint velocities, by differences if they are missing."""
    found = dict(signals)
    rising = np.append(True, np.diff(times) > 0)[: len(times)]  # several rows may have one time
    for name in robots:
        event, angles = event_of(name, "joint_velocities"), event_of(name, "joint_angles")
        if event not in found and angles in found and rising.sum() > 1:
            velocities = np.gradient(found[angles][rising], times[rising], axis=0)
            found[event] = velocities[np.cumsum(rising) - 1]
    return found


@dataclass
class Declared:
    """What a scene says of its robots, in a recording or elsewhere.

    Attributes:
        robots: by name, those of groups included.
        routes: input to origin.
        doubles: tables by name.
        groups: tables by name, each with its robots.
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
    """Robots by their names in the recorded scene, else by those of their folders; its routes.

    A robot that is installed here as it was recorded has its meshes; of another one the links grow
    from its table.

    Raises:
        RecordingError: a file in it is damaged, or declares a robot or a group wrongly.
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
    if not scenes:  # a robot or a group by itself, which is called as its folder is
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
    """The folder of a model that is named, by itself: all models of a recording are beside it.

    Of a file that is not called as those in folders of models are, it is the file's own name.
    """
    path = Path(model)
    return path.parent.name if path.name in _MODEL_FILES else path.name


def _expanded(recording: PacketFile, groups: dict[str, Any], directory: Path) -> Expanded:
    scene = directory / "scene.toml"  # which is not there: models are found beside it
    found = expand_groups(_in_folders(groups), scene, MOST_ENTRIES)
    if found.problems:
        problem = found.problems[0]
        file = str(problem.file).removeprefix(f"{directory}/")
        reason = str(replace(problem, file=None if file == scene.name else file))
        raise RecordingError(recording.path, f"its groups cannot be read: {reason}; give a scene")
    return found


def _in_folders(tables: Mapping[str, Any]) -> dict[str, Any]:
    found = {
        key: _in_folders(value) if isinstance(value, Mapping) else value
        for key, value in tables.items()
    }
    model = tables.get("model")
    return {**found, "model": _folder(model)} if isinstance(model, str) else found


def _read_tables(recording: PacketFile) -> dict[str, dict[str, Any]]:
    """Tables of every scene and robot file in a recording, by its name there.

    Raises:
        RecordingError: one is damaged or cannot be read.
    """
    found = {}
    for name in table_names(recording):
        if name.endswith(".toml"):
            try:
                found[name] = parse_toml(recording.read_attachment(name).decode("utf-8-sig"))
            except ValueError as error:
                reason = f"file '{name}' in it is no TOML: {error}"
                raise RecordingError(recording.path, reason) from error
        elif name.lower().endswith(paths.scene_endings()):
            with TemporaryDirectory() as directory:
                path = Path(directory) / name.split("/")[-1]
                path.write_bytes(recording.read_attachment(name))
                try:
                    found[name] = read_robot_file(path).tables
                except DeclarationError as error:
                    reason = f"file '{name}' in it cannot be read: {error.problems[0].message}"
                    raise RecordingError(recording.path, reason) from error
    return found


def _robot(
    recording: PacketFile, name: str, table: dict[str, Any], models: Mapping[str, str]
) -> SerialRobot:
    model = table.pop("model", None)
    # What is fixed to the flange may be in files that are not there; frames for mounts are not.
    children = table.pop("children", None)
    if isinstance(children, list):
        table["children"] = [c for c in children if isinstance(c, Mapping) and c.get("shape")]
    fields = {**table, "name": name}
    if model is None:
        return _built(recording, name, _without_meshes(fields), None)
    folder = _folder(str(model))
    attached, file = models.get(folder), paths.ROBOT_FILE
    if attached is None:  # of a robot in a file of another name, as those in URDF are
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
        with without_warnings():  # of meshes, say, which nothing here needs
            return _built(recording, name, _without_meshes(fields), str(path))


def _is_robot(attached: str, file: str) -> bool:
    return Path(attached).name == file and file.lower().endswith((".toml", *paths.robot_endings()))


def _built(
    recording: PacketFile, name: str, fields: dict[str, Any], model: str | None
) -> SerialRobot:
    try:
        file = None if model is None else paths.find_model(model)
    except (UnknownName, DeclarationError) as error:
        reason = f"its robot '{name}' is not in it, nor installed: {error}; give a scene"
        raise RecordingError(recording.path, reason) from error
    try:
        return build_robot(fields, file)
    except DeclarationError as error:
        reason = f"its robot '{name}' is declared wrongly: {error}"
        raise RecordingError(recording.path, reason) from error


def _without_meshes(fields: dict[str, Any]) -> dict[str, Any]:
    return {**fields, "filenames": [], "collisions": None, "mjcf": None, "directory": ""}


def _installed(model: str) -> Path | None:
    try:
        return paths.find_model(model)
    except (UnknownName, DeclarationError):
        return None
