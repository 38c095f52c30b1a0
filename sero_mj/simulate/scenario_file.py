"""Reads scenario files, and the recorded motions that they use as targets."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.declaration import file_fields
from ..base.dotted_keys import lacking, no_table, parts_of, with_value
from ..base.errors import (
    DeclarationError,
    Problem,
    SeroError,
    UnknownName,
    UsageError,
    did_you_mean,
    problems_of,
)
from ..base.frames import Array
from ..base.paths import find_scenario, find_scene
from ..base.toml_file import located, read_toml
from ..base.trust import FileOrigin, is_allowed
from ..data.record.csv_files import is_table
from ..robots.declared.robot import SerialRobot
from ..robots.declared.scene import Scene
from ..robots.declared.scene_file import read_scene_file, scene_from_tables
from ..robots.importers.importer import is_robot_file
from .control.make_controller import controller_kinds
from .runs.monitor import Monitor
from .runs.run_recording import read_run
from .runs.tables import find_tables
from .scenario import Run, Scenario, build_entry
from .sections import OTHERS, SECTIONS

# Time between two rows in seconds. With more rows, encoder noise would dominate the accelerations.
_EVERY = 0.02


def read_scenario(
    path: Path | str, overrides: Mapping[str, Any] | None = None, *, trusted: bool = True
) -> Scenario:
    """Reads and checks a scenario without running it.

    A scenario that `extends` another one consists of that scenario, the overrides in its table
    `set` and the entries of its own sections.

    Args:
        path: TOML file, or name of an included scenario.
        overrides: values that override the file, by dotted key, for example
            `controllers.lwr.stiffness`, `run.duration` or `lwr.show_axes`.
        trusted: whether a simulation may run the programs and load the libraries of the scenario.
            Pass False for a file that the user has not chosen to simulate; `base.trust` then
            decides.

    Raises:
        DeclarationError: the file is invalid. The error contains all problems.
        UnknownName: there is no such scenario.
        UsageError: the file is a robot.
    """
    if os.path.isfile(path) and is_robot_file(Path(path)):
        hint = f"Use sero-mj view {path} --simulate to simulate the robot alone"
        raise UsageError(f"{path} is a robot; expected a scenario. {hint}")
    file = find_scenario(str(path))
    scenario = _read(file, dict(overrides or {}), ())
    if trusted:  # `request` would read all files, and sweeps read many variants
        scenario.set_origin(FileOrigin(file, is_trusted=True))
    elif (request := scenario.request()) is not None:
        scenario.set_origin(FileOrigin(file, is_allowed(request)))
    return scenario


def _read(file: Path, overrides: dict[str, Any], extending: tuple[Path, ...]) -> Scenario:
    tables = read_toml(file)
    try:
        if "extends" in tables:
            return _read_extended(file, tables, overrides, (*extending, file.resolve()))
        return _read_whole(file, tables, overrides)
    except DeclarationError as error:
        raise DeclarationError(located(error.problems, file)) from None


def _read_whole(file: Path, tables: dict[str, Any], overrides: dict[str, Any]) -> Scenario:
    whole = dict(tables)
    own = {key: tables.pop(key) for key in (*SECTIONS, *OTHERS) if key in tables}
    of_scene: dict[str, Any] = {}
    of_own: dict[str, Any] = {}
    for key, value in overrides.items():
        if key in ("scene", "description"):
            own[key] = value
        else:
            is_own = key.partition(".")[0] in (*SECTIONS, "run")
            (of_own if is_own else of_scene)[key] = value
    message = "requires `extends`; without it, edit the tables directly"
    problems = [Problem("set", message)] if "set" in own else []
    scene = None
    try:
        if "scene" in own:
            scene, found = _other_scene(file.parent, own["scene"], tables, of_scene)
        else:
            known = {*SECTIONS, *OTHERS} - {"description"}  # scenes have a description as well
            scene, found = scene_from_tables(file, tables, of_scene, known=known)
        problems += found
    except DeclarationError as error:
        problems += error.problems
    if scene is None or (problems and "robots" in " ".join(scene.broken)):
        # References to invalid robots are not reported, but errors in overrides are.
        if of_scene and of_own:
            problems += _problems_without(file, whole, of_own)
        raise DeclarationError(problems)
    problems += _set_all(own, of_own, scene, file)
    scene.description = str(own.get("description", scene.description))
    problems += _read_motions(own, scene, file.parent)
    _place_files(own, file.parent)
    run = own.get("run", {})
    for key, kind, expected in (("run", dict, "a table [run]"), ("description", str, "a text")):
        if key in own and not isinstance(own[key], kind):
            problems.append(Problem(key, found=own[key], expected=expected))
    try:
        scenario = Scenario(
            scene,
            **{key: own[key] for key in SECTIONS if key in own},
            name=file.stem,
            description=str(own.get("description", "")),
            **(run if isinstance(run, dict) else {}),
        )
    except DeclarationError as error:
        problems += error.problems
    if problems:
        raise DeclarationError(problems)
    scenario.file, scenario.settings = file, overrides
    scenario.tables = (file,)
    scenario.set_origin(FileOrigin(file))  # not trusted, unless the caller decides so
    return scenario


def _problems_without(
    file: Path, tables: dict[str, Any], settings: dict[str, Any]
) -> list[Problem]:
    try:
        _read_whole(file, tables, settings)
    except DeclarationError as error:
        return [problem for problem in error.problems
                if any(_is_part(problem.key, key) for key in settings)]  # fmt: skip
    return []


def _is_part(key: str, of: str) -> bool:
    return any(a == b or a.startswith((f"{b}.", f"{b}[")) for a, b in ((key, of), (of, key)))


def _read_extended(
    file: Path, tables: dict[str, Any], overrides: dict[str, Any], extending: tuple[Path, ...]
) -> Scenario:
    base, settings = tables.pop("extends"), tables.pop("set", {})
    problems: list[Problem] = []
    if not isinstance(settings, dict):
        problems.append(
            Problem("set", found=settings, expected='a table, for example "run.duration" = 8')
        )
        settings = {}
    for section, entries in tables.items():
        if section == "description":
            settings[section] = entries
        elif section not in (*SECTIONS, "run"):
            message = f"can only be changed in [set] of a scenario that extends {base}"
            problems.append(Problem(section, message))
        elif not isinstance(entries, dict):
            problems.append(Problem(section, found=entries, expected=f"a table [{section}]"))
        else:
            settings |= {f"{section}.{name}": entry for name, entry in entries.items()}
    try:
        found = _extended(file, base, extending)
        if not problems:
            scenario = _read(found, {**settings, **overrides}, extending)
    except DeclarationError as error:
        problems += _as_set_in(error.problems, settings)
    if problems:
        raise DeclarationError(problems)
    scenario.file, scenario.name, scenario.settings = file, file.stem, overrides
    scenario.tables = (file, *scenario.tables)
    return scenario


def _extended(file: Path, base: Any, extending: tuple[Path, ...]) -> Path:
    if not isinstance(base, str):
        raise _wrong("extends", f"found {base!r}; expected the name or file of a scenario")
    beside = file.parent / base
    try:
        path = beside if beside.is_file() else find_scenario(base)
    except UnknownName as error:
        raise _wrong("extends", str(error)) from None
    if path.resolve() in extending:
        raise _wrong("extends", f"`extends` is circular: {base} extends this file")
    return path


def _as_set_in(problems: list[Problem], settings: Mapping[str, Any]) -> list[Problem]:
    return [
        replace(problem, file=None, line=None)
        if any(f"{problem.key}.".startswith(f"{key}.") for key in settings)
        else problem
        for problem in problems
    ]


def _read_motions(own: dict[str, Any], scene: Scene, beside: Path) -> list[Problem]:
    """Reads the motions that targets load from files.

    A robot without a declared pose starts in the first pose of its motion.
    """
    targets = own.get("targets")
    problems: list[Problem] = []
    for name, table in targets.items() if isinstance(targets, dict) else ():
        robot = scene.robots.get(name)
        if robot is None or not isinstance(table, dict):
            continue
        try:
            found = _with_motion(table, robot, beside)
        except DeclarationError as error:
            problems += [problem.inside(f"targets.{name}") for problem in error.problems]
            own["targets"] = {key: value for key, value in own["targets"].items() if key != name}
            continue
        if "file" in table and "angles" in found and robot.joint_angles is None:
            robot.joint_angles = found["angles"][0]
        own["targets"] = {**own["targets"], name: found}
    return problems


def _place_files(own: dict[str, Any], beside: Path) -> None:
    tables, kinds = own.get("controllers"), controller_kinds()
    for name, table in tables.items() if isinstance(tables, dict) else ():
        kind = kinds.get(str(table.get("kind"))) if isinstance(table, dict) else None
        if kind is None:
            continue
        placed = {
            key: beside / table.get(key, "")
            for key in file_fields(kind)
            if isinstance(table.get(key, ""), str) and (key in table or key == "folder")
        }
        own["controllers"] = {**own["controllers"], name: {**table, **placed}}


def _other_scene(
    folder: Path, name: Any, tables: Mapping[str, Any], overrides: Mapping[str, Any]
) -> tuple[Any, list[Problem]]:
    if not isinstance(name, str):
        raise Problem("scene", found=name, expected="the name or file of a scene").error()
    if tables:
        key = next(iter(tables))
        message = f"belongs to the scene; move it to {name}, or remove `scene`"
        raise _wrong(key, message)
    beside = folder / name
    try:
        path = beside if beside.is_file() else find_scene(name)
    except UnknownName as error:
        raise DeclarationError(problems_of(error, "scene")) from None
    return read_scene_file(path, overrides)


def _set_all(
    own: dict[str, Any], settings: Mapping[str, Any], scene: Scene, file: Path
) -> list[Problem]:
    """Applies overrides to the tables of a scenario, and creates missing tables.

    Args:
        own: tables by section. Changed tables are replaced by copies.

    Returns:
        one problem per invalid key.
    """
    problems: list[Problem] = []
    made: dict[tuple[str, str], list[str]] = {}  # keys of created entries
    for key, value in settings.items():
        try:
            section, *parts = parts_of(key)
            tables = own.get(str(section), {})
            if not parts:
                own[key] = value
            elif not isinstance(tables, dict):
                continue  # reported where it is read
            elif section in ("run", "monitor"):
                built = (Run if section == "run" else Monitor)()
                own[str(section)] = with_value(tables, parts, value, built=built)
            else:
                name = str(parts[0])
                entry = _with_setting(str(section), name, tables, parts[1:], value, scene)
                own[str(section)] = {**tables, name: entry}
                if name not in tables or (section, name) in made:
                    made.setdefault((str(section), name), []).append(key)
        except ValueError as error:
            problems += [replace(each, file=str(file)) for each in problems_of(error, key)]
    for (section, name), keys in made.items():
        others = [each for each in own[section] if (section, each) not in made]
        try:
            build_entry(section, own[section][name])
        except DeclarationError as error:
            message = lacking(section, name, error.problems, keys, others)
            if message is not None:
                problems.append(Problem(keys[0], message, str(file)))
                del own[section][name]
    return problems


def _with_setting(
    section: str,
    name: str,
    tables: Mapping[str, Any],
    parts: list[str | int],
    value: Any,
    scene: Scene,
) -> Any:
    """Returns the entry of a section with one changed value.

    If a robot has no entry yet, the entry of the innermost group that has one is copied.

    Raises:
        ValueError: a part of the key is not a table or list, or there is no such robot.
    """
    table: Any = tables.get(name, {})
    robots: list[str] = []
    if section in ("controllers", "targets", "sensors"):
        known = [*scene.robots, *scene.groups]
        if name not in known and name not in tables:
            raise Problem("", "no robot", found=name, available=known).error()
        around = [name, *scene.membership.around.get(name, [])]
        table = next((tables[each] for each in around if each in tables), {})
        robots = scene.membership.members.get(name, [name])
    if not parts:
        return value
    if not isinstance(table, Mapping):
        return table  # reported where it is read
    counts = {scene.robots[robot].n for robot in robots if robot in scene.robots}
    n = counts.pop() if len(counts) == 1 else 0
    built = None
    with suppress(DeclarationError):
        built = build_entry(section, table)
    try:
        return with_value(table, parts, value, built=built, n=n)
    except ValueError:
        if table:
            raise
        raise ValueError(no_table(section, name, tables)) from None


def _with_motion(table: Mapping[str, Any], robot: SerialRobot, beside: Path) -> dict[str, Any]:
    """Replaces `file` in a target's table of kind `recorded` with the motion in this file.

    A recording (`.mcap`) contains the angles of the robot `of`, of a robot with the same name, or
    of a single robot. A table (`.csv`) contains times and recognized joint angles, or one column
    per joint in the order of the joints.

    Args:
        table: table of a target. It is returned unchanged if it does not have a `file`.

    Returns:
        the table with `angles`, averaged over 20 ms, and their `times`, which start at 0 s.

    Raises:
        DeclarationError: the file cannot be read, or has no such motion.
    """
    fields = dict(table)
    file, of = fields.pop("file", None), fields.pop("of", None)
    if table.get("kind") != "recorded":
        return dict(table)
    if file is None:
        if "times" not in table:
            raise _wrong("file", "is required; expected RUN.mcap or TABLE.csv, or times and angles")
        return dict(table)
    if not isinstance(file, str):
        raise _wrong("file", f"found {file!r}; expected the name of a recording or a table")
    for key in ("times", "angles", "angles_deg"):
        if key in fields:
            raise _wrong(key, "is read from the file; remove it or `file`")
    try:
        if not is_table(file):
            times, angles = _from_recording(beside / file, robot, of)
        elif of is not None:
            raise _wrong("of", "is only for recordings; remove it")
        else:
            times, angles = find_tables(beside / file).read_motion(beside / file, robot)
    except SeroError as error:
        if isinstance(error, DeclarationError):
            raise
        raise _wrong("file", str(error)) from None
    rows = ((times - times[0]) / _EVERY).astype(int)
    _, first, counts = np.unique(rows, return_index=True, return_counts=True)
    means = np.add.reduceat(angles, first) / counts[:, None]
    mean_times = np.add.reduceat(times - times[0], first) / counts
    if len(mean_times) < 2:
        raise _wrong("file", f"{file} is shorter than {2 * _EVERY:g} s")
    return {**fields, "times": mean_times - mean_times[0], "angles": means}


def _from_recording(file: Path, robot: SerialRobot, of: object) -> tuple[Array, Array]:
    log = read_run(file)
    names = list(log.robots)
    name = of or (robot.name if robot.name in names or len(names) != 1 else names[0])
    if name not in names:
        key = "file" if of is None else "of"
        raise _wrong(key, f"no robot '{name}' in {file}{did_you_mean(str(name), names)}")
    if log.robots[str(name)].n != robot.n:
        found = f"robot '{name}' in {file} has {log.robots[str(name)].n} joints"
        raise _wrong("file", f"{found}, but '{robot.name}' has {robot.n}")
    return log.times, log.of(str(name), "joint_angles")


def _wrong(key: str, message: str) -> DeclarationError:
    return Problem(key, message).error()
