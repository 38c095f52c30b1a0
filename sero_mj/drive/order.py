"""What has to be done before what, for things that follow each other."""

from __future__ import annotations

from collections.abc import Sequence
from graphlib import CycleError, TopologicalSorter

from ..assemble.inputs import BLANKABLE
from ..assemble.scene import Scene
from ..errors import DeclarationError, Problem
from .wiring import FrameRoute, Route, Wiring


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
