"""Models of groups, such as a hand, or a robot with torso, arms and hands.

`models/NAME/group.toml` contains objects, and robots and groups that are mounted on each other. A
group with `model = "NAME"` is expanded to these robots before other code reads it. The robots are
named `GROUP_ROBOT`, follow the order of `members` in the model, and are placed relative to the
frame of the group.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...base import paths
from ...base.declaration import is_name, numbers
from ...base.errors import (
    DeclarationError,
    Problem,
    UnknownName,
    collect,
    did_you_mean,
    mismatch,
    problems_of,
    raise_any,
)
from ...base.frames import MIRROR, Array, frame_from, inverse
from ...base.toml_file import key_lines, located, read_toml
from .groups import Group
from .surroundings import Object, set_directory

Declared = tuple[tuple[Path, str], ...]  # files that declare a table, with its keys, outer first
_DEFAULTS = [key for key in Group.model_fields if key not in ("name", "robots")]
_SECTIONS = ("robots", "groups", "objects")
_OF_FILE = ["members", *_SECTIONS, *_DEFAULTS]
_OF_ENTRY = ["model", "mount", "base_frame", "mirrored", "robots", "groups", *_DEFAULTS]


@dataclass
class Expanded:
    """The tables of robots and groups after groups with a model have been expanded.

    Attributes:
        robots: robot tables by name, each with a placement and the file of its model.
        groups: group tables by name, each with a list of robots instead of a model.
        objects: objects that are fixed to the base of a robot, by robot name.
        declared: locations of the tables in files, by `robots.NAME` or `groups.NAME`.
        problems: all errors in models and in references to them.
        broken: keys `groups.NAME` of skipped groups.
        maximum: maximum numbers of `robots` and `groups`. Expansion stops beyond them, because
            nested models multiply.
    """

    robots: dict[str, dict[str, Any]] = field(default_factory=dict)
    groups: dict[str, Any] = field(default_factory=dict)
    objects: dict[str, list[Object]] = field(default_factory=dict)
    declared: dict[str, Declared] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    maximum: Mapping[str, int] = field(default_factory=dict)

    @property
    def is_full(self) -> bool:
        groups = len(self.groups) + len(self.broken)
        return len(self.robots) > self.maximum["robots"] or groups > self.maximum["groups"]


def expand_groups(tables: Mapping[str, Any], file: Path, maximum: Mapping[str, int]) -> Expanded:
    """Expands the groups of a scene that have a model.

    Models are searched for in the folder of the scene file, and among the included models.
    Expansion stops soon after the `maximum` numbers of `robots` and `groups`.
    """
    found = Expanded(maximum=maximum)
    for name, table in tables.items():
        if isinstance(table, Mapping) and "model" in table:
            entry = _found_from(file.parent, {"groups": {name: table}})["groups"][name]
            _add_group(found, _Placement(), name, entry, ((file, f"groups.{name}"),))
        else:
            found.groups[name] = table
    return found


def where(problem: Problem, declared: Declared) -> Problem:
    """Adds file, key and line to a problem of a robot or group that several tables declare.

    The location is the first table in `declared` that contains the key, or else the last table.
    """
    key = problem.key.partition(".")[0]
    path, prefix = next((place for place in declared if has_key(place, key)), declared[-1])
    return located([problem.inside(prefix)], path)[0]


def has_key(place: tuple[Path, str], key: str) -> bool:
    """Whether the table that is declared at `place` (file and dotted key) contains `key`."""
    file, prefix = place
    return Problem(key, "").inside(prefix).key in key_lines(file)


@dataclass(frozen=True)
class _Placement:
    """The placement of the members of a group model in the scene.

    Attributes:
        scope: prefix of the members' names, for example `justin_left_hand_`.
        T: pose of the members' common frame in the frame `mount`, shape (4, 4), m.
        mirrored: whether the members are reflected at the xz plane of their frame.
        mount: frame of a robot on which the members are mounted; None for the world.
        mounted: locations of the declaration of `mount`.
        inside: files of the models that are being expanded, outermost first.
    """

    scope: str = ""
    T: Array = field(default_factory=lambda: np.eye(4))
    mirrored: bool = False
    mount: str | None = None
    mounted: Declared = ()
    inside: tuple[Path, ...] = ()

    def of(self, name: str, table: Mapping[str, Any], declared: Declared) -> _Placement:
        T, mirrored, mount = np.eye(4), table.get("mirrored", False), table.get("mount")
        problems = []
        try:
            T = frame_from(table.get("base_frame", T), numbers)
        except ValueError as error:
            problems += problems_of(error, "base_frame")
        if not isinstance(mirrored, bool):
            problems.append(Problem("mirrored", found=mirrored, expected="true or false"))
        if not isinstance(mount, str | None):
            problems.append(Problem("mount", found=mount, expected="a frame of a robot"))
        raise_any(problems)
        if self.mirrored:
            T = MIRROR @ T @ MIRROR
        if mount is None:
            T, mount, declared = self.T @ T, self.mount, self.mounted
        else:  # on another member, which is mirrored together with the group
            mount = f"{self.scope}{mount}"
        scope = f"{self.scope}{name}_"
        return _Placement(scope, T, mirrored != self.mirrored, mount, declared, self.inside)


def _add_group(
    found: Expanded, around: _Placement, name: str, entry: Mapping[str, Any], declared: Declared
) -> None:
    if found.is_full:
        return
    problems = [
        Problem(key, "unknown key", available=_OF_ENTRY) for key in entry if key not in _OF_ENTRY
    ]
    try:
        is_name(name)
    except ValueError as error:
        problems += problems_of(error, "name")
    path = place = None
    with collect(problems, ""):
        place = around.of(name, entry, declared)
    with collect(problems, "model"):
        path = _group_file(entry["model"], declared[-1][0].parent, around.inside)
    found.problems += [where(problem, declared) for problem in problems]
    if path is None or place is None:
        found.broken.append(f"groups.{around.scope}{name}")
        return
    try:
        _Members(found, replace(place, inside=(*place.inside, path)), entry, declared).add()
    except DeclarationError as error:  # the file is unreadable
        found.problems += error.problems
        found.broken.append(f"groups.{around.scope}{name}")


def _group_file(model: Any, beside: Path, inside: Sequence[Path]) -> Path:
    if not isinstance(model, str | Path):
        raise mismatch(model, "the name of a group model")
    try:
        path = model if isinstance(model, Path) else paths.find_group_model(model, beside)
    except (DeclarationError, UnknownName) as error:
        raise Problem("", str(error)).error() from None
    files = [each.resolve() for each in inside]
    if path.resolve() in files:
        way = [_name_of(each) for each in (*inside[files.index(path.resolve()) :], path)]
        message = f"group models contain each other: {' in '.join(way[::-1])}"
        raise Problem("", message).error()
    return path


def _name_of(path: Path) -> str:
    return path.resolve().parent.name


class _Members:
    """Adds the members of one group with a model. Raises DeclarationError for invalid models."""

    def __init__(
        self, found: Expanded, place: _Placement, entry: Mapping[str, Any], declared: Declared
    ) -> None:
        self._found, self._place, self._entry, self._declared = found, place, entry, declared
        self._path = place.inside[-1]
        self._tables = _found_from(self._path.parent, read_toml(self._path), beside=True)
        self._problems: list[Problem] = []  # errors in the model
        self._standing: tuple[str, Array] | None = None  # name and base frame of the objects' robot

    def add(self) -> None:
        name = self._place.scope.removesuffix("_")
        for key in self._tables:
            if key not in _OF_FILE:
                self._problems.append(Problem(key, "unknown key", available=_OF_FILE))
        known = {section: self._section(self._tables, section) for section in _SECTIONS}
        above = {section: self._section(self._entry, section) for section in ("robots", "groups")}
        for section, key in ((s, key) for s, keys in above.items() for key in keys):
            if key not in known[section]:
                reason, names = f"not a member of {_name_of(self._path)}", known[section]
                problem = Problem(f"{section}.{key}", reason, available=names)
                self._found.problems.append(where(problem, self._declared))
        for key, table in known["robots"].items():
            self._add_robot(key, {**table, **above["robots"].get(key, {})})
        for key, table in known["groups"].items():
            self._add_group(key, _merged(table, above["groups"].get(key, {})))
        for key, table in known["objects"].items():
            self._add_object(key, table)
        members = self._members(known)
        defaults = {
            key: value
            for source in (self._tables, self._entry)
            for key, value in source.items()
            if key in _DEFAULTS
        }
        self._found.groups[name] = {**defaults, "robots": [self._full(each) for each in members]}
        self._found.declared[f"groups.{name}"] = (*self._declared, (self._path, ""))
        self._found.problems += located(self._problems, self._path)

    def _members(self, known: Mapping[str, Mapping[str, Any]]) -> list[str]:
        every = [*known["robots"], *known["groups"]]
        others = [name for name, table in known["groups"].items() if "model" not in table]
        members = self._tables.get("members", [name for name in every if name not in others])
        if not isinstance(members, list):
            self._wrong("members", f"found {members!r}; expected a list of robots and groups")
            return every
        for name in (name for name in members if name not in every):
            near = did_you_mean(str(name), every)
            self._wrong("members", f"no robot or group {name!r}{near}")
        return [name for name in members if name in every]

    def _add_robot(self, name: str, table: dict[str, Any]) -> None:
        key, full = f"robots.{name}", self._full(name)
        declared = self._places(key)
        with collect(self._problems, key):
            place = self._place.of(name, table, declared)
            if table.get("mount") is None and not table.get("mirrored") and not self._standing:
                self._standing = full, frame_from(table.get("base_frame", np.eye(4)), numbers)
            here = {"base_frame": place.T, "mirrored": place.mirrored, "mount": place.mount}
            self._found.robots[full] = {**table, **here}
            self._found.declared[f"robots.{full}"] = (
                *declared[:-1], *place.mounted, declared[-1],
            )  # fmt: skip

    def _add_group(self, name: str, table: dict[str, Any]) -> None:
        declared = self._places(f"groups.{name}")
        if "model" in table:
            _add_group(self._found, self._place, name, table, declared)
            return
        robots = table.get("robots")
        if isinstance(robots, list):
            robots = [self._full(each) if isinstance(each, str) else each for each in robots]
            table = {**table, "robots": robots}
        self._found.groups[self._full(name)] = table
        self._found.declared[f"groups.{self._full(name)}"] = declared

    def _add_object(self, name: str, table: dict[str, Any]) -> None:
        key = f"objects.{name}"
        if self._standing is None:
            message = (
                "no robot can carry the object; expected one that is neither mounted nor mirrored"
            )
            self._wrong(key, message)
            return
        robot, T = self._standing
        with collect(self._problems, key):
            item = Object(**{**table, "name": name, "on": "base"})
            item = item.model_copy(update={"frame": inverse(T) @ item.frame})
            item._declared = self._path, key
            self._found.objects.setdefault(robot, []).append(item)

    def _section(self, tables: Mapping[str, Any], section: str) -> dict[str, dict[str, Any]]:
        entries = tables.get(section, {})
        wrong = [Problem(section, found=entries, expected=f"tables [{section}.NAME]")]
        if isinstance(entries, Mapping):
            wrong = [
                Problem(f"{section}.{name}", found=table, expected="a table")
                for name, table in entries.items()
                if not isinstance(table, Mapping)
            ]
        if tables is self._tables:
            self._problems += wrong
        else:
            self._found.problems += [where(problem, self._declared) for problem in wrong]
        return {} if wrong else {name: dict(table) for name, table in entries.items()}

    def _places(self, key: str) -> Declared:
        outer = ((file, f"{prefix}.{key}") for file, prefix in self._declared)
        return (*outer, (self._path, key))

    def _full(self, name: str) -> str:
        return f"{self._place.scope}{name}"

    def _wrong(self, key: str, message: str) -> None:
        self._problems.append(Problem(key, message))


def _merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    merged = {**below, **above}
    for section in ("robots", "groups"):
        one, other = below.get(section), above.get(section)
        if isinstance(one, dict) and isinstance(other, dict):
            both = {key: _merged(one.get(key, {}), other[key]) for key in other}
            merged[section] = {**one, **both}
    return merged


def _found_from(folder: Path, tables: Mapping[str, Any], beside: bool = False) -> dict[str, Any]:
    """Returns tables in which models, meshes and MJCF files have absolute paths.

    The name of an existing model is replaced by the `Path` of its file. Models are searched for in
    `folder`, and also in its parent folder if `beside` is true.
    """
    found: dict[str, Any] = deepcopy(dict(tables))
    whole = folder.absolute()  # absolute, so that later joins do not change it
    for section in _SECTIONS:
        entries = found.get(section)
        for table in entries.values() if isinstance(entries, dict) else ():
            if not isinstance(table, dict):
                continue
            if section == "groups":
                table.update(_found_from(folder, table, beside))
            if section == "objects":
                set_directory([table], whole)
            if section == "robots" and isinstance(table.get("directory"), str):
                table["directory"] = str(whole / table["directory"])
            set_directory(table.get("children"), whole)
            find = paths.find_model if section == "robots" else paths.find_group_model
            around = Path(os.path.normpath(folder / ".."))
            for place in (folder, around) if beside else (folder,):
                if isinstance(table.get("model"), str):
                    with suppress(DeclarationError, UnknownName):  # reported when the model is read
                        table["model"] = find(table["model"], place)
    return found
