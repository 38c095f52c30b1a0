"""`Jogging`: moves robots without data by sliders, typed poses and dragged links.

The displayed angles approach the requested ones smoothly. If a robot has no torques either, the
torques that hold it against gravity are computed from its model and displayed.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ...base.frames import Array
from ...robots.declared.joint_speeds import undeclared_speeds
from ...robots.declared.robot import SerialRobot
from ..decor.toggles import Handles
from ..image.held_torques import HeldTorques, unrouted
from ..image.picking import Pixel
from ..image.switches import MODELLED
from ..panels.jog_panel import JogPanel
from ..session.joint_goal import JointGoal, set_goals, setting
from ..session.tool import Grab, Shown, Tool
from ..session.widgets import Widgets
from .handle_drag import target_of

_TIME = 0.04  # time constant with which displayed angles approach requested ones, s
_LED = 1.0  # maximum interval at which a program sets angles if it controls a robot, s


class Jogging(Tool):
    """Tool with which the user moves the robots that no source or program moves.

    Attributes:
        goals: mapping from names of robots without data to the requested joint angles.
        held: torques that hold these robots against gravity.
    """

    order: ClassVar[int] = 20

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        mirror = shown.mirror
        self._mirror, self._toggles = mirror, shown.toggles
        world, data = mirror.world, mirror.data
        parts = {name: world.robots[name] for name in unrouted(mirror)}
        self.goals = {
            name: JointGoal(part.robot, data.qpos[part.qpos]) for name, part in parts.items()
        }
        self._written = {name: self._shown(name) for name in self.goals}
        # For each robot: time since a program has set the angles, s.
        self._since = dict.fromkeys(self.goals, np.inf)
        self._fastest = {
            name: undeclared_speeds(goal.robot, "shown") for name, goal in self.goals.items()
        }
        self.held = HeldTorques(mirror, shown.toggles)
        # Robot, link, and point in the frame of the link.
        self._dragged: tuple[str, int, Array] | None = None
        self._at: Pixel = (0.0, 0.0)
        self._panel = JogPanel(world, self.goals, self.base)

    def _shown(self, name: str) -> Array:
        return np.array(self._mirror.data.qpos[self._mirror.world.robots[name].qpos])

    @property
    def is_on(self) -> bool:
        return self._dragged is not None

    def base(self, name: str) -> Array:
        """Returns the base pose of a displayed robot, T_world_base, shape (4, 4)."""
        world = self._mirror.world
        return world.frame(self._mirror.data, world.robots[name].base_name)

    def advance(self, passed: float) -> None:
        data, world = self._mirror.data, self._mirror.world
        for name, goal in self.goals.items():
            shown = self._shown(name)
            self._since[name] += passed
            is_recent = self._since[name] < _LED
            if not np.array_equal(shown, self._written[name]):
                goal.follow(shown)  # A program or a reset has set the angles.
                goal.is_led = is_recent  # A single reset does not count.
                self._since[name] = 0.0
            elif not is_recent:
                goal.is_led = False
            wanted = goal.angles
            if not np.array_equal(shown, wanted):
                shown = approached(shown, wanted, passed, self._fastest[name])
                world.set_input(data, f"{name}.joint_angles", shown)
            self._written[name] = shown
        self.held.update(data, wait=False)

    def grab(self, at: Pixel) -> Grab | None:
        found = self._found(at)
        if found is None:
            return None
        name, link, frame_name, point = found
        world, data = self._mirror.world, self._mirror.data
        body = world.robots[name].bodies[link]
        rotation = data.xmat[body].reshape(3, 3)
        self._dragged = (name, link, rotation.T @ (point - data.xpos[body]))
        self._at = at
        self.goals[name].hold_posture()
        return Grab(f"moving {frame_name}")

    def announce(self, at: Pixel) -> Grab | None:
        found = self._found(at)
        return None if found is None else Grab(f"drag to move {found[2]}")

    def _found(self, at: Pixel) -> tuple[str, int, str, Array] | None:
        found = self.shown.decor.link_at(self._mirror.data, at)
        if found is None:
            return None
        frame_name, point = found
        name, _, label = frame_name.partition("/")
        if name not in self.goals or self.goals[name].is_led:
            return None
        return name, link_number(self.goals[name].robot, label), frame_name, point

    def move(self, at: Pixel) -> None:
        self._at = at

    def drag(self) -> str:
        view = self.shown.decor.view
        if self._dragged is None or view is None:
            return ""
        name, link, point = self._dragged
        goal, data = self.goals[name], self._mirror.data
        body = self._mirror.world.robots[name].bodies[link]
        there = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
        ray = view.at(np.array(self._at, float), 1.0)
        wanted = target_of(view.position, view.forward, there, ray)
        goal.move_point(self.base(name), link, point, wanted)
        self._toggles.handles = None if goal.mark is None else Handles(mark=goal.mark)
        return goal.trouble

    def release(self) -> None:
        if self._dragged is not None:
            self.goals[self._dragged[0]].let_go()
            self._dragged = None
            self._toggles.handles = None

    def build(self, ui: Widgets) -> None:
        self._panel.build(ui, self.held.note)

    @property
    def state(self) -> tuple[tuple[str, bytes], ...]:
        return tuple((name, goal.angles.tobytes()) for name, goal in self.goals.items())

    def restore(self, state: tuple[tuple[str, bytes], ...]) -> None:
        set_goals(self.goals, state)

    def render_words(self) -> list[str]:
        words: list[str] = []
        for name, goal in self.goals.items():
            if not np.array_equal(goal.angles, goal.robot.home):
                words += ["--set", setting(name, goal.angles)]
        torques = self.held.torques
        for name, each in torques.items():
            words += ["--set", setting(name, each, "torques")]
        if torques:
            digits = "".join(map(str, self._toggles.modelled.astype(int).tolist()))
            words += ["--show", f"{MODELLED}={digits}"]
        return words

    def goal(self) -> tuple[str, JointGoal, Array] | None:
        for name, goal in self.goals.items():
            return name, goal, self.base(name)
        return None


def approached(shown: Array, wanted: Array, passed: float, fastest: Array) -> Array:
    """Returns the next displayed joint angles, which approach the requested ones, shape (n,)."""
    error = wanted - shown
    step = np.clip(error * (1.0 - np.exp(-passed / _TIME)), -fastest * passed, fastest * passed)
    return np.asarray(np.where(np.abs(error) < 1e-5, wanted, shown + step))


def link_number(robot: SerialRobot, label: str) -> int:
    """Returns the index of the link with a frame label such as `base`, `link3` or `flange`."""
    if label == "base":
        return 0
    if label == "flange":
        return robot.flange_link
    return int(label.removeprefix("link"))
