"""`SteeringPanel`: controllers, gains and targets of robots that are simulated without an end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ...simulate.live_control import CONTROL_NAMES, CONTROLS, LiveRobot
from ..tools.steering import Steering
from .jog_panel import FlangeFields, JointSliders, build_each
from .widgets import Widgets

_SLIDER = 9.5  # wide, of the text's height
_MOST_TRANSLATION, _MOST_ROTATION, _MOST_NULLSPACE = 5000.0, 300.0, 200.0
_MOST_RATIO, _MOST_DAMPING = 2.0, 50.0
_MOST_OF_FIRST = 6.0  # range of the slider of all joints' stiffness, of that at first


class SteeringPanel:
    """The panel of robots whose targets and controllers are changed while they run.

    Args:
        steering: changes them.
        say: tells the user something.
    """

    def __init__(self, steering: Steering, say: Callable[[str], None]) -> None:
        self._steering, self._say = steering, say
        self._sliders, self._flange = JointSliders(), FlangeFields()
        self._refused: dict[str, str] = {}
        self._asked: Any = None  # what was refused last: a slider asks for it in every frame
        self._first = {
            name: robot.gains["joint"].stiffness.copy() for name, robot in steering.robots.items()
        }

    def build(self, ui: Widgets) -> None:
        """Builds a section for every robot."""
        steering = self._steering
        if steering.error:
            ui.text(f"stopped: {steering.error}", "bad")
            if ui.button("start again"):
                self._say(steering.start_again())
        robots = steering.robots
        build_each(ui, "Control", robots, lambda name: self._robot(ui, name, robots[name]))

    def _robot(self, ui: Widgets, name: str, robot: LiveRobot) -> None:
        now = CONTROLS.index(robot.control)
        ui.width(_SLIDER + 2.0)
        changed, chosen = ui.choose("##control", now, CONTROL_NAMES)
        if changed and chosen != now:
            self._refused.pop(name, None)
            self._say(self._steering.choose(name, CONTROLS[chosen]))
        build = {"gravity": self._gravity, "joint": self._joint, "cartesian": self._cartesian}
        build[robot.control](ui, name, robot)
        if name in self._refused:
            ui.text(self._refused[name], "bad")
        if robot.control == "gravity":
            ui.text("it stays where it is put: Ctrl+drag pulls a link", "quiet")
            return
        self._target(ui, name)

    def _target(self, ui: Widgets, name: str) -> None:
        steering, goal = self._steering, self._steering.goals[name]
        if goal.trouble:
            ui.text(goal.trouble, "bad")
        changed, is_on = ui.check("handles", steering.has_handles and steering.selected == name)
        if changed:
            steering.has_handles, steering.selected = is_on, name
        ui.tip("drag arrows, rings and cube to move the target's flange; Ctrl+drag its links")
        ui.same_line()
        if ui.button("target to robot"):
            goal.follow(steering.robots[name].measured)
        ui.tip("the target is where the robot is now")
        if ui.tree("target's joints"):
            self._sliders.build(ui, goal)
            ui.width(4.2)
            changed, unit = ui.choose("##unit", self._sliders.unit, ("deg", "rad"))
            if changed:
                self._sliders.unit = unit
            if ui.button("home"):
                goal.set_all(goal.robot.home)
            ui.end_tree()
        if ui.tree("target's flange"):
            base = steering.base(name)
            pose = self._flange.build(ui, goal, base)
            if pose is not None:
                goal.hold_posture()
                goal.move_flange(base, pose, at_once=True)
            ui.end_tree()

    def _gravity(self, ui: Widgets, name: str, robot: LiveRobot) -> None:
        damping = float(robot.gains["gravity"].damping[0])
        moved, value = self._slide(ui, "damping", damping, _MOST_DAMPING, "%.1f Nm s/rad")
        if moved:
            self._change(name, {"damping": np.array([value])}, _text_of("damping", "Nm s/rad"))

    def _joint(self, ui: Widgets, name: str, robot: LiveRobot) -> None:
        gains, first = robot.gains["joint"], self._first[name]
        stiffness = np.broadcast_to(gains.stiffness, first.shape)
        share = 100.0 * float(np.median(stiffness / np.maximum(first, 1e-9)))
        text = _text_of("stiffness", "Nm/rad")
        moved, value = self._slide(ui, "stiffness", share, 100.0 * _MOST_OF_FIRST, "%.0f %%")
        ui.tip("of all joints, of what it was at first")
        if moved:
            self._change(name, {"stiffness": first * value / 100.0}, text)
        moved, value = self._slide(ui, "damping", float(gains.damping[0]), _MOST_RATIO, "%.2f")
        ui.tip("ratio: 0.7 overshoots by 4.6 %, 1 not at all")
        if moved:
            self._change(name, {"damping": np.array([value])}, _text_of("damping", ""))
        if ui.tree("stiffness of the joints"):
            for joint, label in enumerate(robot.robot.names):
                unit = "Nm/rad" if robot.robot.types[joint] == "revolute" else "N/m"
                most = _MOST_OF_FIRST * float(first[joint])
                moved, value = self._slide(ui, label, float(stiffness[joint]), most, f"%.0f {unit}")
                if moved:
                    wanted = stiffness.copy()
                    wanted[joint] = value
                    self._change(name, {"stiffness": wanted}, text)
            ui.end_tree()

    def _cartesian(self, ui: Widgets, name: str, robot: LiveRobot) -> None:
        gains = robot.gains["cartesian"]
        along, about = float(gains.stiffness[0, 0]), float(gains.stiffness[3, 3])

        def text(values: Mapping[str, Any]) -> str:
            matrix = np.asarray(values["stiffness"])
            return f"{matrix[0, 0]:.4g} N/m and {matrix[3, 3]:.4g} Nm/rad"

        moved, value = self._slide(ui, "stiffness", along, _MOST_TRANSLATION, "%.0f N/m")
        if moved:
            self._change(name, {"stiffness": np.diag([value] * 3 + [about] * 3)}, text)
        moved, value = self._slide(ui, "of turning", about, _MOST_ROTATION, "%.0f Nm/rad")
        if moved:
            self._change(name, {"stiffness": np.diag([along] * 3 + [value] * 3)}, text)
        moved, value = self._slide(ui, "damping", float(gains.damping), _MOST_RATIO, "%.2f")
        ui.tip("ratio: 0.7 overshoots by 4.6 %, 1 not at all")
        if moved:
            self._change(name, {"damping": value}, _text_of("damping", ""))
        null = float(gains.nullspace_stiffness[0])
        moved, value = self._slide(ui, "null space", null, _MOST_NULLSPACE, "%.0f Nm/rad")
        ui.tip("stiffness towards the posture, where it leaves the flange in place")
        if moved:
            self._change(
                name,
                {"nullspace_stiffness": np.array([value])},
                _text_of("nullspace_stiffness", "Nm/rad"),
            )

    @staticmethod
    def _slide(ui: Widgets, label: str, value: float, most: float, text: str) -> tuple[bool, float]:
        ui.width(_SLIDER)
        return ui.slide(label, value, 0.0, most, text)

    def _change(
        self, name: str, values: dict[str, Any], text: Callable[[Mapping[str, Any]], str]
    ) -> None:
        asked = (name, [(key, np.asarray(value).tobytes()) for key, value in values.items()])
        if asked == self._asked:
            return
        self._asked = asked
        why = self._steering.robots[name].change(values, text)
        if why:
            self._refused[name] = why
        else:
            self._refused.pop(name, None)


def _text_of(key: str, unit: str) -> Callable[[Mapping[str, Any]], str]:
    """Returns what writes the smallest to the largest of some gains, with their unit."""

    def text(values: Mapping[str, Any]) -> str:
        array = np.atleast_1d(values[key])
        low, high = array.min(), array.max()
        numbers = f"{low:.4g}" if high - low < 1e-9 else f"{low:.4g} to {high:.4g}"
        return f"{numbers} {unit}".strip()

    return text
