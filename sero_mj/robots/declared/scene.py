"""`Scene`: the declaration of robots, sources, routes and surroundings."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Sized
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from ...base.declaration import Declaration
from ...base.errors import (
    DeclarationError,
    Problem,
    collect,
    did_you_mean,
    mismatch,
    nearest,
    raise_any,
)
from ...base.frames import Array
from ...base.paths import argument_of
from ...base.toml_file import key_lines, located
from ...base.trust import Request
from .cartesian import WORLD, NamedFrame, ReceivedFrame, SmartArrow, list_frames
from .double import Double
from .group_model import has_key, where
from .groups import SHARED, Group, group_problems, membership
from .mounts import carrier, mount_problems, mounted_by_joints
from .robot import SerialRobot
from .robot_parts import VALUE_INPUTS, check_line_values
from .route_text import names_in, route_texts
from .surroundings import Camera, Light, Object, View

# Maximum number of entries per section, so that a scene compiles within seconds.
MOST_ENTRIES = {
    "robots": 200,
    "groups": 100,
    "doubles": 500,
    "arrows": 1000,
    "frames": 1000,
    "objects": 2000,
    "cameras": 1000,
    "lights": 100,
    "sources": 1000,
    "routes": 10000,
}
# Sections whose entries have frames that others can refer to, or that routes can move.
_WITH_FRAMES = ("robots", "doubles", "frames", "objects", "arrows", "cameras")

_Entry = TypeVar("_Entry", SmartArrow, ReceivedFrame)


class SceneToggles(Declaration):
    """Initial states of the toggles of a whole scene. Robots have toggles such as `show_arrows`.

    Attributes:
        legend: whether the legend of the arrows is shown.
        status: whether errors of the sources are shown.
        frame_names: whether all visible axes show their names.
        flange_checks: whether received flange frames are compared with those of the robots.
    """

    legend: bool = True
    status: bool = True
    frame_names: bool = False
    flange_checks: bool = True


class Scene:
    """The declaration of a scene, which consists of robots, sources, routes and surroundings.

    Args:
        robots: robots with unique names.
        groups: ordered groups of robots, which share routes and toggles.
        sources: sources by name, as source objects or as tables with `kind` and its fields.
        routes: origins by input (`lwr.joint_angles`). An origin is an event (`udp.values0`), an
            expression (`udp.values0[0:7] * deg`), or numbers. For single joints, the origin is
            `{"from": "udp.values0", "joints": ["l_elbow", "l_wrist"]}`, or a list of such tables.
            Alternatively, the input names a limb (`icub.left_arm.joint_angles`).
        doubles: transparent doubles of robots. A double of a group becomes one double per robot,
            named `DOUBLE_ROBOT`.
        lights: lights by name, in addition to the headlight (default: one that casts shadows).
        floor: whether there is a floor at z = 0, or `below` for a floor at the lowest point of the
            robots in their initial poses, if that is below 0. The default is `below` if a robot is
            from URDF or MJCF, or if the scene has one robot without `base_frame` and no objects.
            Otherwise, the default is true.
        decor: settings of visual features, by name of the feature.
        broken: keys of the invalid sections (`robots`) and entries (`robots.lwr`) of the file.
        lines: line numbers by dotted key, if the file is not TOML.

    Attributes:
        withheld: actions that the scenario requests but the user has not permitted, or None. If
            there are such actions, the scene is shown without simulation.

    Raises:
        DeclarationError: an argument is invalid, or entries are inconsistent. If `file` is set,
            `problems` reports inconsistent entries instead.
    """

    def __init__(
        self,
        *,
        robots: list[SerialRobot] | None = None,
        groups: list[Group] | None = None,
        sources: Mapping[str, Any] | None = None,
        routes: Mapping[str, Any] | None = None,
        doubles: list[Double] | None = None,
        arrows: list[SmartArrow] | None = None,
        frames: list[ReceivedFrame] | None = None,
        objects: list[Object] | None = None,
        cameras: Mapping[str, Camera] | None = None,
        lights: Mapping[str, Light] | None = None,
        floor: bool | Literal["below"] | None = None,
        view: View | None = None,
        toggles: SceneToggles | None = None,
        decor: Mapping[str, Mapping[str, Any]] | None = None,
        description: str = "",
        note: str = "",
        name: str = "scene",
        file: Path | None = None,
        broken: Collection[str] = (),
        lines: dict[str, int] | None = None,
    ) -> None:
        if isinstance(robots, SerialRobot):
            robots = [robots]
        problems = [
            *_not_of_type(SerialRobot, robots=robots),
            *_not_of_type(Group, groups=groups),
            *_not_of_type(Double, doubles=doubles),
            *_not_of_type(SmartArrow, arrows=arrows),
            *_not_of_type(ReceivedFrame, frames=frames),
            *_not_of_type(Object, objects=objects),
            *_not_of_type(Camera, Mapping, cameras=cameras),
            *_not_of_type(Light, Mapping, lights=lights),
            *_not_of_type(object, Mapping, sources=sources, routes=routes, decor=decor),
            *_not_of_type(View, None, view=view),
            *_not_of_type(SceneToggles, None, toggles=toggles),
            *_floor_problems(floor),
        ]
        raise_any(problems)
        self.robots: dict[str, SerialRobot] = {}
        self.groups = {group.name: group for group in groups or []}
        self.membership = membership({name: group.robots for name, group in self.groups.items()})
        doubled = (self.membership.members.get(double.of, [""]) for double in doubles or [])
        self._excess = excess(
            {
                "robots": robots or (),
                "groups": groups or (),
                "doubles": range(sum(map(len, doubled))),
            }
        )
        if self._excess and file is None:
            raise DeclarationError(self._excess)
        self._group_problems: list[Problem] = []
        self.arrows = {arrow.name: arrow for arrow in arrows or []}
        self.frames = {frame.name: frame for frame in frames or []}
        self.sources = dict(sources or {})
        self.routes = route_texts(routes or {})
        self.objects = list(objects or [])
        self.cameras = dict(cameras or {})
        self.lights = dict(lights or {})
        self._finds_floor = floor is None
        self.floor: bool | Literal["below"] = True if floor is None else floor
        self.view = view or View()
        self.toggles = toggles or SceneToggles()
        self.decor = dict(decor or {})
        self.description = description
        self.note = note
        self.name = name
        self.file = file
        self.withheld: Request | None = None
        self.broken = frozenset([*broken, *(problem.key for problem in self._excess)])
        self._lines = lines
        for robot in robots or []:
            self.add(robot)
        self.doubles: dict[str, Double] = {}
        self.double_groups: dict[str, list[str]] = {}  # names, by double of a group
        for double in doubles or [] if "doubles" not in self.broken else []:
            self._add_double(double)
        self.arrows = {name: self._by_links(arrow) for name, arrow in self.arrows.items()}
        self.frames = {name: self._by_links(frame) for name, frame in self.frames.items()}
        problems = self.problems()
        if problems and file is None:
            raise DeclarationError(problems)

    def add(self, robot: SerialRobot) -> SerialRobot:
        """Adds a robot and returns it.

        Raises DeclarationError if the name is already in use.
        """
        if robot.name in self.robots:
            raise mismatch(
                robot.name,
                "different names",
                "two robots have the name",
                key=f"robots.{robot.name}",
            )
        self.robots[robot.name] = self._with_defaults(robot)
        if self._finds_floor:
            is_placed = not np.array_equal(robot.base_frame, np.eye(4))
            is_alone = len(self.robots) == 1 and not self.objects and not is_placed
            has_foreign = any(each.is_foreign for each in self.robots.values())
            self.floor = "below" if is_alone or has_foreign else True
        self.robots |= mounted_by_joints(self.robots)
        for group in self.membership.around.get(robot.name, []):  # inner ones first
            if all(name in self.robots for name in self.membership.members[group]):
                self._share_out(self.groups[group])
        return robot

    def _with_defaults(self, robot: SerialRobot) -> SerialRobot:
        own = set(robot.model_fields_set)
        for name in self.membership.around.get(robot.name, []):  # inner ones first
            for key, value in self.groups[name].defaults.items():
                if key not in own:
                    with collect(self._group_problems, f"groups.{name}"):
                        changed = robot.model_copy()
                        setattr(changed, key, value)
                        robot = changed
                    own.add(key)
        return robot

    def _share_out(self, group: Group) -> None:
        robots = [self.robots[name] for name in self.membership.members[group.name]]
        place = f"groups.{group.name}"
        self._group_problems += [
            each.inside(place) for each in group.check_degrees({r.name: r.types for r in robots})
        ]
        for key in SHARED:
            value = getattr(group, key)
            if value is None:
                continue
            place = f"groups.{group.name}.{key}"
            shares = _shares(value, robots)
            if shares is None:
                message = _not_their_sum(value.shape[-1], robots)
                self._group_problems.append(Problem(place, message))
                continue
            for robot, share in zip(robots, shares, strict=True):
                with collect(self._group_problems, f"groups.{group.name}"):
                    changed = self.robots[robot.name].model_copy()
                    setattr(changed, key, share)
                    self.robots[robot.name] = changed

    def _add_double(self, double: Double) -> None:
        robots = self.membership.members.get(double.of)
        if robots is None:
            self.doubles[double.name] = double
            return
        known = [self.robots[name] for name in robots if name in self.robots]
        shares: dict[str, Sequence[Any]] = {}
        for key in ("path", *SHARED):
            value = getattr(double, key)
            if value is None:
                continue
            fitting = _shares(value, known)
            shares[key] = [None] * len(known) if fitting is None else fitting
            if fitting is not None:
                continue
            if len(known) == len(robots):  # Invalid robots are reported elsewhere.
                message = _not_their_sum(value.shape[-1], known)
                self._group_problems.append(Problem(f"doubles.{double.name}.{key}", message))
        names = [f"{double.name}_{robot.name}" for robot in known]
        for i, (name, robot) in enumerate(zip(names, known, strict=True)):
            share: dict[str, Any] = {key: values[i] for key, values in shares.items()}
            self.doubles[name] = double.model_copy(update={"name": name, "of": robot.name, **share})
        self.double_groups[double.name] = names

    def members(self, name: str) -> list[str] | None:
        """Returns the names of the robots in a group, or of the doubles in a double of a group.

        Invalid members are included. Returns None if `name` is neither a group nor such a double.
        """
        return self.membership.members.get(name, self.double_groups.get(name))

    def routed(self, target: str) -> str | None:
        """Returns the origin of the route that sets an input directly or through a group, or None.

        If routes set the input limb by limb, returns a list of their origins as text.
        """
        name, _, key = target.partition(".")
        doubled = [group for group, names in self.double_groups.items() if name in names]
        names = [name, *self.membership.around.get(name, []), *doubled]
        routes = (self.routes.get(f"{each}.{key}") for each in names)
        whole = next((origin for origin in routes if origin is not None), None)
        if whole is not None or not self._has_routes_to_limbs:
            return whole
        double = self.doubles.get(name)
        robot = self.robots.get(name if double is None else double.of)
        limbs = [] if robot is None else [f"{name}.{limb}.{key}" for limb in robot.limb_joints]
        found = [self.routes[limb] for limb in limbs if limb in self.routes]
        return f"[{', '.join(found)}]" if found else None

    @property
    def _has_routes_to_limbs(self) -> bool:
        return any(target.count(".") > 1 for target in self.routes)

    def sources_of(self, *targets: str) -> set[str]:
        """Returns the names of the sources on which inputs depend (default: all routed inputs).

        This includes the sources of other robots if a route uses their outputs (`leader.torques`).
        """
        found: set[str] = set()
        todo = list(targets or self.routes)
        seen = set(todo)
        while todo:
            for name in names_in(self.routed(todo.pop()) or ""):
                source, dot, key = name.partition(".")
                if dot and source in self.sources:
                    found.add(source)
                    continue
                outputs = [name, *(f"{each}.{key}" for each in self.members(source) or [])]
                new = [each for each in outputs if self.routed(each) and each not in seen]
                seen.update(new)
                todo += new
        return found

    def files(self) -> list[Path]:
        models = [robot._model for robot in self.robots.values()]
        tables = [file for robot in self.robots.values() for file, _ in robot._declared]
        tables += [file for group in self.groups.values() for file, _ in group._declared]
        found = [file.absolute() for file in (self.file, *models, *tables) if file is not None]
        return [file for file in dict.fromkeys(found) if file.is_file()]

    def meshes(self) -> list[tuple[str, Path]]:
        """Returns the mesh files of robots and objects, each with the key that declares it."""
        found: list[tuple[str, str, str | None]] = []
        for name, robot in self.robots.items():
            for key, links in (("filenames", robot.filenames), ("collisions", robot.collisions)):
                for i, link in enumerate(links or []):
                    place = f"robots.{name}.{key}.{i}"
                    found += [(place, robot.directory, part.file) for part in link]
            for k, item in enumerate(robot.children):
                found.append((f"robots.{name}.children.{k}.mesh", item.directory, item.mesh))
        for item in self.objects:
            found.append((f"objects.{item.name}.mesh", item.directory, item.mesh))
        return [(key, Path(folder) / file) for key, folder, file in found if file is not None]

    def named_frames(self) -> dict[str, NamedFrame]:
        """Returns the frames to which arrows, received frames and routes can refer, by name."""
        return list_frames(self.robots, self.doubles, self.frames, self.objects)

    def frame_name(self, name: str) -> str:
        """Converts the name of a joint or original link (`icub/l_elbow`) to `icub/link9`."""
        owner, _, label = name.partition("/")
        double = self.doubles.get(owner)
        robot = self.robots.get(owner if double is None else double.of)
        return name if robot is None or not label else f"{owner}/{robot.frame_label(label)}"

    def _by_links(self, entry: _Entry) -> _Entry:
        update = {
            key: self.frame_name(value)
            for key in ("at", "expressed_in", "relative_to")
            if isinstance(value := getattr(entry, key, None), str)
        }
        return entry.model_copy(update=update)

    def problems(self) -> list[Problem]:
        """Returns problems with references between entries, ambiguous names and entry counts."""
        too_many = self._excess or excess({key: getattr(self, key) for key in MOST_ENTRIES})
        if too_many:  # Other checks would take as long as compiling the scene.
            return too_many
        carriers = {carrier(robot) or "" for robot in self.robots.values()}
        broken = {name: self.is_broken(name, ("robots",)) for name in carriers}
        return [
            *self._name_problems(),
            *mount_problems(self.robots, broken),
            *group_problems(
                self.groups, self.membership, [*self.declared("robots"), *self.declared("groups")]
            ),
            *self._group_problems,
            *self._double_problems(),
            *self._frame_problems(),
            *self._view_problems(),
        ]

    def _name_problems(self) -> list[Problem]:
        problems = []
        taken = dict.fromkeys(self.robots, "a robot")
        doubles = dict.fromkeys([*self.doubles, *self.double_groups])
        sections: tuple[tuple[str, Collection[str]], ...] = (
            ("groups", self.groups),
            ("doubles", doubles),
            ("arrows", self.arrows),
            ("frames", self.frames),
        )
        for section, entries in sections:
            for name in entries:
                if name in taken:
                    message = f"{taken[name]} already has this name; expected a different name"
                    problems.append(Problem(f"{section}.{name}", message))
                elif name in ("toggles", WORLD):
                    message = "this name is reserved in routes; expected a different name"
                    problems.append(Problem(f"{section}.{name}", message))
            taken |= dict.fromkeys(entries, f"one of the {section}")
        placed = [*self.frames, *(item.name for item in self.objects), *self.cameras]
        for name in {name for name in placed if placed.count(name) > 1}:
            if name in self.frames or f"{name}.frame" in self.routes:
                message = "two entries have this name, so the route is ambiguous"
                problems.append(Problem(f"routes.{name}.frame", message))
        return problems

    def _frame_problems(self) -> list[Problem]:
        frames = self.named_frames()
        wanted = []
        for name, arrow in self.arrows.items():
            if isinstance(arrow.at, str):
                wanted.append((f"arrows.{name}.at", arrow.at))
            if arrow.expressed_in not in (None, WORLD):
                wanted.append((f"arrows.{name}.expressed_in", arrow.expressed_in))
        wanted += [(f"objects.{o.name}.reaches", o.reaches) for o in self.objects if o.reaches]
        wanted += [
            (f"frames.{name}.relative_to", frame.relative_to)
            for name, frame in self.frames.items()
            if frame.relative_to != WORLD
        ]
        return [
            Problem(key, f"no frame '{name}'{self._which_frame(name, frames)}")
            for key, name in wanted
            if name not in frames and not self.is_broken(name.partition("/")[0])
        ]

    def _view_problems(self) -> list[Problem]:
        view = self.view
        if view.follow is None:
            return []
        if view.camera is not None:
            reason = "follow is only for the free camera, but view.camera names another camera"
            return [Problem("view.follow", f"{reason}. Remove one of the two keys")]
        found = self.follow_problem("view.follow", view.follow)
        return [] if found is None or self.is_broken(view.follow.partition("/")[0]) else [found]

    def follow_problem(self, key: str, name: str) -> Problem | None:
        """Returns a problem if the camera cannot follow `name`, and None otherwise."""
        names = [*self.groups, *self.robots, *self.named_frames()]
        if name in names or self.frame_name(name) in names:
            return None
        return Problem(key, "no robot, group or frame", found=name, available=names)

    def _which_frame(self, name: str, frames: Mapping[str, NamedFrame]) -> str:
        owner, _, label = name.partition("/")
        robot = self.robots.get(owner)
        if robot is None:
            return did_you_mean(name, [*frames, WORLD])
        labels = [each.partition("/")[2] for each in frames if each.startswith(f"{owner}/")]
        own = [*robot.names, *(robot.link_names or [])]
        near = nearest(label, [*(each for each in labels if not each[-1].isdigit()), *own])
        if near is not None:
            return f"; did you mean '{owner}/{near}'?"
        joints = ", ".join(f"{k + 1} {joint}" for k, joint in enumerate(robot.names))
        return f"; available: {owner}/base, {owner}/flange, and {owner}/linkN of joints {joints}"

    def is_broken(self, name: str, sections: Sequence[str] = _WITH_FRAMES) -> bool:
        return bool({*sections, *(f"{section}.{name}" for section in sections)} & self.broken)

    def _double_problems(self) -> list[Problem]:
        problems: list[Problem] = []
        of_group = {each: name for name, names in self.double_groups.items() for each in names}
        for name, double in self.doubles.items():
            if not (self.declares("robots", double.of) or self.declares("groups", double.of)):
                known = [*self.declared("robots"), *self.declared("groups")]
                problems.append(
                    Problem(f"doubles.{name}.of", "no robot", found=double.of, available=known)
                )
            elif double.of in self.robots:
                found = double.check_degrees({double.of: self.robots[double.of].types})
                problems += [each.inside(f"doubles.{of_group.get(name, name)}") for each in found]
                coupled = self.robots[double.of].coupled
                for key in ("joint_angles", "path", *VALUE_INPUTS):
                    value = getattr(double, key)
                    if value is not None and value.shape[-1] not in (coupled.n, coupled.k):
                        message = f"found values of {value.shape[-1]} joints, but {double.of} has "
                        message += str(coupled.n)
                        if coupled.is_coupled:
                            message += f", or {coupled.k} without the coupled joints"
                        problems.append(Problem(f"doubles.{name}.{key}", message))
            lines = double.billboard_lines
            if lines is not None and double.of in self.robots:
                with collect(problems, f"doubles.{name}.billboard_lines"):
                    check_line_values(lines, self.robots[double.of].inputs)
            if double.path is not None and len(double.path) < 2:
                problems.append(Problem(f"doubles.{name}.path", "a path needs two rows or more"))
        return problems

    def declares(self, section: str, name: str) -> bool:
        """Whether a section of the scene declares an entry, valid or invalid."""
        entries: Mapping[str, Any] = getattr(self, section)
        return name in entries or bool({section, f"{section}.{name}"} & self.broken)

    def declared(self, section: str) -> list[str]:
        """Returns the names of all entries of a section (`robots`, ...), including invalid ones."""
        entries: Mapping[str, Any] = getattr(self, section)
        broken = [key.partition(".")[2] for key in self.broken if key.startswith(f"{section}.")]
        return [*entries, *broken]

    @property
    def argument(self) -> str:
        """Name of an included scene, or file, with which commands open the scene."""
        file = self.file
        if file is None:
            files = [robot._model for robot in self.robots.values()]
            file = files[0] if len(files) == 1 else None
        return self.name if file is None else argument_of(file)

    def located(self, problems: list[Problem]) -> list[Problem]:
        """Adds file and line to problems if the scene was read from a file."""
        if self.file is None and self._lines is None:
            return problems
        if self.file is None:  # The scene shows a single robot, which has a file.
            return [self._in_its_model(each, self._lines or {}) for each in problems]
        lines = key_lines(self.file) if self._lines is None else self._lines
        return located((self._in_its_model(each, lines) for each in problems), self.file, lines)

    def _in_its_model(self, problem: Problem, lines: Mapping[str, int]) -> Problem:
        section, _, rest = problem.key.partition(".")
        name, _, key = rest.partition(".")
        robot = self.robots.get(name) if section == "robots" else None
        group = self.groups.get(name) if section == "groups" else None
        declaration = robot or group
        field, _, inner = key.partition(".")
        if problem.file or declaration is None or not key or f"{section}.{name}.{field}" in lines:
            return problem
        child, _, inner = inner.partition(".")
        if robot is not None and field == "children" and child.isdigit():
            declared = robot.children[int(child)]._declared
            if declared is not None:
                return where(replace(problem, key=inner), (declared,))
        places = [place for place in declaration._declared if has_key(place, field)]
        if robot is not None and robot._model is not None and not places:
            places = [(robot._model, "")]
        return where(replace(problem, key=key), tuple(places)) if places else problem


def _shares(value: Array, robots: Sequence[SerialRobot]) -> list[Array] | None:
    """Splits joint values of several robots by robot. Returns None if their number is wrong."""
    for counts in ([robot.n for robot in robots], [robot.coupled.k for robot in robots]):
        if sum(counts) == value.shape[-1]:
            return np.split(value, np.cumsum(counts)[:-1], axis=-1)
    return None


def _not_their_sum(found: int, robots: Sequence[SerialRobot]) -> str:
    total, free = sum(robot.n for robot in robots), sum(robot.coupled.k for robot in robots)
    each = ", ".join(f"{robot.name} {robot.n}" for robot in robots)
    fewer = f", or {free} without the coupled joints" if free < total else ""
    return f"found values of {found} joints; expected {total} ({each}){fewer}"


def _floor_problems(floor: Any) -> list[Problem]:
    if floor in (True, False, "below", None):
        return []
    return [Problem("floor", found=floor, expected="true, false or 'below'")]


def excess(sections: Mapping[str, Any]) -> list[Problem]:
    """Returns a problem for each section of a scene that has too many entries."""
    return [
        Problem(key, found=len(entries), of="entries", expected=f"at most {maximum}")
        for key, maximum in MOST_ENTRIES.items()
        if isinstance(entries := sections.get(key), Sized) and len(entries) > maximum
    ]


def _not_of_type(
    kind: type,
    many: type[Sequence[Any]] | type[Mapping[str, Any]] | None = Sequence,
    **fields: Any,
) -> list[Problem]:
    def is_right(value: Any) -> bool:
        if many is None:
            return isinstance(value, kind)
        entries = value.values() if isinstance(value, Mapping) else value
        return isinstance(value, many) and all(isinstance(entry, kind) for entry in entries)

    starts: dict[Any, str] = {None: "a", Sequence: "a list of", Mapping: "a mapping from names to"}
    expected = f"{starts[many]} {kind.__name__}".removesuffix(" to object")
    return [
        Problem(key, found=value, expected=expected)
        for key, value in fields.items()
        if value is not None and not is_right(value)
    ]
