"""Reads a scene file and collects all of its problems."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from ...base import paths
from ...base.declaration import file_fields, is_name
from ...base.dotted_keys import lacking, parts_of, with_value
from ...base.errors import (
    DeclarationError,
    PluginError,
    Problem,
    UnknownName,
    collect,
    did_you_mean,
    mismatch,
    nearest,
    problems_of,
    raise_any,
)
from ...base.plugins import DECOR, SOURCES, load_plugin
from ...base.toml_file import located, read_toml
from ..importers.importer import read_imported, read_robot_file
from .cartesian import ReceivedFrame, SmartArrow
from .double import Double
from .group_model import Expanded, expand_groups, where
from .groups import SHARED, Group, membership
from .robot import SerialRobot, build_robot, warn_of_degrees
from .route_text import origin_text
from .scene import MOST_ENTRIES, Scene, SceneToggles, excess
from .surroundings import Camera, Light, Object, View, set_directory

T = TypeVar("T")
log = logging.getLogger(__name__)
# Sections of named tables. If several sections contain a name, it refers to the last of them.
_ENTRIES = (
    *("decor", "sources", "lights", "cameras", "objects", "frames", "arrows", "doubles"),
    "robots",
)
_TABLES: Mapping[str, Callable[..., Any]] = {"view": View, "toggles": SceneToggles}
_PLAIN = ("floor", "name", "description", "note")
_OF_MODEL = ("model", "mount", "base_frame", "mirrored")  # keys of groups with a model
_DEGREES = "_deg"  # suffix of keys in degrees
_OF_DYNAMICS = (
    "motor_inertias", "viscous_friction", "coulomb_friction", "joint_stiffness", "joint_damping",
)  # fmt: skip


def read_scene_file(
    path: Path, overrides: Mapping[str, Any] | None = None
) -> tuple[Scene, list[Problem]]:
    """Reads a scene file in any supported format, and logs losses of a conversion as warnings.

    Returns the scene without its invalid parts, and all problems. Raises DeclarationError if the
    file cannot be read. `scene_from_tables` documents `overrides`.
    """
    imported = read_imported(path)
    if imported is None:
        return scene_from_tables(path, read_toml(path), overrides)
    for warning in imported.warnings:
        log.warning("%s", paths.without_temporary(f"{path}: {warning}"))
    return scene_from_tables(path, imported.tables, overrides, lines=imported.lines or None)


def scene_from_tables(
    path: Path,
    tables: Mapping[str, Any],
    overrides: Mapping[str, Any] | None = None,
    *,
    known: Collection[str] = (),
    lines: dict[str, int] | None = None,
) -> tuple[Scene, list[Problem]]:
    """Builds the valid parts of a scene and returns the problems of the invalid parts.

    Args:
        path: scene file from which the tables were read.
        tables: sections of the scene file.
        overrides: values by dotted key that override the file. A key is a key of scene files
            (`view.azimuth_deg`, `sources.udp.port`, `robots.lwr.show_axes`), or starts with the
            name of a robot, group or object (`lwr.dynamics.coulomb_friction[1]`). Routes to
            overridden inputs are removed.
        known: names of additional valid sections, as suggestions for mistyped names.
        lines: line numbers of the keys (default: read from the TOML file).

    Returns:
        the scene without its invalid parts, and all problems. The package `sero_mj.data.drive`
        checks sources and routes later.

    Raises:
        DeclarationError: a section has too many entries.
    """
    if not (too_many := excess(tables)):
        reader = _SceneReader(path, tables, known, overrides or {}, lines)
        expanded = {section: reader.tables.get(section, {}) for section in ("robots", "groups")}
        too_many = excess(expanded)
    if too_many:
        raise DeclarationError(located(too_many, path, lines))
    scene = reader.scene()
    for group in scene.groups.values():
        for name in group.robots if group.joint_angles is not None else ():
            if (member := scene.robots.get(name)) is not None:
                warn_of_degrees(member, member.home, f"group '{group.name}': ")
    for double in scene.doubles.values():
        robot = scene.robots.get(double.of)
        if robot is not None and double.joint_angles is not None:
            warn_of_degrees(robot, double.joint_angles, f"double '{double.name}': ")
    # An error in the mount of a group concerns all of its robots.
    return scene, list(dict.fromkeys(scene.located(reader.problems)))


def group_from_model(
    model: str, name: str | None = None, **fields: Any
) -> tuple[list[SerialRobot], list[Group]]:
    """Reads a group model, like the table `[groups.NAME]` of a scene file with the key `model`.

    Args:
        model: name of an included group (`dlr_hand2`), folder with a `group.toml`, or file.
        name: name of the group (default: the name of the model).
        **fields: `mount`, `base_frame`, `mirrored`, defaults of `Group`, and fields of members by
            name in `robots` and `groups`.

    Returns:
        Robots and groups for a `Scene`.

    Raises:
        UnknownName: no group model has this name.
        DeclarationError: the files or the fields are invalid.
    """
    path = paths.find_group_model(model)
    entry = {"model": path, **fields}
    reader = _SceneReader(path, {"groups": {name or path.resolve().parent.name: entry}}, (), {})
    robots, groups = reader.robots(), reader.groups()
    raise_any(reader.problems)
    return robots, groups


class _SceneReader:
    """Reads the sections of a scene file, applies overrides, and collects all problems."""

    def __init__(
        self,
        path: Path,
        tables: Mapping[str, Any],
        known: Collection[str],
        overrides: Mapping[str, Any],
        lines: dict[str, int] | None = None,
    ) -> None:
        self.path, self.known, self.lines = path, known, lines
        self.tables = dict(tables)
        self.problems: list[Problem] = []
        self.broken: list[str] = []
        self._settings: dict[str, list[tuple[str, Any]]] = {}  # (key, value) overrides by entry
        self._set_for: dict[tuple[str, str], str] = {}  # group whose override set a key of a robot
        self._made: list[str] = []  # entries that are in overrides but not in the file
        self._of_groups: dict[str, dict[str, str]] = {}  # for each key: error message to robot name
        self.expanded = Expanded()
        others = self._override_groups(overrides)
        if isinstance(self.tables.get("groups"), dict):
            self._expand(self.tables["groups"])
        for target, value in others.items():
            self._override(target, value)

    def _expand(self, groups: dict[str, Any]) -> None:
        self.expanded = expanded = expand_groups(groups, self.path, MOST_ENTRIES)
        self.problems += expanded.problems
        self.broken += expanded.broken
        self.tables = {**self.tables, "groups": expanded.groups}
        if not expanded.groups:
            del self.tables["groups"]
        robots = self.tables.get("robots", {})
        if expanded.robots and isinstance(robots, dict):
            for name in expanded.robots.keys() & robots.keys():
                message = "a robot of a group model already has this name"
                self.problems.append(Problem(f"robots.{name}", message))
            self.tables["robots"] = {**robots, **expanded.robots}

    def scene(self) -> Scene:
        sections: dict[str, Callable[[], Any]] = {
            "robots": self.robots,
            "groups": self.groups,
            "sources": lambda: self._each("sources", self._source),
            "routes": self._routes,
            "doubles": lambda: list(self._each("doubles", _named(Double)).values()),
            "arrows": lambda: list(self._each("arrows", _named(SmartArrow)).values()),
            "frames": lambda: list(self._each("frames", _named(ReceivedFrame)).values()),
            "objects": lambda: list(self._each("objects", self._object).values()),
            "cameras": lambda: self._each("cameras", _nameless(Camera)),
            "lights": lambda: self._each("lights", _nameless(Light)),
            "view": lambda: View(**self._table("view")),
            "toggles": lambda: SceneToggles(**self._table("toggles")),
            "decor": lambda: self._each("decor", self._decor),
            "floor": self._floor,
            "name": lambda: self._typed("name", str, "a text"),
            "description": lambda: self._typed("description", str, "a text"),
            "note": lambda: self._typed("note", str, "a text"),
        }
        for key in self.tables:
            if key not in sections:
                every = [*sections, *self.known]
                unknown = Problem(key, "unknown section", available=every)
                self.problems.append(unknown)
                meant = unknown.near
                if meant in sections:  # avoids errors about references to it
                    self.broken.append(meant)
        read = {}
        for key, reader in sections.items():
            if key in self.tables:
                value = self._try(key, reader)
                if value is not None:
                    read[key] = value
        fields = {"name": self.path.stem, **read, "file": self.path, "broken": self.broken}
        fields["lines"] = self.lines
        if not self.tables and not self.broken:
            message = "the file is empty; expected at least [robots.NAME] or [objects.NAME]"
            self.problems.append(Problem("", message))
        scene = Scene(**fields)
        for name, robot in scene.robots.items():  # Values of a robot override those of its group.
            for key, value in self._settings.get(f"robots.{name}", []):
                field = key.partition("[")[0]
                if field.removesuffix(_DEGREES) in SHARED:
                    with suppress(ValueError):  # The error was reported when the robot was built.
                        changed = with_value({}, parts_of(key), value, built=robot)
                        setattr(robot, field, changed[field])
        for key, messages in self._of_groups.items():  # Robots of a group may differ in size.
            texts = [f"{message} ({robot})" for message, robot in messages.items()]
            message = "; ".join([*messages] if len(messages) == 1 else texts[:3])
            self.problems.append(Problem(key, message))
        self.problems += scene.problems()
        camera = scene.view.camera
        known = camera is None or camera in scene.cameras or f"cameras.{camera}" in self.broken
        if not known:
            problem = Problem("view.camera", "no camera", found=camera, available=scene.cameras)
            self.problems.append(problem)
        return scene

    def robots(self) -> list[SerialRobot]:
        return list(self._each("robots", self._robot).values())

    def groups(self) -> list[Group]:
        groups = self._each("groups", _named(Group))
        for name, group in groups.items():
            group._declared = self.expanded.declared.get(f"groups.{name}", ())
        return list(groups.values())

    def _override_groups(self, overrides: Mapping[str, Any]) -> dict[str, Any]:
        """Applies overrides of groups before their expansion, and returns the other overrides.

        An override concerns a group if it starts with `groups.`, or if it is `NAME.KEY`, where NAME
        is a group with a model, and KEY is a key that only such groups have.
        """
        others = {}
        for target, value in overrides.items():
            groups = self.tables.get("groups", {})
            name, _, field = target.removeprefix("groups.").partition(".")
            table = groups.get(name) if isinstance(groups, dict) else None
            of_model = isinstance(table, dict) and "model" in table
            key = field.partition(".")[0].partition("[")[0]
            if not target.startswith("groups.") and not (of_model and key in _OF_MODEL):
                others[target] = value
            elif not isinstance(table, dict) or not field:
                self.problems.append(Problem(target, "no group", found=name, available=groups))
            else:
                changed = self._with_value(table, target, field, value)
                self.tables["groups"] = {**groups, name: changed}
        return others

    def _override(self, target: str, value: Any) -> None:
        first, _, rest = target.partition(".")
        tables = {section: self.tables.get(section, {}) for section in (*_ENTRIES, "routes")}
        entries = {
            name: section
            for section in _ENTRIES
            for name in (tables[section] if isinstance(tables[section], dict) else ())
        }
        members = self._members()
        section = entries.get(first, first)
        if rest and first in members:
            self._override_group(first, members[first], rest, value)
        elif section in _ENTRIES and isinstance(tables[section], dict):
            name, _, field = target.partition(".") if first in entries else rest.partition(".")
            if not field:
                example = f"{name or first}.joint_angles"
                expected = f"the names of a robot and a field, such as {example}"
                self.problems.append(Problem(target, "the key has no field", expected=expected))
                return
            if name not in tables[section]:
                self.tables[section] = {**tables[section], name: {}}
                self._made.append(f"{section}.{name}")
            self._settings.setdefault(f"{section}.{name}", []).append((field, value))
            self._drop_routes(f"{name}.{field.removesuffix(_DEGREES)}")
        elif first in _PLAIN and not rest:
            self.tables[first] = value
        elif first in _TABLES and rest:
            table = self.tables.get(first, {})
            if isinstance(table, dict):
                self.tables[first] = self._with_value(table, target, rest, value, _TABLES[first]())
        elif first == "routes" and rest and isinstance(tables["routes"], dict):
            self.tables["routes"] = {**tables["routes"], rest.strip("'\""): value}
        elif section not in _ENTRIES:
            names = [*entries, *members]
            every = [*names, *_ENTRIES, *_TABLES, *_PLAIN, "groups", "routes", *self.known]
            known, of = every if nearest(first, every) else names, "to set this for"
            self.problems.append(Problem(target, "no robot", found=first, of=of, available=known))

    def _with_value(
        self, table: Mapping[str, Any], target: str, key: str, value: Any, built: Any = None
    ) -> dict[str, Any]:
        try:
            return with_value(table, parts_of(key), value, built=built)
        except ValueError as error:
            self.problems += problems_of(error, target)
            return dict(table)

    def _override_group(self, group: str, robots: Sequence[str], field: str, value: Any) -> None:
        if field.removesuffix(_DEGREES) in SHARED and isinstance(value, list):
            groups = self.tables["groups"]
            table = _without_other_unit(groups[group], field)
            self.tables["groups"] = {**groups, group: {**table, field: value}}
            field = field.removesuffix(_DEGREES)
            self._drop_routes(*(f"{each}.{field}" for each in (group, *robots)))
            return
        key = field.partition(".")[0].partition("[")[0]
        if key not in SerialRobot.model_fields:
            message = f"no robot has this field{did_you_mean(key, SerialRobot.model_fields)}"
            self.problems.append(Problem(f"{group}.{field}", message))
            return
        for robot in robots:
            self._set_for[robot, field] = group
            self._override(f"{robot}.{field}", value)
        self._drop_routes(f"{group}.{field}")

    def _drop_routes(self, *targets: str) -> None:
        def whole(target: str) -> str:
            name, _, key = target.partition(".")
            return f"{name}.{key.rpartition('.')[2]}"

        if isinstance(self.tables.get("routes"), dict):
            routes = self.tables["routes"].items()
            self.tables["routes"] = {
                key: each for key, each in routes if not {key, whole(key)} & {*targets}
            }

    def _members(self) -> dict[str, list[str]]:
        tables = self.tables.get("groups")
        lists = {
            group: table["robots"]
            for group, table in (tables.items() if isinstance(tables, dict) else ())
            if isinstance(table, dict) and isinstance(table.get("robots"), list)
        }
        texts = {group: [each for each in names if isinstance(each, str)]
                 for group, names in lists.items()}  # fmt: skip
        return membership(texts).members

    def _try(self, key: str, build: Callable[[], T]) -> T | None:
        try:
            return build()
        except DeclarationError as error:
            declared = self.expanded.declared.get(key)
            if key in self._made and (message := self._lacking(key, error.problems)):
                section, _, name = key.partition(".")
                target = f"{section}.{name}.{self._settings[key][0][0]}"
                self.problems.append(Problem(target, message))
                error = DeclarationError([])
            for problem in error.problems:
                if (problem_set := self._as_set(key, problem)) is not None:
                    found = self._of_groups.setdefault(problem_set.key, {})
                    found.setdefault(problem_set.message, key.partition(".")[2])
                    continue
                here = problem.inside(key) if declared is None else where(problem, declared)
                self.problems.append(problem if problem.file else here)
        self.broken.append(key)
        return None

    def _lacking(self, place: str, problems: Sequence[Problem]) -> str | None:
        keys = [f"{place}.{field}" for field, _ in self._settings[place]]
        section, _, name = place.partition(".")
        others = [each for each in self.tables[section] if f"{section}.{each}" not in self._made]
        return lacking(section, name, problems, keys, others)

    def _as_set(self, place: str, problem: Problem) -> Problem | None:
        section, _, name = place.partition(".")
        if section != "robots":
            return None
        for field, _ in self._settings.get(place, []):
            if problem.key == field or problem.key.startswith(f"{field}."):
                group = self._set_for.get((name, field))
                if group is not None:
                    return problem.inside(group)
                if place in self.expanded.declared:
                    return problem.inside(name)
        return None

    def _floor(self) -> Any:
        value = self.tables["floor"]
        if value in (True, False, "below"):
            return value
        return self._typed("floor", bool, "true, false or 'below'")

    def _typed(self, key: str, kind: type[T], expected: str) -> T | None:
        value = self.tables[key]
        if isinstance(value, kind):
            return value
        self.problems.append(Problem(key, found=value, expected=expected))
        return None

    def _table(self, key: str) -> dict[str, Any]:
        value = self.tables[key]
        if isinstance(value, dict):
            return value
        raise mismatch(value, f"a table [{key}]")

    def _each(self, key: str, build: Callable[[str, dict[str, Any]], T]) -> dict[str, T]:
        built: dict[str, T] = {}
        for name, table in self._table(key).items():
            place = f"{key}.{name}"
            value = self._try(place, partial(self._entry, build, name, table, place))
            if value is not None:
                built[name] = value
        return built

    def _entry(self, build: Callable[[str, Any], T], name: str, table: Any, place: str) -> T:
        if not isinstance(table, dict):
            raise mismatch(table, f"a table [{place}]")
        settings = self._settings.get(place, [])
        built = below = None
        lists: dict[str, int] = {}
        if settings:  # An override may set one element of a list in the robot file.
            with suppress(DeclarationError):
                built = build(name, table)
            if isinstance(built, SerialRobot):
                lists = _lists_of(built)
            with suppress(DeclarationError, UnknownName):
                if isinstance(table.get("model"), str):
                    path = paths.find_model(table["model"], self.path.parent)
                    below = read_robot_file(path, arguments=_arguments(table)).tables
        problems: list[Problem] = []
        for key, value in settings:
            try:
                parts = parts_of(key)
                table = _without_other_unit(table, key)
                table = with_value(table, parts, value, built=built, below=below, lists=lists)
            except ValueError as error:
                problems += problems_of(error, key)
        with collect(problems, ""):
            found = build(name, table)
            if not problems:
                return found
        raise DeclarationError(problems)

    def _routes(self) -> dict[str, str]:
        routes = {}
        for target, origin in self._table("routes").items():
            try:
                routes[target] = origin_text(origin)
            except ValueError as error:
                self.problems += problems_of(error, f"routes.{target}")
        return routes

    def _robot(self, name: str, table: dict[str, Any]) -> SerialRobot:
        robot = self._built(name, table)
        objects = self.expanded.objects.get(name, [])
        if objects:  # These are objects of a group that are fixed to its first robot.
            robot.children = [*robot.children, *objects]
        robot._declared = self.expanded.declared.get(f"robots.{name}", ())
        return robot

    def _built(self, name: str, table: dict[str, Any]) -> SerialRobot:
        if "name" in table:
            message = f"a robot has no key 'name'. Write [robots.{table['name']}] instead"
            raise Problem("name", message).error()
        fields = {**table, "name": name}
        arguments = _arguments(fields)
        fields.pop("arguments", None)
        model = fields.pop("model", None)
        known = [*SerialRobot.model_fields, "model", "arguments"]
        for key in fields:
            if key not in known and nearest(key, known) == "model":
                raise Problem(key, "unknown key", available=known).error()
        declared = self.expanded.declared.get(f"robots.{name}")
        beside = declared[-1][0].parent if declared else self.path.parent
        if "directory" in fields and isinstance(fields["directory"], str):
            fields["directory"] = str(beside / fields["directory"])
        set_directory(fields.get("children"), beside)
        if model is None:
            fields.setdefault("directory", str(beside))
            return build_robot(fields)
        if not isinstance(model, str | Path):
            raise mismatch(model, "the name of a robot", key="model")
        try:
            path = model if isinstance(model, Path) else paths.find_model(model, beside)
        except DeclarationError as error:  # The error is in another file.
            raise Problem("model", str(error)).error() from None
        except UnknownName as error:
            raise DeclarationError(problems_of(error, "model")) from None
        if arguments is not None and path.suffix == ".toml":
            message = f"arguments are only for xacro, but the model is {path.name}"
            raise Problem("arguments", message).error()
        return build_robot(fields, path, arguments=arguments)

    def _source(self, name: str, table: dict[str, Any]) -> dict[str, Any]:
        _check_name(name)
        found = table.get("kind")
        try:
            files = file_fields(load_plugin(SOURCES, found)) if isinstance(found, str) else []
        except (UnknownName, PluginError):  # The error is reported when the source is created.
            files = []
        relative = {key: table[key] for key in files if isinstance(table.get(key), str)}
        return table | {key: str(self.path.parent / file) for key, file in relative.items()}

    def _decor(self, name: str, table: dict[str, Any]) -> dict[str, Any]:
        try:
            kind = load_plugin(DECOR, name)
        except (UnknownName, PluginError) as error:
            raise DeclarationError(problems_of(error)) from error
        kind.settings_kind(**table)
        return table

    def _object(self, name: str, table: dict[str, Any]) -> Object:
        fields = {**table, "name": name}
        set_directory([fields], self.path.parent)
        return Object(**fields)


def _arguments(table: Mapping[str, Any]) -> dict[str, Any] | None:
    found = table.get("arguments")
    is_right = isinstance(found, dict) and all(
        isinstance(value, str | int | float) for value in found.values()
    )
    if found is not None and not is_right:
        raise mismatch(found, "a table of texts and numbers", key="arguments")
    return found


def _lists_of(robot: SerialRobot) -> dict[str, int]:
    limits = ("velocity_limits", "torque_limits", "acceleration_limits")
    values = dict.fromkeys(SHARED, robot.coupled.k)
    return values | dict.fromkeys((*limits, *_OF_DYNAMICS), robot.n)


def _without_other_unit(table: Mapping[str, Any], key: str) -> dict[str, Any]:
    other = key.removesuffix(_DEGREES) if key.endswith(_DEGREES) else f"{key}{_DEGREES}"
    return {each: value for each, value in table.items() if each != other}


def _named(kind: Callable[..., T]) -> Callable[[str, dict[str, Any]], T]:
    return lambda name, table: kind(**{**table, "name": name})


def _nameless(kind: Callable[..., T]) -> Callable[[str, dict[str, Any]], T]:
    def build(name: str, table: dict[str, Any]) -> T:
        _check_name(name)
        return kind(**table)

    return build


def _check_name(name: str) -> None:
    try:
        is_name(name)
    except ValueError as error:
        raise DeclarationError(problems_of(error, "name")) from None
