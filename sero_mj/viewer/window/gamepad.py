"""`Gamepad`: camera, selection, time and targets by a gamepad.

Buttons and axes are those of SDL's mappings, which GLFW has of some thousand gamepads: the same
places on all of them, with the names that they have on an Xbox pad.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import glfw
import numpy as np

from ...base.frames import Array, rotation_about
from ..host.live import LiveHost
from ..session.joint_goal import JointGoal

# Names of the buttons, in GLFW's order.
BUTTONS = ("A", "B", "X", "Y", "LB", "RB", "Back", "Start", "Guide", "left stick", "right stick",
           "up", "right", "down", "left")  # fmt: skip
# Key of the keyboard that a button stands for, and what it does.
PAD_KEYS: dict[str, tuple[str, str]] = {
    "A": (" ", "pause or continue"),
    "B": ("p", "torques of the selected joint"),
    "X": ("a", "arrows on or off"),
    "Y": ("b", "billboards on or off"),
    "LB": ("[", "select the previous joint"),
    "RB": ("]", "select the next joint"),
    "left": ("left", "1 s back"),
    "right": ("right", "1 s on"),
    "up": ("e", "next mark or fault"),
    "down": ("w", "the one before"),
    "Back": ("h", "help"),
    "Start": ("0", "initial view"),
    "right stick": ("ctrl+z", "pressed: undo"),
}
PAD_STICKS: dict[str, str] = {
    "left stick": "turns the view; the target along the picture",
    "right stick": "moves the view; the target nearer, and about z",
    "triggers": "zoom",
    "left stick pressed": "moves the target instead of the view, or back",
}
_STEERS = "left stick"  # the button
_DEAD = 0.15  # of a stick's way, in which it rests
_TURN, _PAN = 0.7, 0.5  # heights of the picture per s, by a drag as far
_ZOOM = 12.0  # notches of the wheel per s
_SPEED, _SPIN = 0.25, np.deg2rad(45.0)  # of a target, m/s and rad/s
_LOOK_AGAIN = 1.0  # s between two looks for a gamepad
_LONGEST = 0.1  # s; a stick that was held during a hitch does not jump


class PadState(NamedTuple):
    """What a gamepad's user does.

    Attributes:
        name: of the gamepad.
        buttons: which are pressed, (15,), as `BUTTONS`.
        axes: left stick x and y, right stick x and y, left and right trigger; -1 to 1, y down.
    """

    name: str
    buttons: tuple[bool, ...]
    axes: tuple[float, ...]


class PadReader:
    """Reads the first gamepad that is plugged in."""

    def __init__(self) -> None:
        self._joystick = -1
        self._looked = float("-inf")

    def __call__(self) -> PadState | None:
        if self._joystick < 0:
            now = time.monotonic()
            if now - self._looked < _LOOK_AGAIN:
                return None
            self._looked = now
            there = (k for k in range(glfw.JOYSTICK_LAST + 1) if glfw.joystick_is_gamepad(k))
            self._joystick = next(there, -1)
            if self._joystick < 0:
                return None
        state: Any = glfw.get_gamepad_state(self._joystick)
        if not state:
            self._joystick = -1
            return None
        name: Any = glfw.get_gamepad_name(self._joystick) or "gamepad"
        text = name.decode(errors="replace") if isinstance(name, bytes) else str(name)
        return PadState(text, tuple(map(bool, state.buttons)), tuple(map(float, state.axes)))


class Gamepad:
    """Acts on a host as a gamepad's user wants.

    Args:
        move: turns, pans or zooms the view: `orbit`, `pan` or `zoom`, to the right and down, in
            heights of the picture, or notches.

    Attributes:
        steers: whether the sticks move a target, and not the view.
    """

    def __init__(
        self,
        host: LiveHost,
        move: Callable[[str, float, float], None],
        read: Callable[[], PadState | None] | None = None,
    ) -> None:
        self._host, self._move = host, move
        self.read = read or PadReader()
        self.steers = False
        self._name = ""
        self._pressed: tuple[bool, ...] = (False,) * len(BUTTONS)
        self._last = time.monotonic()

    def update(self) -> None:
        now = time.monotonic()
        passed, self._last = min(now - self._last, _LONGEST), now
        state = self.read()
        if state is None:
            if self._name:
                self._host.say(f"{self._name} is unplugged; nothing moves by it")
                self._name, self.steers = "", False
                self._pressed = (False,) * len(BUTTONS)
            return
        if state.name != self._name:
            self._name = state.name
            self._host.say(f"{state.name}: sticks turn and move the view; h has the buttons")
        for name, is_down, was in zip(BUTTONS, state.buttons, self._pressed, strict=False):
            if is_down and not was:
                self._press(name)
        self._pressed = state.buttons
        sticks = bent(np.array(state.axes[:4]))
        pull = (np.array(state.axes[4:6]) + 1.0) / 2.0  # they rest at -1
        self._stick(sticks * passed, float(bent(pull[1:])[0] - bent(pull[:1])[0]) * passed)

    def _press(self, name: str) -> None:
        if name == _STEERS:
            goal = self._goal()
            self.steers = not self.steers and goal is not None
            what = "nothing here has a target" if goal is None else "moves the view"
            self._host.say(f"gamepad: {f'moves {goal[0]}' if self.steers and goal else what}")
        elif name in PAD_KEYS:
            self._host.actions.press(PAD_KEYS[name][0])

    def _goal(self) -> tuple[str, JointGoal, Array] | None:
        found = self._host.tools.first(lambda tool: tool.goal())
        return None if found is None else found[1]

    def _stick(self, sticks: Array, zoom: float) -> None:
        goal = self._goal() if self.steers else None
        if goal is not None and sticks.any():
            self._steer(goal[1], goal[2], sticks)
        elif goal is None and sticks[:2].any():
            self._move("orbit", *(-_TURN * sticks[:2]).tolist())
        if goal is None and sticks[2:].any():
            self._move("pan", *(-_PAN * sticks[2:]).tolist())
        if zoom:
            self._move("zoom", 0.0, _ZOOM * zoom)

    def _steer(self, goal: JointGoal, base: Array, sticks: Array) -> None:
        view = self._host.decor.view
        if view is None:
            return
        right, down, turn, back = sticks.tolist()
        away = view.forward * [1.0, 1.0, 0.0]  # level, however steep the look is
        length = float(np.linalg.norm(away))
        away = away / length if length > 1e-6 else view.up
        pose = goal.flange(base)
        pose[:3, 3] += _SPEED * (right * view.right - down * view.up - back * away)
        if turn:
            pose[:3, :3] = rotation_about(2, -_SPIN * turn) @ pose[:3, :3]
        goal.move_flange(base, pose)


def bent(ways: Array) -> Array:
    """Returns how far sticks are meant, -1 to 1: nothing near rest, finer at first than at the end.

    Args:
        ways: how far they are pushed, -1 to 1, (k,).
    """
    beyond = np.clip((np.abs(ways) - _DEAD) / (1.0 - _DEAD), 0.0, 1.0)
    return np.asarray(np.sign(ways) * beyond**2)
