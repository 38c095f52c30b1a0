"""Switches of `Toggles` as text, for commands and links."""

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
# Also accepted, but not settable: whether torques are those of the model, as the legend says.
MODELLED = "modelled"
# The largest digit of switches that are not on or off.
_MOST = {"arrow_quantity": len(ARROW_QUANTITIES) - 1, "part_names": len(PART_NAMES) - 1}


def switches_text(world: WorldView, toggles: Toggles) -> dict[str, str]:
    """Returns switches that differ from the declared ones: a digit per item, or one for all."""
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
    world: WorldView, toggles: Toggles, given: Mapping[str, str], selected: str | None = None
) -> None:
    """Sets switches.

    Args:
        given: by name, see `SWITCH_NAMES`: a digit for each item (joint, frame, ...), or one for
            all; 1 is on, `arrow_quantity` counts the quantities from 0, and `part_names` is an
            index of `PART_NAMES`.

    Raises:
        UsageError: no such switch, other digits, or not as many as there are items.
        UnknownName: no such joint.
    """
    if selected is not None:
        toggles.selected = find_joint(world, selected)
    for name, digits in given.items():
        if name not in (*SWITCH_NAMES, MODELLED):
            raise UsageError(f"no switch '{name}'{did_you_mean(name, SWITCH_NAMES)}")
        most = _MOST.get(name, 1)
        if not digits or any(digit not in "0123456789"[: most + 1] for digit in digits):
            raise UsageError(f"{name}: found '{digits}'; expected digits from 0 to {most}")
        now = getattr(toggles, name)
        count = 1 if isinstance(now, int) else len(now)
        if len(digits) not in (1, count):
            many = f", or {count}: one for each" if count > 1 else ""
            raise UsageError(f"{name}: found {len(digits)} digits; expected one{many}")
        if isinstance(now, int):  # a bool, too
            setattr(toggles, name, type(now)(int(digits)))
            continue
        now[:] = [int(digit) for digit in digits] if len(digits) == len(now) else int(digits)


def find_joint(world: WorldView, name: str) -> int:
    """Returns the index of a joint, `lwr/A2`; raises UnknownName if there is none."""
    names = [joint_name(world, i) for i in range(len(world.joints.names))]
    if name not in names:
        raise UnknownName("joint", name, names)
    return names.index(name)
