"""Routes: which event of which source goes to which input of which robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco

from ..assemble.scene import Scene
from ..assemble.tables import DOUBLE_INPUTS, INPUTS
from ..assemble.world import World
from ..errors import DeclarationError, Problem, did_you_mean
from ..receive.kinds import make_source
from ..receive.source import Packet, Source


@dataclass(frozen=True)
class Route:
    """One checked route.

    Attributes:
        robot: the target's robot or double.
        key: its input, one of `INPUTS`.
        source: the source's name.
        event: the source's event.
    """

    robot: str
    key: str
    source: str
    event: str

    @property
    def target(self) -> str:
        """`robot.input`."""
        return f"{self.robot}.{self.key}"


@dataclass
class Wiring:
    """The sources of a scene and the routes from them.

    Attributes:
        sources: by name, not yet opened.
        routes: those that are right.
        problems: what is wrong with the others.
    """

    sources: dict[str, Source] = field(default_factory=dict)
    routes: list[Route] = field(default_factory=list)
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
    for target, event in scene.routes.items():
        try:
            route = _route(scene, wiring.sources, target, event)
        except DeclarationError as error:
            wiring.problems += [p.inside(f"routes.{target}") for p in error.problems]
        else:
            if route is not None:
                wiring.routes.append(route)
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


def _route(scene: Scene, sources: Mapping[str, Source], target: str, event: str) -> Route | None:
    problems: list[Problem] = []
    robot, _, key = target.partition(".")
    is_double = robot in scene.doubles
    inputs = DOUBLE_INPUTS if is_double else INPUTS
    if not is_double and not scene.declares("robots", robot):
        near = did_you_mean(robot, [*scene.declared("robots"), *scene.doubles])
        problems.append(Problem("", f"no robot '{robot}'{near}"))
    elif key not in inputs:
        problems.append(Problem("", f"no input '{key}' of {robot}{did_you_mean(key, inputs)}"))
    elif is_double and scene.doubles[robot].path is not None:
        problems.append(Problem("", f"'{robot}' shows a path; nothing can be routed to it"))
    source, _, name = event.partition(".")
    if not scene.declares("sources", source):
        near = did_you_mean(source, scene.declared("sources"))
        problems.append(Problem("", f"no source '{source}'{near}"))
    elif source in sources and name not in sources[source].events:
        events = sources[source].events
        problems.append(Problem("", f"no event '{name}' of {source}{did_you_mean(name, events)}"))
    if problems:
        raise DeclarationError(problems)
    owner = scene.doubles[robot].of if is_double else robot
    if source not in sources or owner not in scene.robots:
        return None  # its own declaration is wrong and already reported
    found, wanted = sources[source].events[name], scene.robots[owner].n
    if found != wanted:
        message = f"{event} has {found} values; {target} takes {wanted}, one per joint"
        raise DeclarationError([Problem("", message)])
    return Route(robot, key, source, name)


class Router:
    """Applies packets of one source to a world's data."""

    def __init__(self, world: World, routes: list[Route]) -> None:
        self._to_qpos: list[tuple[str, Any]] = []
        self._to_userdata: list[tuple[str, slice]] = []
        self._flags: list[int] = []
        for route in routes:
            if route.key == "joint_angles" and route.robot in world.robots:
                self._to_qpos.append((route.event, world.robots[route.robot].qpos))
            else:
                self._to_userdata.append((route.event, world.slots[route.target]))
            self._flags.append(world.slots[f"{route.robot}.has"].start + INPUTS.index(route.key))

    def apply(self, packet: Packet, data: mujoco.MjData) -> None:
        """Writes the packet's values where the routes lead; frames move with `follow`."""
        qpos, userdata = data.qpos, data.userdata
        for event, index in self._to_qpos:
            qpos[index] = packet.values[event]
        for event, slot in self._to_userdata:
            userdata[slot] = packet.values[event]
        userdata[self._flags] = 1.0
