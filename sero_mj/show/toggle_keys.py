"""Keys that switch what is shown, and what the user is told then: what is shown now."""

from __future__ import annotations

import mujoco
import numpy as np

from ..assemble.robot_parts import ARROW_QUANTITIES
from ..assemble.world_view import WorldView
from ..decor.quantities import QUANTITY_NAMES, arrow_values, joint_values
from ..decor.toggles import Toggles
from .interaction import KEYS, SWITCHES


def press_toggle(key: str, world: WorldView, data: mujoco.MjData, toggles: Toggles) -> str:
    """Does what a key of `KEYS` means.

    Args:
        key: one of `KEYS`.
        world: the compiled scene.
        data: its state.
        toggles: changed in place.

    Returns:
        what is shown now, in words.
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
    """What the arrows show, and whether there is anything to show."""
    quantity = toggles.arrow_quantity
    if not len(quantity):
        return "no arrows in this scene"
    names = [QUANTITY_NAMES[ARROW_QUANTITIES[code]] for code in np.unique(quantity)]
    text = f"arrows: {', '.join(names)}"
    if not toggles.arrows.any():
        return f"{text} (they are off: a)"
    values, _ = arrow_values(world, data, joint_values(world, data), quantity)
    return text if np.isfinite(values[toggles.arrows]).any() else f"{text} (no data)"
