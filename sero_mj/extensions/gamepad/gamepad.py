"""`Gamepad`: moves the camera and targets, selects joints and controls time with a gamepad.

Buttons and axes follow SDL's gamepad mappings, which GLFW includes, and have the names of an Xbox
controller.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import glfw
import numpy as np

from ...base.frames import Array, rotation_about
from ...viewer.session.joint_goal import JointGoal
from ...viewer.session.keys import Row
from ...viewer.session.tool import Shown, Tool

# These are the names of the buttons in GLFW's order.
BUTTONS = ("A", "B", "X", "Y", "LB", "RB", "Back", "Start", "Guide", "left stick", "right stick",
           "up", "right", "down", "left")  # fmt: skip
# For each button: the key that it presses, and a description.
PAD_KEYS: dict[str, tuple[str, str]] = {
    "A": (" ", "pause or continue"),
    "B": ("p", "plot the torques of the selected joint"),
    "X": ("a", "arrows on or off"),
    "Y": ("b", "billboards on or off"),
    "LB": ("[", "select the previous joint"),
    "RB": ("]", "select the next joint"),
    "left": ("left", "1 s back"),
    "right": ("right", "1 s forward"),
    "up": ("e", "next mark or fault"),
    "down": ("w", "previous mark or fault"),
    "Back": ("h", "help"),
    "Start": ("0", "initial view"),
    "right stick": ("ctrl+z", "undo"),
}
_IN_HELP = {"right stick": "right stick pressed",
            **{name: f"D-pad {name}" for name in ("up", "right", "down", "left")}}  # fmt: skip
PAD_STICKS: dict[str, str] = {
    "left stick": "rotate the view, or move the target in the image plane",
    "right stick": "pan the view, or move the target in depth and rotate it about z",
    "triggers": "zoom",
    "left stick pressed": "switch between view and target",
}
_SWITCH = "left stick"  # button that switches between view and target
_DEAD_ZONE = 0.15
_ORBIT, _PAN = 0.7, 0.5  # speeds of an equivalent mouse drag, image heights per s
_ZOOM = 12.0  # speed of an equivalent wheel rotation, notches per s
_SPEED, _SPIN = 0.25, np.deg2rad(45.0)  # maximum speeds of a target, m/s and rad/s
_SEARCH_INTERVAL = 1.0  # time between searches for a gamepad, s
_MAX_FRAME = 0.1  # maximum time of a frame, s; otherwise, the view could jump


class PadState(NamedTuple):
    """The state of a gamepad.

    Attributes:
        name: name of the gamepad.
        buttons: whether each button of `BUTTONS` is pressed, length 15.
        axes: positions of the axes from -1 to 1, length 6: left stick x and y, right stick x and y,
            left trigger and right trigger. The y axes point down.
    """

    name: str
    buttons: tuple[bool, ...]
    axes: tuple[float, ...]


class PadReader:
    """Callable that returns the state of the first connected gamepad, or None if there is none."""

    def __init__(self) -> None:
        self._joystick = -1
        self._searched = float("-inf")

    def __call__(self) -> PadState | None:
        if self._joystick < 0:
            now = time.monotonic()
            if now - self._searched < _SEARCH_INTERVAL:
                return None
            self._searched = now
            found = (k for k in range(glfw.JOYSTICK_LAST + 1) if glfw.joystick_is_gamepad(k))
            self._joystick = next(found, -1)
            if self._joystick < 0:
                return None
        state: Any = glfw.get_gamepad_state(self._joystick)
        if not state:
            self._joystick = -1
            return None
        name: Any = glfw.get_gamepad_name(self._joystick) or "gamepad"
        text = name.decode(errors="replace") if isinstance(name, bytes) else str(name)
        return PadState(text, tuple(map(bool, state.buttons)), tuple(map(float, state.axes)))


class Gamepad(Tool):
    """Tool that applies the input of a gamepad to a window. On pages, it does nothing.

    Attributes:
        read: function that returns the state of the gamepad, or None if there is none.
        moves_target: True if the sticks move a target, False if they move the view.
    """

    order: ClassVar[int] = 5  # The tools that move targets and robots must come later.

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        self.read = PadReader()
        self.moves_target = False
        self._name = ""
        self._pressed: tuple[bool, ...] = (False,) * len(BUTTONS)

    def help_rows(self) -> Sequence[Row]:
        if not self.shown.is_window:
            return []
        buttons = [(_IN_HELP.get(name, name), words) for name, (_, words) in PAD_KEYS.items()]
        return [("Gamepad", ""), *PAD_STICKS.items(), *buttons]

    def advance(self, passed: float) -> None:
        if not self.shown.is_window:
            return
        state = self.read()
        if state is None:
            if self._name:
                self.shown.say(f"{self._name} is disconnected")
                self._name, self.moves_target = "", False
                self._pressed = (False,) * len(BUTTONS)
            return
        if state.name != self._name:
            self._name = state.name
            self.shown.say(f"{state.name}: the sticks rotate and pan the view; h lists the buttons")
        for name, is_down, was in zip(BUTTONS, state.buttons, self._pressed, strict=False):
            if is_down and not was:
                self._press(name)
        self._pressed = state.buttons
        passed = min(passed, _MAX_FRAME)
        sticks = deflection(np.array(state.axes[:4]))
        triggers = (np.array(state.axes[4:6]) + 1.0) / 2.0  # At rest, a trigger is at -1.
        left, right = deflection(triggers).tolist()
        self._stick(sticks * passed, (right - left) * passed)

    def _press(self, name: str) -> None:
        if name == _SWITCH:
            goal = self._goal()
            self.moves_target = not self.moves_target and goal is not None
            if self.moves_target and goal is not None:
                what = f"the sticks move {goal[0]}"
            else:
                what = "this scene has no target" if goal is None else "the sticks move the view"
            self.shown.say(f"gamepad: {what}")
        elif name in PAD_KEYS:
            self.shown.actions.press(PAD_KEYS[name][0])

    def _goal(self) -> tuple[str, JointGoal, Array] | None:
        found = self.shown.tools.first(lambda tool: tool.goal())
        return None if found is None else found[1]

    def _stick(self, sticks: Array, zoom: float) -> None:
        goal = self._goal() if self.moves_target else None
        camera = self.shown.camera_control
        if goal is not None and sticks.any():
            self._move_target(goal[1], goal[2], sticks)
        elif goal is None and sticks[:2].any():
            camera.move("orbit", *(-_ORBIT * sticks[:2]).tolist())
        if goal is None and sticks[2:].any():
            camera.move("pan", *(-_PAN * sticks[2:]).tolist())
        if zoom:
            camera.move("zoom", 0.0, _ZOOM * zoom)

    def _move_target(self, goal: JointGoal, base: Array, sticks: Array) -> None:
        view = self.shown.decor.view
        if view is None:
            return
        right, down, turn, back = sticks.tolist()
        forward = view.forward * [1.0, 1.0, 0.0]  # The target moves horizontally.
        length = float(np.linalg.norm(forward))
        forward = forward / length if length > 1e-6 else view.up
        pose = goal.flange(base)
        pose[:3, 3] += _SPEED * (right * view.right - down * view.up - back * forward)
        if turn:
            pose[:3, :3] = rotation_about(2, -_SPIN * turn) @ pose[:3, :3]
        goal.move_flange(base, pose)


def deflection(axes: Array) -> Array:
    """Applies a dead zone and a quadratic response to axis positions from -1 to 1, shape (k,)."""
    beyond = np.clip((np.abs(axes) - _DEAD_ZONE) / (1.0 - _DEAD_ZONE), 0.0, 1.0)
    return np.asarray(np.sign(axes) * beyond**2)
