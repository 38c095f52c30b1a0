"""Per-joint values that decor shows: received values and those computed from them."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array
from ...robots.assemble.friction_torques import friction_torques
from ...robots.assemble.gravity_torques import gravity_torques
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot_parts import ARROW_QUANTITIES
from ...robots.declared.torque_units import TorqueUnit
from .singularity import towards_singularity

QUANTITY_NAMES = {
    "torques": "torque",
    "torque_error": "torque error",
    "joint_accelerations": "acceleration",
    "singularity": "towards singularity",
    "torque_without_gravity": "torque without gravity",
    "torque_without_friction": "torque without friction",
}
# A value above this multiple of its limit is considered a fault of its source.
IMPLAUSIBLE_FACTOR = 1e3
DOUBTFUL_FACTOR = 10.0  # above it the arrow, which is striped, is not enough


def joint_values(world: WorldView, data: mujoco.MjData) -> dict[str, Array]:
    """Returns all received values of all joints, and those computed from them.

    Where the largest torque so far is the scale of a joint, these torques count from here on.

    Returns:
        arrays (N,) by name: all per-joint inputs, `joint_angles`, and `torque_error`
        (commanded - measured); NaN for no data.
    """
    data = world.state(data)
    joints, userdata = world.joints, data.userdata
    values: dict[str, Array] = {"joint_angles": joints.angles(data)}
    for key, slots in joints.slots.items():
        received = userdata[slots]
        received[(userdata[joints.has[key]] <= 0) | (slots < 0)] = np.nan
        values[key] = received
    if joints.is_largest.any():
        for key in ("torques", "commanded_torques"):
            joints.note_largest(values[key], IMPLAUSIBLE_FACTOR)
    values["torque_error"] = values["commanded_torques"] - values["torques"]
    return values


def torque_and_unit(world: WorldView, joint: int) -> tuple[str, TorqueUnit]:
    """Returns how the torque of a joint is called, and its unit: a force where it slides."""
    what = "torque" if world.joints.revolute[joint] else "force"
    return what, world.joints.torque_units[joint]


def torque_text(world: WorldView, joint: int, value: float) -> str:
    """Returns a torque of a joint, Nm or N, with three digits and the joint's unit."""
    factor, unit = world.joints.torque_units[joint]
    return f"{factor * value:.3g} {unit}"


def _limit_name(world: WorldView, joint: int) -> str:
    return "the largest seen" if world.joints.is_largest[joint] else "the limit"


def implausible_torques(world: WorldView, values: dict[str, Array]) -> list[str]:
    """Returns messages for torques over `DOUBTFUL_FACTOR` times their limit."""
    joints, torques = world.joints, values["torques"]
    share = np.abs(torques) / joints.torque_limit
    found = np.flatnonzero(share > DOUBTFUL_FACTOR)  # not NaN
    return [
        f"{joints.names[i]}: {torque_text(world, i, torques[i])} is "
        + (
            f"over {IMPLAUSIBLE_FACTOR:.0f} times {_limit_name(world, i)}; not drawn"
            if share[i] > IMPLAUSIBLE_FACTOR
            else f"{share[i]:.0f} times {_limit_name(world, i)}"
        )
        for i in found.tolist()
    ]


def arrow_values(
    world: WorldView, data: mujoco.MjData, values: dict[str, Array], quantity: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Returns the value that every joint's arrow shows, and the value of full width.

    Args:
        quantity: index in `ARROW_QUANTITIES`, (N,).

    Returns:
        values (N,), NaN for no data, and limits (N,), inf for none.
    """
    joints = world.joints
    shown = np.full(len(joints.names), np.nan)
    limit = joints.torque_limit.copy()
    for code in set(quantity.tolist()):
        at = quantity == code
        name = ARROW_QUANTITIES[code]
        if name == "singularity":
            for part in world.owners.values():
                if at[part.joints].any():
                    shown[part.joints] = np.where(
                        at[part.joints], towards_singularity(world, data, part), shown[part.joints]
                    )
            limit[at] = 1.0
            continue
        if name == "torque_without_gravity":
            shown[at] = (values["torques"] - gravity_torques(world, data))[at]
            continue
        if name == "torque_without_friction":
            shown[at] = (values["torques"] - friction_torques(world, data))[at]
            continue
        shown[at] = values[name][at]
        if name == "joint_accelerations":
            limit[at] = joints.acceleration_limit[at]
    bounded = np.isfinite(limit)
    with np.errstate(invalid="ignore"):
        shown[bounded & (np.abs(shown) > IMPLAUSIBLE_FACTOR * limit)] = np.nan
    return shown, limit


def joint_name(world: WorldView, joint: int) -> str:
    """Returns the name of a joint with its robot or double: `lwr/A4`."""
    owner = list(world.owners)[int(world.joints.owner[joint])]
    name = world.joints.names[joint]
    return name if name.startswith(f"{owner}/") else f"{owner}/{name}"
