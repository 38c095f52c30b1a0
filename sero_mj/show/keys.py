"""Key handling of live hosts, by the tables of `interaction`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

import mujoco
import numpy as np

from ..assemble.robot_parts import ARROW_QUANTITIES
from ..assemble.world_view import WorldView
from ..decor.quantities import QUANTITY_NAMES, arrow_values, joint_values
from ..decor.toggles import Toggles
from .clock import Clock
from .interaction import HOST_KEYS, KEYS, MORE_KEYS, SWITCHES
from .torque_history import joint_name

Action = Callable[[], str | None]  # returns a message for the user

_REPEATED = ("step", "step_back", "back", "on", "slower", "faster", "next_joint", "last_joint")
_JUMP = 1.0  # s


class KeyHost(Protocol):
    """A live host, as seen by `KeyHandler`.

    Attributes:
        joint: the joint of the world whose torques are plotted.
    """

    world: WorldView
    data: mujoco.MjData
    toggles: Toggles
    clock: Clock
    joint: int

    def say(self, text: str, *, is_bad: bool = False) -> None:
        """Shows a message for a few seconds."""

    def choose_camera(self, number: int) -> str:
        """Selects a camera by number, 1 for the first, 0 for the initial view."""


class KeyHandler:
    """Handles the keys of a live host.

    Args:
        host: the live host.
        own: actions of the host, by the names in `interaction.HOST_KEYS`.
    """

    def __init__(self, host: KeyHost, own: Mapping[str, Action]) -> None:
        clock = host.clock
        self._host = host
        self._actions: dict[str, Action] = {
            "pause": clock.pause,
            "step": clock.step,
            "step_back": lambda: clock.step(-1),
            "slower": lambda: clock.faster(-1),
            "faster": lambda: clock.faster(1),
            "reset": clock.reset,
            "back": lambda: clock.seek(clock.time - _JUMP),
            "on": lambda: clock.seek(clock.time + _JUMP),
            "next_joint": lambda: self._select(1),
            "last_joint": lambda: self._select(-1),
            **own,
        }

    def press(self, key: str, *, is_repeat: bool = False) -> None:
        """Performs the action of a key, if it has one.

        Args:
            key: see `input.Event`.
            is_repeat: whether it is an automatic repetition.
        """
        host, message = self._host, None
        name = HOST_KEYS[key][0] if key in HOST_KEYS else MORE_KEYS.get(key)
        if is_repeat and name not in _REPEATED:
            return
        if key in KEYS:
            message = press_toggle(key, host.world, host.data, host.toggles)
        elif name == "camera":
            message = host.choose_camera(int(key))
        elif name in self._actions:
            message = self._actions[name]()
        if message:
            host.say(message)

    def _select(self, places: int) -> str:
        host = self._host
        names = host.world.joints.names
        if not names:
            return "no joint"
        host.joint = (host.joint + places) % len(names)
        return f"selected: {joint_name(host.world, host.joint)}"


def press_toggle(key: str, world: WorldView, data: mujoco.MjData, toggles: Toggles) -> str:
    """Performs the action of a key of `KEYS`.

    Args:
        key: one of `KEYS`.
        world: the compiled scene.
        data: its state.
        toggles: changed in place.

    Returns:
        a message with the new state.
    """
    words, act = KEYS[key]
    act(toggles)
    if key == "q" or (key == "a" and toggles.arrows.any()):
        return _arrows_text(world, data, toggles)
    if key not in SWITCHES:
        return words
    field, name = SWITCHES[key]
    shown = np.atleast_1d(getattr(toggles, field))
    if not len(shown):
        return f"no {name} in this scene"
    return f"{name}: {'on' if shown.any() else 'off'}"


def _arrows_text(world: WorldView, data: mujoco.MjData, toggles: Toggles) -> str:
    """Returns a message with the quantity of the arrows and whether they are shown."""
    quantity = toggles.arrow_quantity
    if not len(quantity):
        return "no arrows in this scene"
    names = [QUANTITY_NAMES[ARROW_QUANTITIES[code]] for code in np.unique(quantity)]
    text = f"arrows: {', '.join(names)}"
    if not toggles.arrows.any():
        return f"{text} (they are off: a)"
    values, _ = arrow_values(world, data, joint_values(world, data), quantity)
    return text if np.isfinite(values[toggles.arrows]).any() else f"{text} (no data)"
