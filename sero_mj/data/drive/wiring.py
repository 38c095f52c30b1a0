"""Builds the sources of a scene, and checks its routes.

route  = target "=" origin
target = name "." input          lwr.joint_angles, contact.vector, toggles.legend; values for
                                 a group are split between its robots, in order
       | name "." limb "." input icub.left_arm.joint_angles
origin = ["not"] expression      udp.values0, udp.values0[0:7] * deg, leader.torques - lwr.torques;
                                 `not` negates a toggle
       | expression "for" joints udp.values0 for l_elbow, r_arm; several of these, separated by ";"
       | robot ".gravity_torques", robot ".friction_torques"  by its model, in expressions
       | frame                   lwr/flange: its pose in the world
       | robot ".fwd_kin_base_to_flange"  its pose in the robot's base

`language` defines the grammar of expressions, and `evaluator` computes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from typing import Any, Self

import numpy as np

from ...base.errors import (
    DeclarationError,
    Problem,
    SeroError,
    collect,
)
from ...base.frames import Array
from ...robots.declared.inputs import (
    BLANKABLE,
    list_inputs,
)
from ...robots.declared.mounts import carriers, mount_circles
from ...robots.declared.route_text import names_in
from ...robots.declared.scene import Scene
from ..receive.source import RoutedJoint, RoutedLinks, Source, make_source
from .joint_routes import (
    JointPart,
    whole_route,
)
from .model_torques import origins_of
from .route import FrameRoute, Origin, Route
from .route_checker import RouteChecker
from .units import robot_of


@dataclass
class Wiring:
    """The sources of a scene and its checked routes.

    Attributes:
        later: routes that depend on several sources or on outputs of robots. They are sorted: if a
            route reads an input, the route that sets this input comes first.
        levels: names of the elements that frames move, grouped in levels. The poses in a level
            depend only on the poses in earlier levels.
    """

    sources: dict[str, Source] = field(default_factory=dict)
    routes: list[Route] = field(default_factory=list)
    later: list[Route] = field(default_factory=list)
    frame_routes: list[FrameRoute] = field(default_factory=list)
    levels: list[list[str]] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)

    def check(self, scene: Scene) -> Self:
        """Returns itself; raises DeclarationError if there are problems."""
        if self.problems:
            raise DeclarationError(scene.located(self.problems))
        return self


def wire(scene: Scene) -> Wiring:
    """Builds the sources of a scene and checks its routes, without opening the sources.

    Routes of invalid robots and sources are not checked, because their errors are already known.
    """
    wiring = Wiring()
    for name, declared in scene.sources.items():
        with collect(wiring.problems, f"sources.{name}"):
            wiring.sources[name] = wired_source(scene, name, declared)
    wiring.problems += _shared_places(wiring.sources)
    checker = RouteChecker(scene, wiring.sources)
    routed_by: dict[tuple[str, int], str] = {}  # target of the route of each number of an input
    parts: dict[str, list[JointPart]] = {}
    for target, origin in scene.routes.items():
        with collect(wiring.problems, f"routes.{target}"):
            for route in checker.check(target, origin):
                to = route.to.target
                joints = route.joints if isinstance(route, JointPart) else range(route.to.count)
                taken = [joint for joint in joints if (to, joint) in routed_by]
                if taken:
                    raise DeclarationError([_duplicate_route(scene, route, taken[0], routed_by)])
                routed_by |= dict.fromkeys([(to, joint) for joint in joints], target)
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
    """Builds a source of a scene, with the joints that it moves; raises DeclarationError."""
    source = make_source(name, declared)
    source.set_joints(_joints_of_source(scene, name))
    if (links := _routed_links(scene, name)) is not None:
        source.set_links(links)
    return source


def topics_of(scene: Scene) -> dict[str, Source]:
    """Returns `Source.of_messages` by source name, for valid sources that receive messages."""
    found: dict[str, Source] = {}
    for name, declared in scene.sources.items():
        with suppress(SeroError):
            source = wired_source(scene, name, declared).of_messages
            if source is not None:
                found[name] = source
    return found


def _routed_links(scene: Scene, source: str) -> RoutedLinks | None:
    for target, origin in scene.routes.items():
        name, _, key = target.partition(".")
        robot = scene.robots.get(name)
        if robot is None or key not in ("joint_angles", "base_frame"):
            continue
        if any(each.partition(".")[0] == source for each in names_in(origin)):
            joints, positions = robot.coupled.independent, robot.coupled.positions
            home, poses = robot.home[joints], robot.link_poses
            return RoutedLinks(robot.kinematics, joints, positions, home, poses, robot.base_frame)
    return None


def _joints_of_source(scene: Scene, source: str) -> list[RoutedJoint]:
    inputs = list_inputs(scene)
    for target, origin in scene.routes.items():
        if not any(name.partition(".")[0] == source for name in names_in(origin)):
            continue
        owner, _, key = target.partition(".")
        members = scene.members(owner) or [owner]
        items = [inputs.get(f"{name}.{key}") for name in members]
        joints = [
            RoutedJoint(robot.names[k], float(robot.home[k]), float(robot.torque_bounds[k]))
            for item in items
            if item is not None and item.kind in ("angles", "values")
            for robot in (robot_of(scene, item),)
            for k in robot.coupled.independent
        ]
        if joints and None not in items:
            return joints
    return []


def _duplicate_route(
    scene: Scene,
    route: Route | FrameRoute | JointPart,
    joint: int,
    routed_by: Mapping[tuple[str, int], str],
) -> Problem:
    first = routed_by[route.to.target, joint]
    if not isinstance(route, JointPart):
        return Problem("", f"{route.to.target} already has the route {first}. Remove one of them")
    name = robot_of(scene, route.to).names[joint]
    message = f"route {first} already sets {route.to.key} of {name}; expected one route per joint"
    return Problem("", message)


def _shared_places(sources: Mapping[str, Source]) -> list[Problem]:
    problems = []
    taken: dict[tuple[str, int], str] = {}
    for name, source in sources.items():
        place = source.place
        if place is None or place[1] == 0:  # no port, or a port chosen by the system
            continue
        if place in taken:
            message = f"source '{taken[place]}' already has the port {place[1]} on {place[0]}"
            problems.append(Problem(f"sources.{name}.port", message))
        taken.setdefault(place, name)
    return problems


def _allow_blanks(wiring: Wiring) -> None:
    routes = {route.to.target: route for route in wiring.routes}
    todo = [target for target, route in routes.items() if route.to.kind not in BLANKABLE]
    # NaN is allowed in events that do not move anything, directly or through other routes.
    moving: dict[str, Route] = {}
    while todo:
        target = todo.pop()
        if target in routes and target not in moving:
            moving[target] = routes[target]
            todo += routes[target].outputs
    finite = {origin for route in moving.values() for origin in route.value.origins}
    for name, source in wiring.sources.items():
        # Unused events may have NaN.
        source.allow_nan({e for e in source.events if Origin(name, e, True) not in finite})


def _limit_numbers(wiring: Wiring) -> None:
    for name, source in wiring.sources.items():
        limits: dict[str, Array] = {}
        routed = (
            (route.to.limits.ravel(), route.value.terms)
            for route in wiring.routes
            if route.to.kind != "toggle"  # any number is off or on
        )
        for largest, term in ((largest, term) for largest, terms in routed for term in terms):
            key = term.origin.key
            if not term.origin.is_event or term.origin.name != name or key not in source.events:
                continue
            numbers = limits.setdefault(key, np.full(int(np.prod(source.events[key])), np.inf))
            with np.errstate(divide="ignore"):  # factors may be 0
                np.minimum.at(numbers, term.take, largest[term.at] / np.abs(term.times))
        source.limit({key: each for key, each in limits.items() if np.isfinite(each).any()})


def _routes_in_order(scene: Scene, routes: Sequence[Route]) -> list[Route]:
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
    frames = scene.named_frames()
    after: dict[str, set[str]] = {
        name: {double.of} for name, double in scene.doubles.items() if name not in scene.robots
    }
    if not mount_circles(scene.robots):  # reported elsewhere
        after |= {name: {*carriers(scene.robots, name)} for name in scene.robots}
    placed = set()
    for route in routes:
        mover = route.frame if route.is_fwd_kin else frames[route.frame].moves_with
        if route.to.key != "flange_check":  # a check moves nothing
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
    first = names.index(min(names))  # the order of the error is random
    circle = " -> ".join([*names[first:], *names[:first], names[first]])
    return Problem("routes", f"{what} that depend on each other: {circle}")
