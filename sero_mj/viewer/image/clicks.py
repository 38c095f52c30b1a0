"""Actions of clicks, double clicks and Shift+clicks, and of the keys that switch features.

Windows, pages and images use the same tables, from which the help is generated. `picking.pick`
finds the item at a pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import mujoco
import numpy as np

from ...base.frames import Ints
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot_parts import ARROW_QUANTITIES
from ..decor.limb_billboards import billboard_limbs
from ..decor.quantities import QUANTITY_NAMES, arrow_values, joint_values
from ..decor.toggles import Toggles
from .picking import Picked, Pixel

Gesture = Literal["click", "shift", "double"]
Action = Callable[[WorldView, Toggles, Picked], None]
Rows = Callable[[WorldView, Picked], Any]  # returns indices of the joints or frames of an action


def _item(world: WorldView, picked: Picked) -> int:
    return picked.index


def _joints(world: WorldView, picked: Picked) -> slice:
    return world.owners[picked.owner].joints


def _frames(world: WorldView, picked: Picked) -> Any:
    if picked.owner not in world.owners:
        return [picked.index]
    return world.frames.owner == list(world.owners).index(picked.owner)


def _limb(world: WorldView, picked: Picked) -> Ints:
    limb, owner = world.joints.limb, world.joints.owner
    mine = limb == limb[picked.index]
    branches = (owner[~mine] == owner[picked.index]).any()
    return mine.nonzero()[0] if branches else np.array([picked.index])


def _everything(world: WorldView, picked: Picked) -> slice:
    return slice(None)


def _flip(field: str, rows: Rows = _item) -> Action:
    def act(world: WorldView, toggles: Toggles, picked: Picked) -> None:
        shown, where = getattr(toggles, field), rows(world, picked)
        shown[where] = not shown[where].any()

    return act


def _hide(fields: tuple[str, ...], rows: Rows = _item) -> Action:
    def act(world: WorldView, toggles: Toggles, picked: Picked) -> None:
        for name in fields:
            getattr(toggles, name)[rows(world, picked)] = False

    return act


def _flip_limb(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    rows = _limb(world, picked)
    show = not (toggles.billboards[rows].all() and (len(rows) == 1 or toggles.clicked[rows].all()))
    toggles.billboards[rows] = toggles.clicked[rows] = show


def _card_limb(world: WorldView, picked: Picked) -> Ints:
    return billboard_limbs(world).joints_of(picked.index)


def _open_limb(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    rows = _card_limb(world, picked)
    toggles.clicked[rows] = True


def _next_quantity_here(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    following = toggles.arrow_quantity[picked.index] + 1
    toggles.arrow_quantity[_joints(world, picked)] = following % len(ARROW_QUANTITIES)


def _hide_checks(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    toggles.flange_checks = False


def _do_nothing(world: WorldView, toggles: Toggles, picked: Picked) -> None: ...


_BILLBOARD = ("billboards", "details")
# Mapping from gesture and kind of item to the description and the action.
CLICKS: dict[tuple[Gesture, str], tuple[str, Action]] = {
    ("click", "link"): ("billboards of the joint or limb on or off", _flip_limb),
    ("shift", "link"): ("all billboards of the robot on or off", _flip("billboards", _joints)),
    ("double", "link"): ("all axes of the robot on or off", _flip("axes", _frames)),
    ("click", "billboard"): ("hide the billboard", _hide(_BILLBOARD)),
    ("shift", "billboard"): ("hide all billboards of the robot", _hide(_BILLBOARD, _joints)),
    ("click", "arrow"): ("exact values of the arrow on or off", _flip("details")),
    ("shift", "arrow"): ("exact values of all arrows on or off", _flip("details", _joints)),
    ("double", "arrow"): ("next quantity for all arrows of the robot", _next_quantity_here),
    ("click", "axes"): ("name of the frame on or off", _flip("frame_names")),
    ("shift", "axes"): ("names of all axes of the robot on or off", _flip("frame_names", _frames)),
    ("double", "axes"): ("hide the axes", _hide(("axes", "frame_names"))),
    ("click", "name"): ("hide the name", _flip("frame_names")),
    ("shift", "name"): ("hide all names of the robot", _flip("frame_names", _frames)),
    ("click", "vector"): ("values of the arrow on or off", _flip("cards")),
    ("shift", "vector"): ("values of all smart arrows on or off", _flip("cards", _everything)),
    ("click", "card"): ("hide the values", _flip("cards")),
    ("shift", "card"): ("hide the values of all smart arrows", _flip("cards", _everything)),
    ("click", "limb"): ("show one billboard for each joint", _open_limb),
    ("shift", "limb"): ("hide the billboard", _hide(_BILLBOARD, _card_limb)),
    ("click", "check"): ("hide the comparison of flange frames", _hide_checks),
    # The window or page centers the view.
    ("double", "object"): ("center the view on the object", _do_nothing),
}
# Clicks on transparent doubles have the same effect as clicks on robots.
CLICKS |= {
    (gesture, "double"): entry for (gesture, kind), entry in CLICKS.items() if kind == "link"
}


def click(
    world: WorldView, toggles: Toggles, picked: Picked | None, gesture: Gesture = "click"
) -> bool:
    """Performs the action of a gesture on an item (`CLICKS`), and returns whether it has an action.

    A double click on the background resets the toggles to those of the scene.
    """
    if picked is None:
        if gesture == "double":
            toggles.reset()
        return gesture == "double"
    if (gesture, picked.kind) not in CLICKS:
        return False
    if picked.kind in ("link", "double"):
        owner = world.owners.get(picked.owner)
        if owner is None or not owner.robot.enable_touch_sensor:
            return False
    CLICKS[gesture, picked.kind][1](world, toggles, picked)
    return True


def hover(toggles: Toggles, picked: Picked | None, pixel: Pixel) -> None:
    """Shows the name of the item under the pointer, from the next frame on.

    Args:
        picked: item under the pointer, or None.
        pixel: position of the pointer.
    """
    # A billboard already shows its name, and the label would hide its values.
    name = "" if picked is None or picked.kind in ("billboard", "limb") else picked.own_name
    toggles.hover = (name, pixel) if name else None


def _next_quantity(toggles: Toggles) -> None:
    toggles.arrow_quantity[:] = (toggles.arrow_quantity + 1) % len(ARROW_QUANTITIES)


def _toggle(name: str) -> Callable[[Toggles], None]:
    def toggle(toggles: Toggles) -> None:
        shown = getattr(toggles, name)
        if isinstance(shown, bool):
            setattr(toggles, name, not shown)
        else:
            shown[:] = not shown.any()

    return toggle


# Mapping from keys to a field of `Toggles` and its description.
SWITCHES: dict[str, tuple[str, str]] = {
    "a": ("arrows", "arrows"),
    "b": ("billboards", "billboards"),
    "x": ("axes", "axes"),
    "n": ("frame_names", "names of axes"),
    "d": ("doubles", "transparent doubles"),
    "v": ("vectors", "smart arrows"),
    "c": ("flange_checks", "comparison of flange frames"),
    "l": ("legend", "legend"),
    "s": ("status", "errors of the sources"),
}
KeyAction = tuple[str, Callable[[Toggles], None]]


def _toggle_keys(keys: str) -> dict[str, KeyAction]:
    return {key: (f"{SWITCHES[key][1]} on or off", _toggle(SWITCHES[key][0])) for key in keys}


# Mapping from keys to their description and action.
KEYS: dict[str, KeyAction] = {
    **_toggle_keys("abx"),
    "n": ("names of all axes on or off", _toggle("frame_names")),  # a click: only one name
    "q": ("next quantity for all arrows", _next_quantity),
    **_toggle_keys("dvcls"),
    "r": ("reset to the declared values", Toggles.reset),
}


def press_toggle(key: str, world: WorldView, data: mujoco.MjData, toggles: Toggles) -> str:
    """Performs the action of a key of `KEYS`, and returns a message with the new state."""
    description, act = KEYS[key]
    act(toggles)
    if key == "q" or (key == "a" and toggles.arrows.any()):
        return _arrows_text(world, data, toggles)
    if key not in SWITCHES:
        return description
    field, name = SWITCHES[key]
    shown = np.atleast_1d(getattr(toggles, field))
    if not len(shown):
        return f"no {name} in this scene"
    return f"{name}: {'on' if shown.any() else 'off'}"


def _arrows_text(world: WorldView, data: mujoco.MjData, toggles: Toggles) -> str:
    quantity = toggles.arrow_quantity
    if not len(quantity):
        return "no arrows in this scene"
    names = [QUANTITY_NAMES[ARROW_QUANTITIES[code]] for code in np.unique(quantity)]
    text = f"arrows: {', '.join(names)}"
    if not toggles.arrows.any():
        return f"{text} (they are off: a)"
    values, _ = arrow_values(world, data, joint_values(world, data), quantity)
    return text if np.isfinite(values[toggles.arrows]).any() else f"{text} (no data)"
