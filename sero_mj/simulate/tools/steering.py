"""`Steering`: moves the targets of robots in simulations without an end time.

A double of the robot shows the target. Handles move the flange of the double, Ctrl+drag moves a
link, and sliders move joints. The robot follows the target with the compliance of the controller.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ...base.frames import Array
from ...viewer.decor.toggles import Handles
from ...viewer.image.picking import Pixel
from ...viewer.session.joint_goal import JointGoal, set_goals
from ...viewer.session.tool import Grab, Shown, Tool
from ...viewer.session.widgets import Widgets
from ...viewer.tools.handle_drag import dragged, target_of
from ...viewer.tools.jogging import link_number
from ..live_control import LiveRobot
from ..runs.run_source import RunSource
from .steering_panel import SteeringPanel

_PAST = 0.1  # minimum delay behind the newest time for the past to count as shown, s
_NEAR = 5.0  # maximum distance of the pointer from a handle, pixels


class Steering(Tool):
    """Moves the targets of simulated robots.

    Attributes:
        robots: robots whose target and controller can be changed, by name.
        goals: goal of each target in joint angles, by name of its robot.
        selected: name of the robot whose target has handles.
        has_handles: whether handles are shown.
        is_on: whether a target is being dragged.
    """

    order: ClassVar[int] = 10

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        mirror = self._mirror = shown.mirror
        self._clock, self._toggles = shown.clock, shown.toggles
        found = [
            each
            for each in mirror.sources.values()
            if isinstance(each, RunSource) and each.live is not None
        ]
        self.source: Any = found[0] if found else None
        self.robots: dict[str, LiveRobot] = {}
        self.goals: dict[str, JointGoal] = {}
        self._find_robots()
        self.selected = next(iter(self.robots), "")
        self.has_handles = bool(self.robots)
        self.is_on = False
        self._lit = -1
        self._at: Pixel = (0.0, 0.0)
        # The dragged handle with its initial pose and pixel, or the dragged point of a link.
        self._handle: tuple[int, Array, Pixel] | None = None
        self._point: tuple[str, int, Array] | None = None
        # Robot of each double whose links can be dragged, by the name of the double.
        world = mirror.world
        self._doubles = {
            name: part.double.of
            for name, part in world.doubles.items()
            if part.double.path is None and part.double.of in self.robots
        }
        self._panel = SteeringPanel(self, shown.say)

    def _find_robots(self) -> None:
        live = None if self.source is None else self.source.live
        self.robots = {} if live is None else live.robots
        self.goals = {name: JointGoal(each.robot, each.goal) for name, each in self.robots.items()}

    def build(self, ui: Widgets) -> None:
        self._panel.build(ui)

    @property
    def state(self) -> tuple[tuple[str, bytes], ...]:
        """Name and goal angles of each robot whose controller follows a target."""
        return tuple(
            (name, goal.angles.tobytes())
            for name, goal in self.goals.items()
            if self.robots[name].controller.needs_target
        )

    def restore(self, state: tuple[tuple[str, bytes], ...]) -> None:
        """Restores the goals in a `state`."""
        set_goals(self.goals, state)

    def goal(self) -> tuple[str, JointGoal, Array] | None:
        """Returns title, joint goal and base frame of the selected robot's target."""
        if not self.goals:
            return None
        name = self.selected if self.selected in self.goals else next(iter(self.goals))
        return f"the target of {name}", self.goals[name], self.base(name)

    @property
    def is_past(self) -> bool:
        """Whether the past is shown."""
        return self.source is not None and self._clock.time < self.source.newest - _PAST

    @property
    def error(self) -> str:
        """Reason why the simulation has stopped; empty while the simulation runs."""
        return "" if self.source is None or self.source.error is None else f"{self.source.error}"

    def start_again(self) -> str:
        """Restarts the simulation after an error, and returns a message for the user."""
        self.source.start_again()
        self._find_robots()
        self._clock.go_to_start()
        return "restarted from the initial pose"

    def choose(self, robot: str, control: str) -> str:
        """Changes the controller of a robot, and returns a message for the user."""
        self.selected = robot
        why = self.robots[robot].choose(control)
        self.goals[robot].follow(self.robots[robot].goal)
        return why or f"{robot}: {self.robots[robot].controller.title or control}"

    def base(self, robot: str) -> Array:
        world = self._mirror.world
        return world.frame(self._mirror.data, world.robots[robot].base_name)

    def advance(self, passed: float) -> None:
        """Passes the goals to the simulation, and shows the handles.

        Called before the mirror moves.
        """
        if not self.robots:
            return
        for name, robot in self.robots.items():
            goal = self.goals[name]
            if not robot.controller.needs_target:
                goal.follow(robot.goal)
            elif not np.array_equal(goal.angles, robot.goal):
                robot.goal = goal.angles
        goal = self.goals[self.selected]
        is_shown = self.robots[self.selected].controller.needs_target and not self.is_past
        if not is_shown:
            self._toggles.handles = None
            return
        pose = goal.flange(self.base(self.selected)) if self.has_handles else None
        if pose is None and goal.mark is None:
            self._toggles.handles = None
        else:
            lit = self._handle[0] if self._handle is not None else self._lit
            self._toggles.handles = Handles(pose, lit, goal.mark)

    def hover(self, at: Pixel | None) -> bool:
        """Highlights the handle under the pointer, and returns whether there is one."""
        found = None if at is None else self.shown.decor.handle_at(at, _NEAR)
        self._lit = -1 if found is None else found
        return found is not None

    def grab_handle(self, at: Pixel) -> Grab | None:
        """Grabs the handle at a pixel."""
        handles = self._toggles.handles
        handle = None if handles is None else self.shown.decor.handle_at(at, _NEAR)
        if handle is None or handles is None or handles.pose is None:
            return None
        self._handle, self._at, self.is_on = (handle, handles.pose, at), at, True
        self.goals[self.selected].hold_posture()
        return Grab("")

    def grab(self, at: Pixel) -> Grab | None:
        """Grabs the link of a target's double at a pixel."""
        found = self._found(at)
        if found is None:
            return None
        robot, link, label = found
        point = self.shown.decor.point_at(self._mirror.data, at)
        if point is None:
            return None
        frames = self._frames(robot)
        R, p = frames[link, :3, :3], frames[link, :3, 3]
        self._point = (robot, link, R.T @ (point - p))
        self._at, self.is_on, self.selected = at, True, robot
        self.goals[robot].hold_posture()
        return Grab(f"moves {label}")

    def announce(self, at: Pixel) -> Grab | None:
        """Returns what a drag from a pixel would move."""
        found = self._found(at)
        return None if found is None else Grab(f"drag to move {found[2]}")

    def _found(self, at: Pixel) -> tuple[str, int, str] | None:
        picked = self.shown.decor.pick(self._mirror.data, at) if self._doubles else None
        if picked is None or picked.kind != "double" or picked.owner not in self._doubles:
            return None
        robot = self._doubles[picked.owner]
        label = picked.name.partition("/")[2]
        return robot, link_number(self.goals[robot].robot, label), picked.name

    def _frames(self, robot: str) -> Array:
        """Returns the frames of a target's base and links, shape (n + 1, 4, 4), in m."""
        goal = self.goals[robot]
        return goal.robot.kinematics.frames(goal.angles, self.base(robot))

    def move(self, at: Pixel) -> None:
        self._at = at

    def drag(self) -> str:
        """Moves the target to the pointer. Returns the reason if this is impossible."""
        view = self.shown.decor.view
        if view is None or not self.is_on:
            return ""
        if self.is_past:
            return "the past cannot be changed. Press End to return to the current time"
        if self._handle is not None:
            handle, pose, begin = self._handle
            goal, base = self.goals[self.selected], self.base(self.selected)
            goal.move_flange(base, dragged(pose, handle, view, begin, self._at))
            return goal.trouble
        if self._point is not None:
            robot, link, point = self._point
            goal, base = self.goals[robot], self.base(robot)
            T = self._frames(robot)[link]
            there = T[:3, :3] @ point + T[:3, 3]
            ray = view.at(np.array(self._at, float), 1.0)
            goal.move_point(base, link, point, target_of(view.position, view.forward, there, ray))
            return goal.trouble
        return ""

    def release(self) -> None:
        for goal in self.goals.values():
            goal.let_go()
        self._handle = self._point = None
        self.is_on = False
