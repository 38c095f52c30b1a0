"""What recordings call the numbers of joints and arrows: `lwr.A1.torque [Nm]`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..assemble.inputs import Input
from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..record.signals_json import Signals
from ._units import robot_of
from .wiring import Route

Array = NDArray[np.float64]
Shapes = Mapping[str, tuple[int, ...]]

# The last word of a per-joint quantity to what it is for one joint, and to its unit where the
# joint turns and where it slides.
_ONE: dict[str, tuple[str, str, str]] = {
    "angles": ("angle", "rad", "m"),
    "velocities": ("velocity", "rad/s", "m/s"),
    "accelerations": ("acceleration", "rad/s2", "m/s2"),
    "torques": ("torque", "Nm", "N"),
    "temperatures": ("temperature", "", ""),
    "values": ("value", "", ""),
}
_VECTOR_UNITS = {"force": "N", "torque": "Nm", "velocity": "m/s", "angular_velocity": "rad/s"}


def joint_names(name: str, robot: SerialRobot, quantity: str) -> list[str]:
    """Names of a quantity of every joint, n: `lwr.A1.torque [Nm]`.

    Args:
        name: of the robot or double.
        robot: with these joints.
        quantity: `torques`, `joint_angles`, `target_velocities`, or an input of its own, of which a
            line of its billboards may say the unit.
    """
    *before, last = quantity.removeprefix("joint_").split("_")
    word, turning, sliding = _ONE.get(last, (last, "", ""))
    if not turning and robot.billboard_lines:
        declared = [
            line.unit
            for line in robot.billboard_lines
            if line.value == quantity and line.scale == 1.0 and line.unit
        ]
        turning = sliding = next(iter(declared), "")
    word = "_".join((*before, word))
    units = [turning if kind == "revolute" else sliding for kind in robot.types]
    return [
        f"{name}.{joint}.{word}" + (f" [{unit}]" if unit else "")
        for joint, unit in zip(robot.names, units, strict=True)
    ]


class RoutedSignals:
    """The packets of a source as a scene shows them: what leads to joints and arrows by its name.

    Numbers are those that the routes compute, in SI units. What leads to neither stays as it came.

    Args:
        scene: whose routes these are.
        routes: all of them; those that take more than a packet of this source are left out.
        source: name of the source.
        events: event name to its shape.

    Attributes:
        signals: what they are called.
    """

    def __init__(self, scene: Scene, routes: Sequence[Route], source: str, events: Shapes) -> None:
        self._routes = [
            route
            for route in routes
            if route.direct == source and not route.negated and _is_named(route.to)
        ]
        names = {route.to.target: _names_of(scene, route.to) for route in self._routes}
        routed = {event: np.zeros(int(np.prod(shape)), bool) for event, shape in events.items()}
        origins = {}
        for route in self._routes:
            whole = route.value.whole
            text = whole.key if whole is not None else f"({route.text})"
            for index, name in enumerate(names[route.to.target]):
                origins[name] = f"{text}[{index}]"
            for term in route.value.terms:
                routed[term.origin.key][term.take] = True
        self._events = [event for event in events if not routed[event].all()]
        shapes: dict[str, tuple[int, ...]] = {
            target: (len(each),) for target, each in names.items()
        }
        shapes |= {event: tuple(events[event]) for event in self._events}
        self.signals = Signals(shapes, names, origins)

    def of(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Returns the arrays of a decoded packet, as `signals` has them."""
        found = {}
        with np.errstate(over="ignore", invalid="ignore"):
            for route in self._routes:
                found[route.to.target] = route.value.evaluate(lambda o: values[o.key].ravel())
        return found | {event: values[event] for event in self._events}


def _is_named(item: Input) -> bool:
    return item.kind in ("angles", "values", "vector")


def _names_of(scene: Scene, item: Input) -> list[str]:
    if item.kind != "vector":
        return joint_names(item.name, robot_of(scene, item), item.key)
    arrow = scene.arrows[item.name]
    unit = _VECTOR_UNITS.get(arrow.kind, "") if arrow.unit is None else arrow.unit
    return [f"{item.name}.{axis}" + (f" [{unit}]" if unit else "") for axis in "xyz"]
