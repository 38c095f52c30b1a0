"""`SteeringPanel`: controllers, gains and targets of robots in simulations without an end time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from ...base.frames import Array
from ...viewer.panels.jog_panel import JointSliders, build_each, build_flange
from ...viewer.session.joint_goal import JointGoal
from ...viewer.session.widgets import Widgets
from ..control.controller import Slider
from ..live_control import LiveRobot

_SLIDER = 9.5  # width of sliders, as a multiple of the text height


class Steered(Protocol):
    """The interface of `Steering` that the panel uses."""

    robots: dict[str, LiveRobot]
    goals: dict[str, JointGoal]
    selected: str
    has_handles: bool

    @property
    def error(self) -> str: ...
    def start_again(self) -> str: ...
    def choose(self, robot: str, control: str) -> str: ...
    def base(self, robot: str) -> Array: ...


class SteeringPanel:
    """The panel of `Steering`, which changes the targets and controllers of simulated robots."""

    def __init__(self, steering: Steered, say: Callable[[str], None]) -> None:
        self._steering, self._say = steering, say
        self._sliders = JointSliders()
        self._refused: dict[str, str] = {}
        self._requested: Any = None  # the last request, which a slider repeats in every frame

    def build(self, ui: Widgets) -> None:
        steering = self._steering
        if steering.error:
            ui.text(f"stopped: {steering.error}", "bad")
            if ui.button("restart"):
                self._say(steering.start_again())
        robots = steering.robots
        build_each(ui, "Control", robots, lambda name: self._robot(ui, name, robots[name]))

    def _robot(self, ui: Widgets, name: str, robot: LiveRobot) -> None:
        kinds = [*robot.controllers]
        titles = [each.title or kind for kind, each in robot.controllers.items()]
        now = kinds.index(robot.control)
        ui.width(_SLIDER + 2.0)
        changed, chosen = ui.choose("##control", now, titles)
        if changed and chosen != now:
            self._refused.pop(name, None)
            self._say(self._steering.choose(name, kinds[chosen]))
        self._sliders_of(ui, name, robot)
        if name in self._refused:
            ui.text(self._refused[name], "bad")
        if not robot.controller.needs_target:
            ui.text("this controller has no target: Ctrl+drag pulls a link", "quiet")
            return
        self._target(ui, name)

    def _target(self, ui: Widgets, name: str) -> None:
        steering, goal = self._steering, self._steering.goals[name]
        if goal.trouble:
            ui.text(goal.trouble, "bad")
        changed, is_on = ui.check("handles", steering.has_handles and steering.selected == name)
        if changed:
            steering.has_handles, steering.selected = is_on, name
        ui.tip("drag arrows, rings or cube to move the target's flange; Ctrl+drag moves a link")
        ui.same_line()
        if ui.button("move target to robot"):
            goal.follow(steering.robots[name].measured)
        ui.tip("set the target to the current pose of the robot")
        if ui.tree("joints of the target"):
            self._sliders.build(ui, goal)
            ui.end_tree()
        build_flange(ui, "flange of the target", goal, steering.base(name))

    def _sliders_of(self, ui: Widgets, name: str, robot: LiveRobot) -> None:
        found = robot.controller.sliders(robot.robot, robot.first[robot.control])
        for slider in (each for each in found if not each.group):
            self._slider(ui, name, slider)
        for group in dict.fromkeys(each.group for each in found if each.group):
            if ui.tree(group):
                for slider in (each for each in found if each.group == group):
                    self._slider(ui, name, slider)
                ui.end_tree()

    def _slider(self, ui: Widgets, name: str, slider: Slider) -> None:
        ui.width(_SLIDER)
        moved, value = ui.slide(slider.label, slider.value, 0.0, slider.maximum, slider.text)
        if slider.tip:
            ui.tip(slider.tip)
        if moved:
            self._change(name, slider.fields(value), slider.describe)

    def _change(
        self, name: str, values: dict[str, Any], text: Callable[[Mapping[str, Any]], str]
    ) -> None:
        requested = (name, [(key, np.asarray(value).tobytes()) for key, value in values.items()])
        if requested == self._requested:
            return
        self._requested = requested
        why = self._steering.robots[name].change(values, text)
        if why:
            self._refused[name] = why
        else:
            self._refused.pop(name, None)
