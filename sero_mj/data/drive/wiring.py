"""Routes from sources, robots and frames to inputs.

route  = target "=" origin
target = name "." input          lwr.joint_angles, contact.vector, toggles.legend; of a group each
                                 robot gets its share of the values, in their order
       | name "." limb "." input icub.left_arm.joint_angles
origin = ["not"] expression      udp.values0, udp.values0[0:7] * deg, leader.torques - lwr.torques;
                                 `not` negates a toggle
       | expression "for" joints udp.values0 for l_elbow, r_arm; several of these with ";" between
       | robot ".gravity_torques", robot ".friction_torques"  by its model, in expressions
       | frame                   lwr/flange: its pose in the world
       | robot ".fwd_kin_base_to_flange"  likewise in the robot's base

`language` has the grammar of expressions, `evaluator` their meaning.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from typing import Any, Self

import numpy as np

from ...base.errors import (
    DeclarationError,
    Problem,
    RouteError,
    UnknownName,
    collect,
    did_you_mean,
    mismatch,
    nearest,
    problems_of,
)
from ...base.frames import Array
from ...robots.declared.cartesian import WORLD
from ...robots.declared.couplings import CoupledJoints
from ...robots.declared.inputs import (
    BLANKABLE,
    PLANAR,
    POSE_NUMBERS,
    ROBOT_INPUTS,
    SCENE,
    Input,
    inputs_of_group,
    list_inputs,
)
from ...robots.declared.mounts import carriers, mount_circles
from ...robots.declared.route_text import NOT, names_in, parts_of_origin
from ...robots.declared.scene import Scene
from ..receive.led_robot import LedJoint, LedLinks
from ..receive.source import SIGNALS, Source, make_source
from .evaluator import condition_of, evaluate
from .joint_routes import (
    JointPart,
    joint_parts,
    named_joints,
    named_twice,
    places_by_name,
    whole_route,
)
from .language import Expression, parse
from .model_torques import MODEL_TORQUES, model_output, origins_of, why_unknown
from .route import FrameRoute, Origin, Route
from .units import UNITS, robot_of, units_of, wrong_unit
from .values import Value, constant, joined, numbers_of

FWD_KIN = "fwd_kin_base_to_flange"
# Readable values of robots, doubles and arrows: their inputs except switches and poses.
_READABLE = ("angles", "values", "vector")


@dataclass
class Wiring:
    """The sources of a scene and the routes from them.

    Attributes:
        later: those among them that need more than one packet, each after its own origins.
        levels: names of bodies placed by frames, each after its dependencies.
    """

    sources: dict[str, Source] = field(default_factory=dict)
    routes: list[Route] = field(default_factory=list)
    later: list[Route] = field(default_factory=list)
    frame_routes: list[FrameRoute] = field(default_factory=list)
    levels: list[list[str]] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)

    def check(self, scene: Scene) -> Self:
        """Returns itself; raises DeclarationError for errors in the scene."""
        if self.problems:
            raise DeclarationError(scene.located(self.problems))
        return self


def wire(scene: Scene) -> Wiring:
    """Builds the scene's sources and checks its routes, without opening anything.

    Routes to invalid robots and sources are not checked, because each mistake is reported only
    once.
    """
    wiring = Wiring()
    for name, declared in scene.sources.items():
        with collect(wiring.problems, f"sources.{name}"):
            wiring.sources[name] = wired_source(scene, name, declared)
    wiring.problems += _shared_places(wiring.sources)
    checker = _RouteChecker(scene, wiring.sources)
    led_by: dict[tuple[str, int], str] = {}  # the entry that leads to a number of an input
    parts: dict[str, list[JointPart]] = {}
    for target, origin in scene.routes.items():
        with collect(wiring.problems, f"routes.{target}"):
            for route in checker.check(target, origin):
                to = route.to.target
                joints = route.joints if isinstance(route, JointPart) else range(route.to.count)
                before = [joint for joint in joints if (to, joint) in led_by]
                if before:
                    raise DeclarationError([_led_twice(scene, route, before[0], led_by)])
                led_by |= dict.fromkeys([(to, joint) for joint in joints], target)
                if isinstance(route, JointPart):
                    parts.setdefault(to, []).append(route)
                elif isinstance(route, Route):
                    wiring.routes.append(route)
                else:
                    wiring.frame_routes.append(route)
    wiring.routes += [whole_route(scene, each) for each in parts.values()]
    _allow_blanks(wiring)
    _limit_numbers(wiring)
    try:
        wiring.later = _routes_in_order(scene, wiring.routes)
    except CycleError as error:
        wiring.problems.append(_circle("values", error))
    try:
        wiring.levels = _levels_of_frames(scene, wiring.frame_routes)
    except CycleError as error:
        wiring.problems.append(_circle("frames", error))
    return wiring


def wired_source(scene: Scene, name: str, declared: Mapping[str, Any] | Source) -> Source:
    """Builds a source of a scene, which is told the joints that its routes lead to.

    Raises:
        DeclarationError: as `make_source`.
    """
    source = make_source(name, declared)
    source.led_to(_joints_led_to(scene, name))
    if (links := _links_led_to(scene, name)) is not None:
        source.led_to_links(links)
    return source


def _links_led_to(scene: Scene, source: str) -> LedLinks | None:
    for target, origin in scene.routes.items():
        name, _, key = target.partition(".")
        robot = scene.robots.get(name)
        if robot is None or key not in ("joint_angles", "base_frame"):
            continue
        if any(each.partition(".")[0] == source for each in names_in(origin)):
            joints, positions = robot.coupled.independent, robot.coupled.positions
            home, poses = robot.home[joints], robot.link_poses
            return LedLinks(robot.kinematics, joints, positions, home, poses, robot.base_frame)
    return None


def _joints_led_to(scene: Scene, source: str) -> list[LedJoint]:
    inputs = list_inputs(scene)
    for target, origin in scene.routes.items():
        if not any(name.partition(".")[0] == source for name in names_in(origin)):
            continue
        owner, _, key = target.partition(".")
        members = scene.members(owner) or [owner]
        items = [inputs.get(f"{name}.{key}") for name in members]
        joints = [
            LedJoint(robot.names[k], float(robot.home[k]), float(robot.torque_bounds[k]))
            for item in items
            if item is not None and item.kind in ("angles", "values")
            for robot in (robot_of(scene, item),)
            for k in robot.coupled.independent
        ]
        if joints and None not in items:
            return joints
    return []


def _led_twice(
    scene: Scene,
    route: Route | FrameRoute | JointPart,
    joint: int,
    led_by: Mapping[tuple[str, int], str],
) -> Problem:
    first = led_by[route.to.target, joint]
    if not isinstance(route, JointPart):
        return Problem("", f"{route.to.target} has a route already, {first}; remove one of them")
    name = robot_of(scene, route.to).names[joint]
    message = f"{name} gets its {route.to.key} by {first} already; expected each joint once"
    return Problem("", message)


def _shared_places(sources: Mapping[str, Source]) -> list[Problem]:
    problems = []
    taken: dict[tuple[str, int], str] = {}
    for name, source in sources.items():
        place = source.place
        if place is None or place[1] == 0:  # no port, or one chosen by the system
            continue
        if place in taken:
            message = f"{place[1]} on {place[0]} is the port of source '{taken[place]}' already"
            problems.append(Problem(f"sources.{name}.port", message))
        taken.setdefault(place, name)
    return problems


def _allow_blanks(wiring: Wiring) -> None:
    """Allows NaN in events that move nothing, directly or through other routes."""
    routes = {route.to.target: route for route in wiring.routes}
    todo = [target for target, route in routes.items() if route.to.kind not in BLANKABLE]
    moving: dict[str, Route] = {}  # routes to inputs that move something, and to their origins
    while todo:
        target = todo.pop()
        if target in routes and target not in moving:
            moving[target] = routes[target]
            todo += routes[target].outputs
    finite = {origin for route in moving.values() for origin in route.value.origins}
    for name, source in wiring.sources.items():
        # NaN in unused events is harmless, and many events may be unused.
        source.allow_nan({e for e in source.events if Origin(name, e, True) not in finite})


def _limit_numbers(wiring: Wiring) -> None:
    for name, source in wiring.sources.items():
        limits: dict[str, Array] = {}
        routed = (
            (route.to.limits.ravel(), route.value.terms)
            for route in wiring.routes
            if route.to.kind != "toggle"  # any number is off or on, and conditions have several
        )
        for largest, term in ((largest, term) for largest, terms in routed for term in terms):
            key = term.origin.key
            if not term.origin.is_event or term.origin.name != name or key not in source.events:
                continue
            numbers = limits.setdefault(key, np.full(int(np.prod(source.events[key])), np.inf))
            with np.errstate(divide="ignore"):  # by a factor of 0
                np.minimum.at(numbers, term.take, largest[term.at] / np.abs(term.times))
        source.limit({key: each for key, each in limits.items() if np.isfinite(each).any()})


def _routes_in_order(scene: Scene, routes: Sequence[Route]) -> list[Route]:
    """The routes that need more than one packet, each after the routes to its origins."""
    later = {route.to.target: route for route in routes if route.direct is None}
    inputs = list_inputs(scene)

    def needs(output: str) -> list[str]:
        if output in inputs:
            return [output]
        name, _, key = output.partition(".")
        return origins_of(scene.robots, name, key)

    after = {
        target: {*later} & {each for output in route.outputs for each in needs(output)}
        for target, route in later.items()
    }
    return [later[target] for target in TopologicalSorter(after).static_order()]


def _levels_of_frames(scene: Scene, routes: Sequence[FrameRoute]) -> list[list[str]]:
    """Bodies placed by frames, each after those that it follows."""
    frames = scene.named_frames()
    after: dict[str, set[str]] = {
        name: {double.of} for name, double in scene.doubles.items() if name not in scene.robots
    }
    if not mount_circles(scene.robots):  # reported elsewhere
        after |= {name: {*carriers(scene.robots, name)} for name in scene.robots}
    placed = set()
    for route in routes:
        mover = route.frame if route.is_fwd_kin else frames[route.frame].moves_with
        if route.to.key != "flange_check":  # it moves nothing
            after.setdefault(route.to.name, set()).add(mover)
            placed.add(route.to.name)
    for name, received in scene.frames.items():
        if received.relative_to in frames:
            after.setdefault(name, set()).add(frames[received.relative_to].moves_with)
            placed.add(name)
    sorter = TopologicalSorter(after)
    sorter.prepare()
    levels = []
    while sorter.is_active():
        ready = sorter.get_ready()
        sorter.done(*ready)
        level = [name for name in ready if name in placed]
        if level:
            levels.append(level)
    return levels


def _circle(what: str, error: CycleError) -> Problem:
    names = list(reversed(error.args[1]))[:-1]
    first = names.index(min(names))  # the first one found is random
    circle = " -> ".join([*names[first:], *names[:first], names[first]])
    return Problem("routes", f"{what} that follow each other: {circle}")


class _RouteChecker:
    def __init__(self, scene: Scene, sources: Mapping[str, Source]) -> None:
        self._scene, self._sources = scene, sources
        self._inputs = list_inputs(scene)
        self._frames = scene.named_frames()
        self._outputs = {key: item for key, item in self._inputs.items() if item.kind in _READABLE}
        self._owners = {item.name for item in self._outputs.values()}
        self._events: dict[Origin, Value] = {}  # cached: an event may have 65,000 numbers

    def check(self, target: str, origin: str) -> list[Route | FrameRoute | JointPart]:
        """Returns the routes of an entry; empty if its error is reported elsewhere."""
        name, _, key = target.partition(".")
        limb, dot, of_limb = key.partition(".")
        dot = "" if f"{name}.{limb}" in self._inputs else dot  # lwr.torques.0 is not a limb
        parts = parts_of_origin(origin)
        if dot or parts[0][1] is not None:
            if dot and parts[0][1] is not None:
                raise mismatch(limb, f"them for {name}.{of_limb}", "found joints for the limb")
            if dot:
                key, parts = of_limb, [(origin, [limb])]
            return self._parts(name, key, parts)
        members = self._scene.members(name)
        if members is None:
            return [*self._check([self._input(target)], origin, target)]
        if any(each not in {*self._scene.robots, *self._scene.doubles} for each in members):
            return []  # declared wrongly, or missing
        return [*self._check(self._group_inputs(name, key, members), origin, target)]

    def _parts(
        self, name: str, key: str, parts: Sequence[tuple[str, list[str] | None]]
    ) -> list[Route | FrameRoute | JointPart]:
        scene, target, members = self._scene, f"{name}.{key}", self._scene.members(name)
        found: Sequence[Input | Problem | None] = [self._input(target)]
        if members is not None:
            if any(each not in {*scene.robots, *scene.doubles} for each in members):
                return []
            found = self._group_inputs(name, key, members)
        problems = [item for item in found if isinstance(item, Problem)]
        inputs = [item for item in found if isinstance(item, Input)]
        if inputs and inputs[0].kind not in ("angles", "values"):
            message = f"joints are for what has one value per joint; {target} takes"
            problems.append(Problem("", f"{message} {inputs[0].meaning}"))
        if problems or not inputs:
            raise DeclarationError(problems)
        places = places_by_name(scene, inputs, in_group=members is not None)
        joints = [named_joints(scene, name, places, names, problems) for _, names in parts]
        problems += named_twice(scene, [joint for each in joints for joint in each])
        made: list[Route | FrameRoute | JointPart] = []
        for (origin, _), places_of_origin in zip(parts, joints, strict=True):
            with collect(problems, ""):
                value = self._value(origin)
                if value is not None and not problems:
                    made += joint_parts(scene, *value, places_of_origin, target)
        if problems:
            raise DeclarationError(problems)
        return made

    def _value(self, origin: str) -> tuple[Value, str] | None:
        try:
            expression = parse(origin)
        except RouteError as error:
            raise Problem("", str(error)).error() from None
        if expression.negated or expression.is_condition:
            found = f"'{NOT}' is" if expression.negated else "comparisons are"
            message = f"{found} for switches; joints take numbers"
            raise Problem("", message).error()
        return self._evaluated(expression, [])

    def _evaluated(
        self, expression: Expression, problems: list[Problem]
    ) -> tuple[Value, str] | None:
        known = self._known(expression, problems)
        if known is None:
            return None
        text = expression.text.strip()
        text = text.removeprefix(NOT).lstrip() if expression.negated else text
        try:
            return evaluate(expression, known), text
        except RouteError as error:
            raise Problem("", str(error)).error() from None

    def _known(
        self, expression: Expression, problems: Sequence[Problem]
    ) -> dict[str, Value] | None:
        found = {name: self._find(name) for name in names_in(expression.text)}
        problems = [*problems, *(v for v in found.values() if isinstance(v, Problem))]
        if problems:
            raise DeclarationError(problems)
        known = {name: value for name, value in found.items() if isinstance(value, Value)}
        return known if len(known) == len(found) else None

    def _group_inputs(
        self, group: str, key: str, members: Sequence[str]
    ) -> list[Input | Problem | None]:
        try:
            return list(inputs_of_group(self._inputs, group, key, members))
        except UnknownName as error:
            of, known = f"of {group}", error.available
            return [Problem("", "no input", found=key, of=of, available=known)]
        except ValueError as error:
            return [*problems_of(error)]

    def _check(
        self, items: Sequence[Input | Problem | None], origin: str, target: str
    ) -> list[Route | FrameRoute]:
        problems = [item for item in items if isinstance(item, Problem)]
        inputs = [item for item in items if isinstance(item, Input)]
        item = items[0]
        try:
            expression = parse(origin)
        except RouteError as error:
            raise DeclarationError([*problems, Problem("", str(error))]) from None
        if isinstance(item, Input) and expression.negated and item.kind != "toggle":
            problems.append(Problem("", f"'{NOT}' is for switches; {target} takes {item.meaning}"))
        frame = expression.name
        if frame is not None and self._is_frame(frame):
            route = self._frame_route(problems, item, frame)
            if problems:
                raise DeclarationError(problems)
            return [] if route is None else [route]
        if expression.is_condition:
            return self._switches(inputs, expression, problems, target)
        found = self._evaluated(expression, problems)
        if found is None or len(inputs) < len(items):
            return []
        value, text = found
        shares = [value] * len(inputs)
        if len(inputs) > 1 and inputs[0].kind in ("angles", "values"):
            shares = _shares(value, inputs, text, target)
        routes: list[Route | FrameRoute] = []
        first = 0  # index of a share's first number
        for each, share in zip(inputs, shares, strict=True):
            item = self._as_numbers(each, share)
            full, numbers = share, np.arange(share.entries.size)
            if item.coupled is not None and share.shape and share.entries.size == item.coupled.k:
                full, numbers = _with_coupled(share, item, item.coupled), item.coupled.source
            units = units_of(self._scene, item)
            message = _wrong_shape(full, item) or wrong_unit(full.units, units, item.target)
            if message:
                raise Problem("", f"{text} {message}").error()
            numbers = np.broadcast_to(first + numbers, item.count)
            compiled = full.compile(item.count)
            routes.append(Route(item, text, compiled, expression.negated, tuple(numbers.tolist())))
            if len(inputs) > 1 and share is not value:
                first += share.entries.size
        return routes

    def _as_numbers(self, item: Input, value: Value) -> Input:
        """The input as numbers, if a pose gets these in the place of a matrix."""
        count, robot = value.entries.size, self._scene.robots.get(item.name)
        is_planar = robot is not None and robot.free_base == "planar" and item.kind == "pose"
        fits = count == len(POSE_NUMBERS) or (count == len(PLANAR) and is_planar)
        if not item.is_pose or value.is_frames or len(value.shape) != 1 or not fits:
            return item
        return replace(item, shape=(count,))

    def _switches(
        self,
        items: Sequence[Input],
        expression: Expression,
        problems: list[Problem],
        target: str,
    ) -> list[Route | FrameRoute]:
        if items and items[0].kind != "toggle":
            message = f"comparisons are for switches; {target} takes {items[0].meaning}"
            problems = [*problems, Problem("", message)]
        names = self._known(expression, problems)
        if names is None:
            return []
        try:
            value, condition = condition_of(expression, names)
        except RouteError as error:
            raise Problem("", str(error)).error() from None
        compiled, text = value.compile(value.entries.size), expression.text.strip()
        return [Route(item, text, compiled, condition=condition) for item in items]

    def _input(self, target: str) -> Input | Problem | None:
        if target in self._inputs:
            return self._inputs[target]
        scene, (name, _, key) = self._scene, target.partition(".")
        keys = [item.key for item in self._inputs.values() if item.name == name]
        if scene.is_broken(name) or scene.is_broken(name, ("groups",)):
            near = nearest(key, ROBOT_INPUTS)  # maybe one of its own inputs
            mistyped = near is not None and key not in ROBOT_INPUTS
            message = f"no input '{key}' of {name}; did you mean '{near}'?"
            moves = {f"robots.{name}", f"groups.{name}"} & scene.broken
            return Problem("", message) if mistyped and moves else None
        double, robot = scene.doubles.get(name), scene.robots.get(name)
        message = ""
        if double is not None and double.path is not None and key != "visible":
            message = f"'{name}' shows a path; nothing can be routed to it"
        if robot is not None and robot.mount is not None and key == "base_frame":
            message = f"{name} is mounted on {robot.mount}, which moves its base"
            message += "; remove this route, or the mount"
        if message:
            return Problem("", message)
        if keys and (double is None or double.of in scene.robots):
            return Problem("", "no input", found=key, of=f"of {name}", available=keys)
        if double is not None:
            return None
        names = [item.name for item in self._inputs.values() if item.name != SCENE]
        names += [*scene.declared("groups"), *scene.double_groups]
        return Problem(
            "", "no robot", found=name, available=dict.fromkeys([*scene.declared("robots"), *names])
        )

    def _is_frame(self, name: str) -> bool:
        return "/" in name or name in self._frames or self._is_fwd_kin(name)

    def _is_fwd_kin(self, name: str) -> bool:
        robot, _, key = name.partition(".")
        return key == FWD_KIN and robot in self._scene.robots and robot not in self._scene.sources

    def _no_frame(self, name: str) -> Problem | None:
        if self._scene.is_broken(name.partition("/")[0]):
            return None
        events = [f"{n}.{event}" for n, source in self._sources.items() for event in source.events]
        spaces = _missing_spaces(name, [*UNITS, *self._outputs, *events])
        return Problem("", f"no frame '{name}'{spaces or did_you_mean(name, self._frames)}")

    def _frame_route(
        self, problems: list[Problem], item: Input | Problem | None, name: str
    ) -> FrameRoute | None:
        is_fwd_kin = self._is_fwd_kin(name)
        given, name = name, self._scene.frame_name(name)
        if not is_fwd_kin and name not in self._frames:
            if (problem := self._no_frame(given)) is not None:
                problems.append(problem)
            return None
        if not isinstance(item, Input):
            return None
        received = self._scene.frames.get(item.name)
        if received is not None and received.relative_to != WORLD and not is_fwd_kin:
            fix = f"set relative_to of {received.name} to 'world'"
            problems.append(Problem("", f"{given} is a pose in the world; {fix}"))
        if item.shape != (4, 4):
            message = f"{given} is a 4 x 4 frame; {item.target} takes {item.meaning}"
            problems.append(Problem("", message))
        return FrameRoute(item, name.partition(".")[0] if is_fwd_kin else name, is_fwd_kin)

    def _find(self, name: str) -> Value | Problem | None:
        if name in UNITS:
            return constant(*UNITS[name])
        return self._no_number(name) if self._is_frame(name) else self._numbers(name)

    def _no_number(self, name: str) -> Problem | None:
        message = f"{name} is a 4 x 4 frame, which cannot be indexed or combined"
        is_known = self._scene.frame_name(name) in self._frames or self._is_fwd_kin(name)
        return Problem("", message) if is_known else self._no_frame(name)

    def _numbers(self, name: str) -> Value | Problem | None:
        owner, _, key = name.partition(".")
        if self._scene.declares("sources", owner):
            return self._event(owner, key)
        members = self._scene.members(owner)
        if members is not None:
            return self._group_output(members, key)
        if owner in self._owners or owner in self._scene.robots:
            return self._output(owner, key)
        if self._scene.is_broken(owner, ("robots", "doubles", "arrows", "groups")):
            return None
        return Problem("", f"no {self._unknown(owner, is_bare=not key)}")

    def _event(self, name: str, event: str) -> Value | Problem | None:
        if name not in self._sources:
            return None
        events = {**self._sources[name].events, **SIGNALS}
        if self._sources[name].needs_joints(event):
            if self._scene.broken:  # a robot, reported elsewhere
                return None
            reason = f"joints of {name} are not known: no route leads it to all joints of a robot"
            return Problem("", reason, expected=f"sources.{name}.joints, their names")
        if event not in events:
            hint, of = _missing_spaces(event, events), f"of {name}"
            if hint:
                return Problem("", f"no event '{event}' {of}{hint}")
            return Problem("", "no event", found=event, of=of, available=events)
        origin = Origin(name, event, True)
        if origin not in self._events:
            self._events[origin] = numbers_of(origin, tuple(events[event]))
        return self._events[origin]

    def _output(self, name: str, key: str) -> Value | Problem:
        item = self._outputs.get(f"{name}.{key}")
        if item is not None:
            return numbers_of(Origin(name, key, False), item.shape, units_of(self._scene, item))
        keys = [item.key for item in self._outputs.values() if item.name == name]
        robots = self._scene.robots
        if name in robots:
            if key in MODEL_TORQUES:
                if why := why_unknown(robots, name, key):
                    return Problem("", f"no output '{key}' of {name}: {why}")
                item = model_output(robots[name], key)
                units = units_of(self._scene, item)
                return numbers_of(Origin(name, key, False), item.shape, units)
            keys += MODEL_TORQUES
        hint = _missing_spaces(key, keys)
        if not hint and name in self._scene.robots:
            hint = did_you_mean(key, [*keys, FWD_KIN])
            if nearest(key, [*keys, FWD_KIN]) is None:
                hint += f"; its frames are {name}/flange and so on"
        return Problem("", f"no output '{key}' of {name}{hint or did_you_mean(key, keys)}")

    def _group_output(self, members: Sequence[str], key: str) -> Value | Problem | None:
        found = []
        for name in members:
            if name not in self._owners:
                return None  # declared wrongly, or missing, which is reported elsewhere
            value = self._output(name, key)
            if isinstance(value, Problem):
                return value
            found.append(value)
        return joined(found)

    def _unknown(self, owner: str, *, is_bare: bool) -> str:
        sources = self._scene.declared("sources")
        if nearest(owner, sources) is None:
            near = nearest(owner, self._owners)
            if near is not None:
                return f"source or robot '{owner}'; did you mean '{near}'?"
            near = nearest(owner, UNITS) if is_bare else None
            if near is not None:
                return f"unit '{owner}'; did you mean '{near}'?"
        return f"source '{owner}'{did_you_mean(owner, sources)}"


def _shares(value: Value, items: Sequence[Input], text: str, target: str) -> list[Value]:
    if value.is_constant and not value.shape:
        return [value] * len(items)  # one number for all
    full = [item.count for item in items]
    free = [item.count if item.coupled is None else item.coupled.k for item in items]
    found = value.entries.size
    counts = free if found == sum(free) else full
    if found != sum(counts) or value.is_frames:
        many = "1 value" if found == 1 else f"{found} values"
        each = ", ".join(f"{item.name} {item.count}" for item in items)
        fewer = f", or {sum(free)} without the coupled joints" if free != full else ""
        message = f"{text} has {many}; {target} takes {sum(full)}: {each}{fewer}"
        raise Problem("", message).error()
    return value.split(counts)


def _with_coupled(value: Value, item: Input, coupled: CoupledJoints) -> Value:
    factors, constants = coupled.factors(item.key), coupled.constants(item.key)
    return value.gather(coupled.source, factors, constants)


def _wrong_shape(value: Value, item: Input) -> str:
    count, shape = value.entries.size, value.shape
    many = "1 value" if count == 1 else f"{count} values"
    if item.shape == (4, 4):
        if value.is_frames and count == 16:
            return ""
        found = f"has {many}" if len(shape) < 2 else f"is {' x '.join(map(str, shape))}"
        numbers = f"{len(POSE_NUMBERS)} numbers {', '.join(POSE_NUMBERS)}"
        takes = f"{item.meaning}, 1M in the structure, or {numbers}"
        return f"{found}; {item.target} takes {takes}"
    if value.is_constant and not shape:
        return ""  # one number for all
    if count != item.count:
        return f"has {many}; {item.target} takes {item.meaning}"
    return f"is a 4 x 4 frame; {item.target} takes {item.meaning}" if value.is_frames else ""


def _missing_spaces(name: str, known: Iterable[str]) -> str:
    """Advice if a known name touches an operator that is also allowed in names."""
    for i, sign in enumerate(name):
        if sign in "-/" and name[:i] in known:
            return f"; put spaces about '{sign}'"
    return ""
