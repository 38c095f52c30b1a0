"""Triggers: conditions on received values, such as `abs(lwr.torque_error) > 20`.

Names are events of sources (`udp.values0`), inputs with a route (`lwr.torques`), outputs of robot
models (`lwr.gravity_torques`, `lwr.friction_torques`), and the difference of commanded and measured
torques (`lwr.torque_error`). `language` parses conditions, and `evaluator` computes them.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...base.errors import did_you_mean
from ...base.frames import Array, Bools
from ...robots.assemble.friction_torques import VELOCITIES
from ...robots.declared.scene import Scene
from ..receive.source import SIGNALS
from .evaluator import Compared, Evaluator, Leaf, Rows
from .language import first_word, parse
from .model_torques import FRICTION, MODEL_TORQUES, ModelTorques, why_unknown
from .route import Origin, Route
from .units import robot_of
from .wiring import Wiring

ERROR = "torque_error"
Events = Mapping[str, Array]  # numbers of each event over time, shape (T, ...)


@dataclass(frozen=True, eq=False)
class Hits:
    """The result of checking packets: `holds` is true for each packet that fulfills a condition."""

    holds: Bools
    _compared: tuple[Compared, ...] = ()
    _text: str = ""

    def describe(self, row: int) -> str:
        """Returns a text on a packet, such as `lwr/A3: abs(lwr.torque_error) = 23.4 > 20`."""
        parts = []
        for each in self._compared:
            holds = np.atleast_1d(each.holds[row]).ravel()
            if not holds.any():
                continue
            left, right = (
                np.broadcast_to(side[row], each.holds[row].shape).ravel()
                for side in (each.left, each.right)
            )
            gap = np.where(holds, np.abs(left - right), -1.0)
            k = int(np.argmax(gap))
            label = f"{each.labels[k]}: " if k < len(each.labels) else ""
            label = "" if label == f"{each.text}: " else label
            parts.append(f"{label}{each.text} = {left[k]:.4g} {each.sign} {right[k]:.4g}")
        return ", ".join(parts) or self._text


class Trigger:
    """A condition on the received values of a scene's sources; raises RouteError.

    It stores the newest values of each source, for conditions on several sources.
    """

    def __init__(self, text: str, scene: Scene, wiring: Wiring) -> None:
        self.text = text
        self._scene = scene
        self._routes = {route.to.target: route for route in [*wiring.routes, *wiring.later]}
        self._sources = wiring.sources
        self._model = ModelTorques(scene.robots)
        self._expression = parse(text)
        self._latest: dict[str, dict[str, Array]] = {}
        with np.errstate(all="ignore"):
            evaluator = Evaluator(self._expression, self._leaf(_Reader(self, {}, 1)))
            evaluator.truth(self._expression.tree)
        if self._expression.negated:
            self._expression.refuse(0, "expected a comparison such as lwr.torques > 20")

    def find(self, source: str, events: Events) -> Hits:
        """Returns the packets in which the condition holds.

        `events` contains the numbers in all new valid packets of a source.
        """
        count = len(next(iter(events.values()), np.empty(0)))
        if not count:
            return Hits(np.zeros(0, bool))
        evaluator = Evaluator(self._expression, self._leaf(_Reader(self, {source: events}, count)))
        with np.errstate(all="ignore"):
            values = evaluator.truth(self._expression.tree).values
        self._latest[source] = {event: array[-1:].copy() for event, array in events.items()}
        holds = np.broadcast_to(values.reshape(len(values), -1).any(axis=1), count)
        return Hits(np.asarray(holds), tuple(evaluator.compared), self.text)

    def _leaf(self, reader: _Reader) -> Leaf:
        def leaf(node: ast.expr) -> Rows | None:
            if not isinstance(node, ast.Name | ast.Constant):
                return None
            word = self._expression.words[first_word(node)]
            if word.kind == "number":
                return Rows(np.array([float(word.text)]))
            self._check(first_word(node), word.text)
            return reader.signal(word.text)

        return leaf

    @property
    def names(self) -> list[str]:
        """Names that conditions can use."""
        events = [
            f"{name}.{event}"
            for name, source in self._sources.items()
            for event in source.events
            if event not in SIGNALS
        ]
        robots = [name for name in self._scene.robots if self._has_error(name)]
        errors = [f"{name}.{ERROR}" for name in robots]
        outputs = [
            f"{name}.{key}"
            for name in self._scene.robots
            for key in MODEL_TORQUES
            if f"{name}.joint_angles" in self._routes
            and not why_unknown(self._scene.robots, name, key)
        ]
        return [*dict.fromkeys([*self._routes, *errors, *outputs, *events])]

    def _has_error(self, robot: str) -> bool:
        return all(f"{robot}.{key}" in self._routes for key in ("torques", "commanded_torques"))

    def _check(self, word: int, name: str) -> None:
        names = self.names
        if name in names:
            self._check_velocities(word, name)
            return
        robot, _, key = name.partition(".")
        reason = f"expected a signal of scene '{self._scene.name}'{did_you_mean(name, names)}"
        if key == ERROR and robot in self._scene.robots:
            missing = [
                f"{robot}.{each}"
                for each in ("commanded_torques", "torques")
                if f"{robot}.{each}" not in self._routes
            ]
            reason = f"it needs routes to {' and '.join(missing)}"
        self._expression.refuse(word, reason, len(name))

    def _check_velocities(self, word: int, name: str) -> None:
        todo, seen = [name], set[str]()
        while todo:
            output = todo.pop()
            robot, _, key = output.partition(".")
            if output in self._routes:
                todo += [each for each in self._routes[output].outputs if each not in seen]
                seen.add(output)
            elif key == FRICTION and robot in self._scene.robots:
                velocities = f"{robot}.{VELOCITIES}"
                if velocities not in self._routes:
                    reason = f"{output} needs a route to {velocities}"
                    self._expression.refuse(word, reason, len(name))


class _Reader:
    def __init__(self, trigger: Trigger, events: Mapping[str, Events], count: int) -> None:
        self._trigger, self._events, self._count = trigger, events, count
        self._inputs: dict[str, Array] = {}

    def signal(self, name: str) -> Rows:
        trigger = self._trigger
        owner, _, key = name.partition(".")
        if name in trigger._routes:
            route = trigger._routes[name]
            return Rows(self._input(route), _labels(trigger._scene, route))
        if key == ERROR and owner in trigger._scene.robots:
            commanded, measured = (
                trigger._routes[f"{owner}.{each}"] for each in ("commanded_torques", "torques")
            )
            error = self._input(commanded) - self._input(measured)
            return Rows(error, _labels(trigger._scene, measured))
        if owner in trigger._scene.robots and key in MODEL_TORQUES:
            labels = [f"{owner}/{joint}" for joint in trigger._scene.robots[owner].names]
            return Rows(self._model_output(owner, key), labels)
        values = self._event(Origin(owner, key, True))
        count = values.shape[1] if values.ndim > 1 else 0
        return Rows(values, [f"{name}[{k}]" for k in range(count)])

    def _event(self, origin: Origin) -> Array:
        source = self._trigger._sources[origin.name]
        if origin.key in SIGNALS:
            return np.ones((1, 1))  # a packet has arrived
        found = self._events.get(origin.name) or self._trigger._latest.get(origin.name)
        if found is None:
            return np.full((1, *source.events[origin.key]), np.nan)
        return np.asarray(found[origin.key], np.float64)

    def _model_output(self, robot: str, key: str) -> Array:
        def input_of(target: str) -> Array | None:
            route = self._trigger._routes.get(target)
            return None if route is None else self._input(route)

        return self._trigger._model.output(robot, key, input_of)

    def _input(self, route: Route) -> Array:
        target = route.to.target
        if target not in self._inputs:

            def numbers_of(origin: Origin) -> Array:
                if origin.is_event:
                    values = self._event(origin)
                elif str(origin) not in self._trigger._routes and origin.key in MODEL_TORQUES:
                    values = self._model_output(origin.name, origin.key)
                else:
                    values = self._input(self._trigger._routes[str(origin)])
                return np.broadcast_to(
                    values.reshape(len(values), -1), (self._count, int(np.prod(values.shape[1:])))
                )

            values = route.value.evaluate(numbers_of)
            rows = values if values.ndim > 1 else values[None]
            if route.condition is not None:
                rows = route.condition(rows)
            if route.to.kind == "toggle" and route.negated:
                rows = 1.0 - (rows != 0)
            self._inputs[target] = rows
        return self._inputs[target]


def _labels(scene: Scene, route: Route) -> list[str]:
    if route.to.kind in ("angles", "values"):
        return [f"{route.to.name}/{joint}" for joint in robot_of(scene, route.to).names]
    if route.to.kind == "vector":
        return [f"{route.to.name}.{axis}" for axis in "xyz"]
    return []
