"""Generates the packets that a moving robot would send.

`RouteInverse` computes the numbers of a packet from the values of inputs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Protocol

import numpy as np

from ...base.errors import UsageError, did_you_mean
from ...base.frames import Array, frame, rotation_about
from ...robots.assemble.friction_torques import VELOCITIES
from ...robots.declared.inputs import Input, list_inputs, numbers_of_frame
from ...robots.declared.scene import Scene
from ..drive.model_torques import ModelTorques, origins_of
from ..drive.route import Origin, Route
from ..drive.wiring import Wiring, wire
from ..receive.source import Source
from ..receive.structure import Structure
from .motion import CommonMotion, RobotSignals

_SWITCHED_AFTER = 4.0  # time between changes of toggles, s
_RANK_TOLERANCE = 1e-9  # share of a row below which it is linearly dependent
_MAGNITUDES = {"force": 50.0, "torque": 10.0, "velocity": 0.5, "angular_velocity": 1.5}


def choose_source(wiring: Wiring, name: str | None = None) -> Source:
    """Returns the source with a name, or the only source; raises UsageError."""
    sources = wiring.sources
    if name is None and len(sources) == 1:
        name = next(iter(sources))
    if name in sources:
        return sources[name]
    if name is not None or not sources:
        named = f" '{name}'" if name else ""
        raise UsageError(f"the scene has no source{named}{did_you_mean(name or '', sources)}")
    names = ", ".join(sources)
    raise UsageError(f"the scene has several sources; choose one with --source: {names}")


def structure_for(source: Source, text: str | None = None) -> Structure:
    """Returns the structure of a source, or the structure `text` with the types of the source."""
    if text is None:
        return source.layout
    return Structure(
        text, is_double=source.layout.is_double, column_major=source.layout.column_major
    )


class Player(Protocol):
    """A provider of the measured signals of one robot, such as `RobotSignals`."""

    def signals(self, t: float) -> Mapping[str, Array]: ...


class MotionPackets:
    """The packets that a source of a scene receives from moving robots.

    Raises DeclarationError or UsageError.

    Args:
        source: name of the source; None for the only source.
        structure: packet layout; None for the layout of the source.
        amplitude: amplitude of the motion, from 0 to 1.
        players: providers of signals by robot; None for an example motion.
    """

    def __init__(
        self,
        scene: Scene,
        source: str | None = None,
        structure: str | None = None,
        amplitude: float = 1.0,
        players: Mapping[str, Player] | None = None,
    ) -> None:
        wiring = wire(scene).check(scene)
        self.source = choose_source(wiring, source)
        self.structure = structure_for(self.source, structure)
        routes = _connected(wiring.routes, self.source.name, self.structure.events)
        if not routes:
            raise UsageError(_nothing_to_send(wiring.routes, self.source.name, self.structure))
        for route in routes:
            self._check_size(route)
        self._scene = scene
        self._inputs = list_inputs(scene)
        self._routes = {route.to.target: route for route in wiring.routes}
        # If routes require different values of an event, the first routes take precedence.
        routes.sort(key=lambda route: _importance(scene, route.to))
        self._wanted = [(route.to, route.negated) for route in routes]
        self._inverse = None if all(r.value.whole for r in routes) else RouteInverse(routes)
        self._plain: dict[str, str] = {}  # name of the input that an event contains, by event
        for route in routes:
            if route.value.whole is not None:
                self._plain.setdefault(route.value.whole.key, route.to.target)
        played = {self._robot_of(item) for item in self._needed_inputs(routes)} - {None}
        self._robots: dict[str, Player] = {}
        motion = None
        if players is None and played:
            motion = CommonMotion([*scene.robots.values()], amplitude)
        for name in sorted(name for name in played if name):
            if motion is not None:
                self._robots[name] = RobotSignals(scene.robots[name], motion)
            elif players is not None and name in players:
                self._robots[name] = players[name]
            else:
                near = did_you_mean(name, players or {})
                raise UsageError(f"the sent file has no signals of robot '{name}'{near}")
        self._is_motion = players is None
        self._model = ModelTorques(scene.robots)

    def _check_size(self, route: Route) -> None:
        for term in route.value.terms:
            if term.origin.name != self.source.name or not term.origin.is_event:
                continue
            found = math.prod(self.structure.events[term.origin.key])
            missing = int(term.take.max()) >= found
            if missing or (route.value.whole is not None and found != route.to.count):
                wanted = f"takes {route.to.meaning}" if route.value.whole else f"is {route.text}"
                raise UsageError(
                    f"structure '{self.structure.text}': {term.origin.key} has {found} values, "
                    f"but {route.to.target} {wanted}"
                )

    def _needed_inputs(self, routes: Sequence[Route]) -> list[Input]:
        todo = [route.to.target for route in routes]
        todo += [each for route in routes for each in self._origins(route)]
        seen: dict[str, Input] = {}
        while todo:
            target = todo.pop()
            if target not in seen:
                seen[target] = self._inputs[target]
                todo += self._origins(self._routes[target]) if target in self._routes else []
        return list(seen.values())

    def _origins(self, route: Route) -> list[str]:
        found = []
        for output in route.outputs:
            name, _, key = output.partition(".")
            is_input = output in self._inputs
            found += [output] if is_input else origins_of(self._scene.robots, name, key)
        return [each for each in found if each in self._inputs]

    def _robot_of(self, item: Input) -> str | None:
        if item.kind in ("angles", "values") or item.key == "flange_check":
            double = self._scene.doubles.get(item.name)
            return item.name if double is None else double.of
        return None

    def at(self, t: float) -> bytes:
        """Returns the packet at time `t` (s)."""
        now = {name: player.signals(t) for name, player in self._robots.items()}
        wanted = {}
        for item, negated in self._wanted:
            value = self._value(item, now, t)
            if item.is_pose:
                value = numbers_of_frame(value, item.count, self._scene.robots.get(item.name))
            wanted[item.target] = 1.0 - value if negated else value
        if self._inverse is None:
            values = {event: wanted[target] for event, target in self._plain.items()}
        else:
            numbers = self._inverse.solve(
                {target: np.ravel(value) for target, value in wanted.items()},
                lambda origin: self._output(str(origin), now, t),
            )
            values = {
                origin.key: numbers(origin, math.prod(self.structure.events[origin.key]))
                for origin in self._inverse.origins
                if origin.name == self.source.name
            }
        shapes = self.structure.events
        values = {event: np.reshape(value, shapes[event]) for event, value in values.items()}
        for event in self.structure.matrices:
            # Events without a route still need valid frames, or the packet is malformed.
            frames = values.setdefault(event, np.zeros(shapes[event]))
            values[event] = np.where(frames.any(axis=(1, 2), keepdims=True), frames, np.eye(4))
        return self.structure.encode(values)

    def _output(self, target: str, now: Mapping[str, Mapping[str, Array]], t: float) -> Array:
        if target not in self._inputs:
            name, _, key = target.partition(".")

            def input_of(each: str) -> Array | None:
                robot, _, what = each.partition(".")
                if each not in self._inputs or what == VELOCITIES:
                    return now.get(robot, {}).get(what)
                return self._output(each, now, t)

            return self._model.output(name, key, input_of).reshape(-1)
        item, route = self._inputs[target], self._routes.get(target)
        if route is not None and route.sources:
            return self._value(item, now, t)
        if route is not None:
            return route.value.evaluate(lambda origin: self._output(str(origin), now, t))
        scene = self._scene
        if item.key == "joint_angles" and item.name in scene.robots:
            return scene.robots[item.name].home
        sections: tuple[Mapping[str, object], ...] = (scene.robots, scene.doubles, scene.arrows)
        declared = next(section[item.name] for section in sections if item.name in section)
        value = getattr(declared, item.key, None)
        return np.zeros(item.count) if value is None else np.asarray(value, np.float64)

    def _value(self, item: Input, now: Mapping[str, Mapping[str, Array]], t: float) -> Array:
        scene, robot = self._scene, self._robot_of(item)
        if robot is not None:
            # Doubles show the commanded angles.
            is_target = item.key == "joint_angles" and item.name in scene.doubles
            key = "commanded_angles" if is_target else item.key
            signals = now[robot]
            return signals[key] if key in signals else signals["further"]
        if item.kind == "vector" and not self._is_motion:
            return np.zeros(3)  # unknown without a motion
        if item.kind == "vector":
            size = _MAGNITUDES[scene.arrows[item.name].kind]
            return size * np.array([np.cos(0.9 * t), np.sin(0.9 * t), 0.6 * np.sin(0.5 * t)])
        if item.kind == "toggle":
            phase = int(t / _SWITCHED_AFTER)
            return np.array([float(phase % (3 if item.key == "arrow_quantity" else 2))])
        return self._frame(item, t)

    def _frame(self, item: Input, t: float) -> Array:
        scene = self._scene
        if item.name in scene.robots:
            return scene.robots[item.name].base_frame
        if item.name in scene.cameras:
            return scene.cameras[item.name].frame
        placed = {thing.name: thing.frame for thing in scene.objects}
        if item.name in placed:
            return placed[item.name]
        declared = scene.frames[item.name].frame
        start = frame(position=np.array([0.5, 0.0, 0.5])) if declared is None else declared
        return np.asarray(frame(rotation_about(2, 0.4 * t)) @ start)


def _connected(routes: Sequence[Route], source: str, events: Collection[str]) -> list[Route]:
    taking = [
        route
        for route in routes
        if route.condition is None  # not unique
        and all(
            origin.key in events
            for origin in route.value.origins
            if origin.is_event and origin.name == source
        )
    ]
    names = {source}
    while True:
        found = [route for route in taking if names & set(route.sources)]
        more = {name for route in found for name in route.sources} | names
        if more == names:
            return found
        names = more


def _nothing_to_send(routes: Sequence[Route], source: str, structure: Structure) -> str:
    taken = {
        o.key: None for r in routes for o in r.value.origins if o.is_event and o.name == source
    }
    if not taken:
        return f"no route uses source '{source}', so there is nothing to send"
    return (
        f"structure '{structure.text}' has {', '.join(structure.events)}; the routes from "
        f"'{source}' take {', '.join(taken)}, so there is nothing to send"
    )


def _importance(scene: Scene, item: Input) -> int:
    if item.kind == "angles":
        return int(item.name in scene.doubles)
    return {"pose": 2, "frame": 2, "values": 3, "vector": 4}.get(item.kind, 5)


class RouteInverse:
    """The inverse of routes, which computes the numbers of events from the values of inputs.

    The solution has minimum norm. If routes contradict each other, the first ones take precedence.
    """

    def __init__(self, routes: Sequence[Route]) -> None:
        self._routes = list(routes)
        self._columns: dict[Origin, dict[int, int]] = {}
        width = 0
        for route in routes:
            for term in route.value.terms:
                known = self._columns.setdefault(term.origin, {})
                for number in term.take.tolist() if term.origin.is_event else ():
                    if number not in known:
                        known[number] = width
                        width += 1
        rows = np.concatenate([self._rows(route, width) for route in routes])
        self._selected = _independent(rows)
        self._inverse = np.linalg.pinv(rows[self._selected])
        # Indices of the numbers of each origin, and their indices in the solution.
        self._taken = {
            origin: (np.array(list(columns), np.intp), np.array(list(columns.values()), np.intp))
            for origin, columns in self._columns.items()
        }

    @property
    def origins(self) -> list[Origin]:
        """The events that the routes read."""
        return [origin for origin in self._columns if origin.is_event]

    def _rows(self, route: Route, width: int) -> Array:
        rows = np.zeros((len(route.value.offset), width))
        for term in route.value.terms:
            if term.origin.is_event:
                columns = [self._columns[term.origin][number] for number in term.take.tolist()]
                rows[term.at, columns] += term.times
        return rows

    def solve(
        self, wanted: Mapping[str, Array], output: Callable[[Origin], Array]
    ) -> Callable[[Origin, int], Array]:
        """Solves the routes for one packet.

        Returns a function that takes an event and the count of its numbers, and returns the numbers
        of this event in the packet.

        Args:
            wanted: values of the inputs by target, such as `lwr.torques`, shape (n,) each.
            output: function that returns the values of an output of a robot.
        """

        def known(origin: Origin) -> Array:
            if not origin.is_event:
                return output(origin)
            return np.zeros(max(self._columns[origin], default=0) + 1)

        rests = [wanted[r.to.target] - r.value.evaluate(known) for r in self._routes]
        solution = self._inverse @ np.concatenate(rests)[self._selected]

        def numbers(origin: Origin, count: int) -> Array:
            found = np.zeros(count)
            if origin in self._taken:
                taken, columns = self._taken[origin]
                found[taken] = solution[columns]
            return found

        return numbers


def _independent(rows: Array) -> list[int]:
    basis = np.empty((0, rows.shape[1]))
    selected = []
    for i, row in enumerate(rows):
        size = np.linalg.norm(row)
        rest = row - basis.T @ (basis @ row)
        rest -= basis.T @ (basis @ rest)  # repeated, to remove rounding errors
        if size > 0 and np.linalg.norm(rest) > _RANK_TOLERANCE * size:
            basis = np.vstack([basis, rest / np.linalg.norm(rest)])
            selected.append(i)
    return selected
