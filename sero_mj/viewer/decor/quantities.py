"""Values of joints that visual features show: received values and values computed from them.

Proximity to a singularity was the first use of round arrows (reference 14 of the paper). It is
measured by the inverse condition number of the Jacobian, with lengths in units of the reach of the
robot. This number is 0 at a singularity and at most 1. Close to a singularity, the arrow of each
joint shows the direction of motion towards the singularity. Its width shows how much the joint
contributes.

Sources: inverse condition number as in Angeles, Fundamentals of Robotic Mechanical Systems, 4.9;
derivative of the Jacobian as in Haviland and Corke, Manipulator Differential Kinematics, part 2.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array
from ...robots.assemble.friction_torques import friction_torques
from ...robots.assemble.gravity_torques import gravity_torques
from ...robots.assemble.parts import Owner
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot_parts import ARROW_QUANTITIES
from ...robots.declared.torque_units import TorqueUnit

QUANTITY_NAMES = {
    "torques": "torque",
    "torque_error": "torque error",
    "joint_accelerations": "acceleration",
    "singularity": "towards singularity",
    "torque_without_gravity": "torque without gravity",
    "torque_without_friction": "torque without friction",
}
# A value above this multiple of its limit is treated as an error of its source and is not drawn.
IMPLAUSIBLE_FACTOR = 1e3
DOUBTFUL_FACTOR = 10.0  # multiple of its limit above which a torque is reported as text


def joint_values(world: WorldView, data: mujoco.MjData) -> dict[str, Array]:
    """Returns the received values of all joints, and the values computed from them.

    If the largest torque so far replaces the limit of a joint, this also updates that limit.

    Returns:
        mapping from names to the values of all joints, shape (N,), NaN for no data. The names are
        the inputs of joints, `joint_angles`, and `torque_error` (commanded - measured).
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
    """Returns "torque", or "force" for a prismatic joint, and the unit that the robot declares."""
    what = "torque" if world.joints.revolute[joint] else "force"
    return what, world.joints.torque_units[joint]


def torque_text(world: WorldView, joint: int, value: float) -> str:
    """Returns the text of a torque in Nm, or force in N, with the unit of the joint."""
    factor, unit = world.joints.torque_units[joint]
    return f"{factor * value:.3g} {unit}"


def _limit_name(world: WorldView, joint: int) -> str:
    return "the largest seen" if world.joints.is_largest[joint] else "the limit"


def implausible_torques(world: WorldView, values: dict[str, Array]) -> list[str]:
    """Returns a message for each torque that exceeds `DOUBTFUL_FACTOR` times its limit."""
    joints, torques = world.joints, values["torques"]
    share = np.abs(torques) / joints.torque_limit
    found = np.flatnonzero(share > DOUBTFUL_FACTOR)  # not NaN
    return [
        f"{joints.names[i]}: {torque_text(world, i, torques[i])} is "
        + (
            f"over {IMPLAUSIBLE_FACTOR:.0f} times {_limit_name(world, i)} and is not drawn"
            if share[i] > IMPLAUSIBLE_FACTOR
            else f"{share[i]:.0f} times {_limit_name(world, i)}"
        )
        for i in found.tolist()
    ]


def arrow_values(
    world: WorldView, data: mujoco.MjData, values: dict[str, Array], quantity: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Returns the values that the arrows of joints show, and the limits for full arrow width.

    Args:
        quantity: quantity that each arrow shows, as an index of `ARROW_QUANTITIES`, shape (N,).

    Returns:
        values, shape (N,), NaN for no data, and limits, shape (N,), inf if there is no limit.
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
    """Returns the name of a joint, preceded by that of its robot or double, such as `lwr/A4`."""
    owner = list(world.owners)[int(world.joints.owner[joint])]
    name = world.joints.names[joint]
    return name if name.startswith(f"{owner}/") else f"{owner}/{name}"


FAR = 0.15  # inverse condition number above which no arrow is shown


def towards_singularity(world: WorldView, data: mujoco.MjData, part: Owner) -> Array:
    """Returns how close a robot is to a singularity, and how each joint moves it closer.

    Returns:
        values from -1 to 1, shape (n,). The sign is the direction of motion towards the
        singularity. The largest magnitude is the proximity: 1 at the singularity, 0 if the inverse
        condition number is at least `FAR`.
    """
    towards = np.zeros(part.robot.n)
    if not len(part.chain):
        return towards
    c, gradient = inverse_condition(jacobian(world, data, part))
    nearness = np.clip(1.0 - c / FAR, 0.0, 1.0)
    largest = np.abs(gradient).max()
    if largest >= 1e-12:
        towards[part.chain] = -gradient / largest * nearness
    return towards


def jacobian(world: WorldView, data: mujoco.MjData, part: Owner) -> Array:
    """Returns the geometric Jacobian of the flange with lengths in units of the robot reach.

    The Jacobian, shape (6, m), has a column for each joint that moves the flange. It is computed
    from the sites at the joints, because a double has no degrees of freedom in MuJoCo.
    """
    chain = part.chain
    sites = world.joints.centre_site[part.joints][chain]
    rotation = data.site_xmat[sites].reshape(-1, 3, 3)
    axis = rotation[:, :, 2]
    # The site is offset from the axis by `offsets_to_center_of_joints`.
    on_axis = data.site_xpos[sites] - np.einsum("nij,nj->ni", rotation, part.robot.offsets[chain])
    flange = world.frames.names.index(part.flange_name)
    lever = data.site_xpos[world.frames.site[flange]] - on_axis
    turns = part.kinematics.revolute[chain][:, None]
    linear = np.where(turns, np.cross(axis, lever), axis) / part.reach
    return np.concatenate([linear, np.where(turns, axis, 0.0)], axis=1).T


def inverse_condition(J: Array) -> tuple[float, Array]:
    """Returns the inverse condition number of a Jacobian and its gradient by the joint positions.

    Args:
        J: Jacobian in the base frame, shape (6, n). The angular part of a prismatic joint is zero.

    Returns:
        ratio of the smallest to the largest singular value, and the gradient of this ratio, shape
        (n,), 1/rad or 1/m.
    """
    u, s, vt = np.linalg.svd(J, full_matrices=False)
    if s[0] < 1e-12:
        return 0.0, np.zeros(J.shape[1])
    H = _hessian(J)  # dJ/dq_i is H[i]
    first = np.einsum("a,iab,b->i", u[:, 0], H, vt[0])
    last = np.einsum("a,iab,b->i", u[:, -1], H, vt[-1])
    return float(s[-1] / s[0]), (last - s[-1] / s[0] * first) / s[0]


def _hessian(J: Array) -> Array:
    """Returns an array (n, 6, n) in which [i, :, j] is the derivative of column j by joint i."""
    n = J.shape[1]
    linear, angular = J[:3].T, J[3:].T
    i, j = np.indices((n, n))
    low, high = np.minimum(i, j), np.maximum(i, j)
    H = np.zeros((n, 6, n))
    H[:, :3] = np.swapaxes(np.cross(angular[low], linear[high]), 1, 2)
    turning = np.where((i < j)[..., None], np.cross(angular[i], angular[j]), 0.0)
    H[:, 3:] = np.swapaxes(turning, 1, 2)
    return H
