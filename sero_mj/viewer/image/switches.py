"""Converts the switches of `Toggles` from and to text, for commands and links."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...base.errors import UnknownName, UsageError, did_you_mean
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot_parts import ARROW_QUANTITIES
from ..decor.quantities import joint_name
from ..decor.toggles import PART_NAMES, Toggles

# Fields of `Toggles` that are switches.
SWITCH_NAMES = (
    "arrows", "arrow_quantity", "billboards", "details", "axes", "frame_names", "vectors", "cards",
    "doubles", "legend", "status", "flange_checks", "contacts", "inertias", "joint_axes",
    "centres_of_mass", "part_names", "transparent", "wireframe",
)  # fmt: skip
# Field of `Toggles` with the joints whose torques come from the model. Commands can set it.
MODELLED = "modelled"
# Largest digits of the switches that have more than two values.
_MAX_DIGIT = {"arrow_quantity": len(ARROW_QUANTITIES) - 1, "part_names": len(PART_NAMES) - 1}


def switches_text(world: WorldView, toggles: Toggles) -> dict[str, str]:
    """Returns the switches that differ from the declared ones, as texts for `apply_switches`."""
    declared = Toggles(world)
    found = {}
    for name in SWITCH_NAMES:
        now = np.atleast_1d(getattr(toggles, name)).astype(int)
        if np.array_equal(now, np.atleast_1d(getattr(declared, name)).astype(int)):
            continue
        digits = now[:1] if len(now) and (now == now[0]).all() else now
        found[name] = "".join(map(str, digits.tolist()))
    return found


def apply_switches(
    world: WorldView, toggles: Toggles, digits_of: Mapping[str, str], selected: str | None = None
) -> None:
    """Sets switches from texts, and selects a joint.

    Args:
        digits_of: mapping from names in `SWITCH_NAMES` to digits, with one digit for each item
            (joint, frame or arrow) or one digit for all items. Digit 1 switches an item on. For
            `arrow_quantity` and `part_names`, digits are indices.
        selected: name of the joint to select; None to keep the selection.

    Raises:
        UsageError: a switch is unknown, or its digits are invalid.
        UnknownName: the world has no joint with the selected name.
    """
    if selected is not None:
        toggles.selected = find_joint(world, selected)
    for name, digits in digits_of.items():
        if name not in (*SWITCH_NAMES, MODELLED):
            raise UsageError(f"there is no switch '{name}'{did_you_mean(name, SWITCH_NAMES)}")
        largest = _MAX_DIGIT.get(name, 1)
        if not digits or any(digit not in "0123456789"[: largest + 1] for digit in digits):
            raise UsageError(f"{name}: found '{digits}'; expected digits from 0 to {largest}")
        now = getattr(toggles, name)
        count = 1 if isinstance(now, int) else len(now)
        if len(digits) not in (1, count):
            many = f", or {count} (one for each item)" if count > 1 else ""
            raise UsageError(f"{name}: found {len(digits)} digits; expected one digit{many}")
        if isinstance(now, int):  # an index or a bool
            setattr(toggles, name, type(now)(int(digits)))
            continue
        now[:] = [int(digit) for digit in digits] if len(digits) == len(now) else int(digits)


def find_joint(world: WorldView, name: str) -> int:
    """Returns the index of a joint such as `lwr/A2`. Raises UnknownName if there is none."""
    names = [joint_name(world, i) for i in range(len(world.joints.names))]
    if name not in names:
        raise UnknownName("joint", name, names)
    return names.index(name)
