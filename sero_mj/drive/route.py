"""Routes: which event of which source, or which frame, goes to which input of which robot.

route  = target "=" origin
target = name "." input                   lwr.joint_angles, contact.vector, toggles.legend
origin = ["not"] source "." event         udp.values0; `not` turns a switch round
| frame                            lwr/flange: its pose in the world
| robot ".fwd_kin_base_to_flange"  likewise in the robot's base
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

from ..assemble.inputs import BLANKABLE, ROBOT_INPUTS, SCENE, Input, list_inputs
from ..assemble.named_frames import WORLD
from ..assemble.scene import Scene
from ..errors import DeclarationError, Problem, did_you_mean, nearest
from ..receive.fri import FriReceiver
from ..receive.kinds import make_source
from ..receive.source import Source

FWD_KIN = "fwd_kin_base_to_flange"
_NOT = "not "


@dataclass(frozen=True)
class Route:
    """One checked route from a source.

    Attributes:
        to: the input it leads to.
        source: the source's name.
        event: the source's event.
        negated: whether a switch is turned round.
    """

    to: Input
    source: str
    event: str
    negated: bool = False


@dataclass(frozen=True)
class FrameRoute:
    """One checked route from a frame.

    Attributes:
        to: the input it leads to.
        frame: name of the frame, or of the robot whose `fwd_kin_base_to_flange` it is.
        is_fwd_kin: which of the two.
    """

    to: Input
    frame: str
    is_fwd_kin: bool = False


@dataclass
class Wiring:
    """The sources of a scene and the routes from them.

    Attributes:
        sources: by name, not yet opened.
        routes: those from sources that are right.
        frame_routes: those from frames that are right.
        levels: names of what frames place, each after what it depends on.
        problems: what is wrong with the others.
    """

    sources: dict[str, Source] = field(default_factory=dict)
    routes: list[Route] = field(default_factory=list)
    frame_routes: list[FrameRoute] = field(default_factory=list)
    levels: list[list[str]] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)


def wire(scene: Scene) -> Wiring:
    """Builds the scene's sources and checks its routes, without opening anything.

    Routes to robots and sources that are themselves declared wrongly are left unchecked: one
    report of one mistake is enough.
    """
    wiring = Wiring()
    for name, declared in scene.sources.items():
        try:
            wiring.sources[name] = make_source(name, declared)
        except DeclarationError as error:
            wiring.problems += [p.inside(f"sources.{name}") for p in error.problems]
    wiring.problems += _shared_places(wiring.sources)
    inputs = list_inputs(scene)
    for target, origin in scene.routes.items():
        try:
            item = _input(scene, inputs, target)
            route = _route(scene, wiring.sources, item, target, origin)
        except DeclarationError as error:
            wiring.problems += [p.inside(f"routes.{target}") for p in error.problems]
            continue
        if isinstance(route, Route):
            wiring.routes.append(route)
        elif route is not None:
            wiring.frame_routes.append(route)
    _allow_blanks(wiring)
    wiring.levels = _levels(scene, wiring)
    return wiring


def _shared_places(sources: Mapping[str, Source]) -> list[Problem]:
    """Ports that two sources of one scene would listen on."""
    problems = []
    taken: dict[tuple[str, int], str] = {}
    for name, source in sources.items():
        place = getattr(source, "place", None)
        if place is None or place[1] == 0:  # no port, or one that the system chooses
            continue
        if place in taken:
            message = f"{place[1]} on {place[0]} is the port of source '{taken[place]}' already"
            problems.append(Problem(f"sources.{name}.port", message))
        taken.setdefault(place, name)
    return problems


def _input(scene: Scene, inputs: Mapping[str, Input], target: str) -> Input | Problem | None:
    """The input that a route leads to, what is wrong with it, or None where that is known."""
    if target in inputs:
        return inputs[target]
    name, _, key = target.partition(".")
    keys = [item.key for item in inputs.values() if item.name == name]
    if scene.is_broken(name):
        near = nearest(key, ROBOT_INPUTS)  # one of its own inputs may be meant
        mistyped = near is not None and f"robots.{name}" in scene.broken and key not in ROBOT_INPUTS
        return (
            Problem("", f"no input '{key}' of {name}; did you mean '{near}'?") if mistyped else None
        )
    double = scene.doubles.get(name)
    if double is not None and double.path is not None and key != "visible":
        return Problem("", f"'{name}' shows a path; nothing can be routed to it")
    if keys and (double is None or double.of in scene.robots):
        return Problem("", f"no input '{key}' of {name}{did_you_mean(key, keys)}")
    if double is not None:
        return None
    names = [item.name for item in inputs.values() if item.name != SCENE]
    near = did_you_mean(name, dict.fromkeys([*scene.declared("robots"), *names]))
    return Problem("", f"no robot '{name}'{near}")


def _route(
    scene: Scene,
    sources: Mapping[str, Source],
    item: Input | Problem | None,
    target: str,
    origin: str,
) -> Route | FrameRoute | None:
    problems = [item] if isinstance(item, Problem) else []
    negated = origin.startswith(_NOT)
    text = origin.removeprefix(_NOT).strip()
    if isinstance(item, Input) and negated and item.kind != "toggle":
        problems.append(Problem("", f"'not' is for switches; {target} takes {item.meaning}"))
    name, _, key = text.partition(".")
    if "/" in text or text in scene.frames or text in scene.named_frames():
        route: FrameRoute | None = _frame_route(scene, problems, item, target, text)
    elif name in scene.robots and name not in scene.sources:
        if key != FWD_KIN:
            message = f"no output '{key}' of {name}{did_you_mean(key, [FWD_KIN])}"
            problems.append(Problem("", f"{message}; its frames are {name}/flange and so on"))
        route = _checked(problems, item, target, text, name, True)
    elif f"robots.{name}" in scene.broken and name not in scene.sources:
        return None
    else:
        return _source_route(scene, sources, problems, item, (text, negated))
    if problems:
        raise DeclarationError(problems)
    return route


def _frame_route(
    scene: Scene, problems: list[Problem], item: Input | Problem | None, target: str, text: str
) -> FrameRoute | None:
    frames = scene.named_frames()
    if text not in frames:
        if scene.is_broken(text.partition("/")[0]):
            return None
        problems.append(Problem("", f"no frame '{text}'{did_you_mean(text, frames)}"))
        return None
    received = scene.frames.get(item.name) if isinstance(item, Input) else None
    if received is not None and received.relative_to != WORLD:
        message = f"{text} is a pose in the world; set relative_to of {received.name} to 'world'"
        problems.append(Problem("", message))
    return _checked(problems, item, target, text, text, False)


def _checked(
    problems: list[Problem],
    item: Input | Problem | None,
    target: str,
    text: str,
    name: str,
    is_fwd_kin: bool,
) -> FrameRoute | None:
    if not isinstance(item, Input):
        return None
    if item.shape != (4, 4):
        problems.append(Problem("", f"{text} is a 4 x 4 frame; {target} takes {item.meaning}"))
    return FrameRoute(item, name, is_fwd_kin)


def _source_route(
    scene: Scene,
    sources: Mapping[str, Source],
    problems: list[Problem],
    item: Input | Problem | None,
    origin: tuple[str, bool],
) -> Route | None:
    text, negated = origin
    source, _, event = text.partition(".")
    if not scene.declares("sources", source):
        near = did_you_mean(source, scene.declared("sources"))
        problems.append(Problem("", f"no source '{source}'{near}"))
    elif source in sources and event not in sources[source].events:
        events = sources[source].events
        problems.append(Problem("", f"no event '{event}' of {source}{did_you_mean(event, events)}"))
    if problems:
        raise DeclarationError(problems)
    if source not in sources or not isinstance(item, Input):
        return None  # its own declaration is wrong and already reported
    shape = sources[source].events[event]
    count = math.prod(shape)
    if item.shape == (4, 4) and shape != (1, 4, 4):
        found = f"has {count} values" if len(shape) == 1 else f"is {' x '.join(map(str, shape))}"
        message = f"{text} {found}; {item.target} takes {item.meaning}: 1M in the structure"
        raise DeclarationError([Problem("", message)])
    if count != item.count:
        message = f"{text} has {count} values; {item.target} takes {item.meaning}"
        raise DeclarationError([Problem("", message)])
    return Route(item, source, event, negated)


def _allow_blanks(wiring: Wiring) -> None:
    """Lets NaN through where it blanks one number and moves nothing."""
    for name, source in wiring.sources.items():
        kinds: dict[str, set[str]] = {}
        for route in wiring.routes:
            if route.source == name:
                kinds.setdefault(route.event, set()).add(route.to.kind)
        blank = {event for event, led in kinds.items() if led <= set(BLANKABLE)}
        if isinstance(source, FriReceiver):  # the user has not chosen what else it sends
            blank |= source.events.keys() - kinds.keys()
        source.allow_nan(blank)


def _levels(scene: Scene, wiring: Wiring) -> list[list[str]]:
    """What frames place, in an order in which everything is placed after what it follows."""
    frames = scene.named_frames()
    after: dict[str, set[str]] = {
        name: {double.of} for name, double in scene.doubles.items() if name not in scene.robots
    }
    placed = set()
    for route in wiring.frame_routes:
        mover = route.frame if route.is_fwd_kin else frames[route.frame].moves_with
        if route.to.key != "flange_check":  # it moves nothing
            after.setdefault(route.to.name, set()).add(mover)
            placed.add(route.to.name)
    for name, received in scene.frames.items():
        if received.relative_to in frames:
            after.setdefault(name, set()).add(frames[received.relative_to].moves_with)
            placed.add(name)
    sorter = TopologicalSorter(after)
    try:
        sorter.prepare()
    except CycleError as error:
        names = list(reversed(error.args[1]))[:-1]
        first = names.index(min(names))  # which one is found first is chance
        circle = " -> ".join([*names[first:], *names[:first], names[first]])
        wiring.problems.append(Problem("routes", f"frames that follow each other: {circle}"))
        return []
    levels = []
    while sorter.is_active():
        ready = sorter.get_ready()
        sorter.done(*ready)
        level = [name for name in ready if name in placed]
        if level:
            levels.append(level)
    return levels
