"""Checked routes: what leads from where to where, and in which order they are applied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from typing import Self

from ..assemble.inputs import BLANKABLE, Input
from ..assemble.scene import Scene
from ..errors import DeclarationError, Problem
from ..receive.source import SIGNALS, Source
from .affine import Affine


@dataclass(frozen=True, eq=False)
class Route:
    """One checked route of numbers.

    Attributes:
        to: the input it leads to.
        text: where it leads from, as declared.
        value: how the input's numbers are computed.
        negated: whether a toggle is negated.
    """

    to: Input
    text: str
    value: Affine
    negated: bool = False

    @property
    def sources(self) -> list[str]:
        """Names of the sources whose packets it takes numbers from."""
        return list(dict.fromkeys(o.name for o in self.value.origins if o.is_event))

    @property
    def outputs(self) -> list[str]:
        """What it reads of robots, doubles and arrows, `name.key`."""
        return [str(origin) for origin in self.value.origins if not origin.is_event]

    @property
    def direct(self) -> str | None:
        """The source, where a packet of it is all that it takes; else None."""
        sources = self.sources
        if any(o.is_event and o.key in SIGNALS for o in self.value.origins):
            return None  # changes without a packet
        return sources[0] if len(sources) == 1 and not self.outputs else None


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
        routes: those of numbers that are right.
        later: those among them that need more than one packet, each after what it reads.
        frame_routes: those from frames that are right.
        levels: names of what frames place, each after what it depends on.
        problems: what is wrong with the others.
    """

    sources: dict[str, Source] = field(default_factory=dict)
    routes: list[Route] = field(default_factory=list)
    later: list[Route] = field(default_factory=list)
    frame_routes: list[FrameRoute] = field(default_factory=list)
    levels: list[list[str]] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)

    def check(self, scene: Scene) -> Self:
        """Returns itself; raises DeclarationError where something in the scene is wrong."""
        if self.problems:
            raise DeclarationError(scene.located(self.problems))
        return self


def routes_in_order(routes: Sequence[Route]) -> list[Route]:
    """The routes that need more than one packet, each after those to what it reads.

    Raises:
        DeclarationError: values follow each other in a circle.
    """
    later = {route.to.target: route for route in routes if route.direct is None}
    after = {target: {*later} & set(route.outputs) for target, route in later.items()}
    try:
        return [later[target] for target in TopologicalSorter(after).static_order()]
    except CycleError as error:
        raise _circle("values", error) from None


def levels_of_frames(scene: Scene, routes: Sequence[FrameRoute]) -> list[list[str]]:
    """What frames place, in an order in which everything is placed after what it follows.

    Raises:
        DeclarationError: frames follow each other in a circle.
    """
    frames = scene.named_frames()
    after: dict[str, set[str]] = {
        name: {double.of} for name, double in scene.doubles.items() if name not in scene.robots
    }
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
    try:
        sorter.prepare()
    except CycleError as error:
        raise _circle("frames", error) from None
    levels = []
    while sorter.is_active():
        ready = sorter.get_ready()
        sorter.done(*ready)
        level = [name for name in ready if name in placed]
        if level:
            levels.append(level)
    return levels


def _circle(what: str, error: CycleError) -> DeclarationError:
    names = list(reversed(error.args[1]))[:-1]
    first = names.index(min(names))  # which one is found first is chance
    circle = " -> ".join([*names[first:], *names[:first], names[first]])
    return DeclarationError([Problem("routes", f"{what} that follow each other: {circle}")])


def allow_blanks(wiring: Wiring) -> None:
    """Lets NaN through where it moves nothing, not even in the end: it blanks, or is not routed."""
    readers: dict[str, list[Route]] = {}
    for route in wiring.routes:
        for output in route.outputs:
            readers.setdefault(output, []).append(route)

    def blankable(route: Route) -> bool:
        todo, seen = [route], {route.to.target}
        while todo:
            target = todo.pop().to
            if target.kind not in BLANKABLE:
                return False
            for reader in readers.get(target.target, []):
                if reader.to.target not in seen:
                    seen.add(reader.to.target)
                    todo.append(reader)
        return True

    for name, source in wiring.sources.items():
        good: dict[str, bool] = {}
        for route in wiring.routes:
            for origin in route.value.origins:
                if origin.is_event and origin.name == name:
                    good[origin.key] = good.get(origin.key, True) and blankable(route)
        blank = {e for e, blanks in good.items() if blanks and e in source.events}
        # What nobody looks at harms nobody, and its sender may send much that is not routed.
        source.allow_nan(blank | (source.events.keys() - good.keys()))
