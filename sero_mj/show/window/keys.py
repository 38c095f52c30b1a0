"""What the keys of `interaction.HOST_KEYS` do in a window."""

from __future__ import annotations

import time
from typing import Protocol

import mujoco

from ...assemble.world import World
from ...errors import SeroError
from ..clock import Clock
from ..events import Event
from ..interaction import HOST_KEYS, MORE_KEYS
from ..picking import Picked
from ..torque_history import joint_name
from .camera import Navigator
from .film import Camera
from .gl import GlWindow

_HELD = ("step", "step_back", "back", "on", "slower", "faster", "next_joint", "last_joint")
_JUMP = 1.0  # s


class Keyed(Protocol):
    """What keys act on: a `Window`."""

    world: World
    data: mujoco.MjData
    gl: GlWindow
    clock: Clock
    navigator: Navigator
    camera: Camera
    joint: int
    shows_plot: bool
    shows_status: bool
    shows_help: bool
    wants_picture: bool

    @property
    def picture_size(self) -> tuple[int, int]:
        """Width and height of the picture, pixels."""

    def say(self, text: str, *, is_bad: bool = False) -> None:
        """Writes a line into the window for a few seconds."""

    def pick_under_pointer(self) -> Picked | None:
        """What is under the pointer."""

    def next_help_page(self) -> None:
        """Shows the help, its next page, or no help any more."""


class WindowKeys:
    """Finds the method that a key calls.

    Args:
        window: whose keys they are.
    """

    def __init__(self, window: Keyed) -> None:
        self._window = window

    def press(self, event: Event) -> None:
        """Does what the key does, if it does anything."""
        window = self._window
        if event.key == "escape":
            self._escape()
            return
        name = HOST_KEYS[event.key][0] if event.key in HOST_KEYS else MORE_KEYS.get(event.key)
        if name is None or (event.is_repeat and name not in _HELD):
            return
        if name == "camera":
            window.say(window.navigator.choose(int(event.key)))
            return
        said = getattr(self, f"_{name}")()
        if said:
            window.say(said)

    def _escape(self) -> None:
        window = self._window
        if window.shows_help:
            window.shows_help = False
        elif window.gl.is_full_screen:
            window.gl.toggle_full_screen()

    def _pause(self) -> str:
        return self._window.clock.pause()

    def _step(self) -> str:
        return self._window.clock.step()

    def _step_back(self) -> str:
        return self._window.clock.step(-1)

    def _slower(self) -> str:
        return self._window.clock.faster(-1)

    def _faster(self) -> str:
        return self._window.clock.faster(1)

    def _reset(self) -> str:
        return self._window.clock.reset()

    def _back(self) -> None:
        self._window.clock.seek(self._window.clock.time - _JUMP)

    def _on(self) -> None:
        self._window.clock.seek(self._window.clock.time + _JUMP)

    def _follow(self) -> str:
        window = self._window
        picked = window.pick_under_pointer()
        if picked is None or picked.name not in window.world.frames.names:
            return window.navigator.follow(window.data, None)
        return window.navigator.follow(window.data, picked.name)

    def _plot(self) -> str:
        window = self._window
        window.shows_plot = not window.shows_plot
        if not window.world.joints.names:
            return "no joint to plot"
        return ""

    def _next_joint(self, places: int = 1) -> str:
        window = self._window
        names = window.world.joints.names
        if not names:
            return "no joint"
        window.joint = (window.joint + places) % len(names)
        return f"selected: {joint_name(window.world, window.joint)}"

    def _last_joint(self) -> str:
        return self._next_joint(-1)

    def _status_line(self) -> None:
        self._window.shows_status = not self._window.shows_status

    def _screenshot(self) -> None:
        self._window.wants_picture = True

    def _film(self) -> str:
        window = self._window
        if window.camera.is_filming:
            window.camera.stop()
            return "the film ends"
        rect = window.picture_size
        try:
            return window.camera.start(rect, time.monotonic())
        except SeroError as error:
            window.say(str(error), is_bad=True)
            return ""

    def _full_screen(self) -> None:
        self._window.gl.toggle_full_screen()

    def _help(self) -> None:
        self._window.next_help_page()
