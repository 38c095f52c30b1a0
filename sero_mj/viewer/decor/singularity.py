"""Proximity to a singularity per joint, from the Jacobian.

This was the first use of round arrows (the paper's reference 14). The measure is the inverse
condition number c of the Jacobian with lengths in units of the robot's reach: 0 at a singularity,
at most 1. Close to one, every joint's arrow turns in the direction of motion that leads towards
the singularity, with a width in proportion to the joint's contribution.

Source: inverse condition number as in Angeles, Fundamentals of Robotic Mechanical Systems, 4.9;
the Jacobian's derivative as in Haviland and Corke, Manipulator Differential Kinematics, part 2.
"""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.parts import Owner
from ...robots.assemble.world_view import WorldView

FAR = 0.15  # inverse condition number above which no arrow is shown


def towards_singularity(world: WorldView, data: mujoco.MjData, part: Owner) -> Array:
    """Returns the proximity to a singularity and the direction of every joint towards it.

    Args:
        part: the robot or double, n joints.

    Returns:
        (n,), -1 to 1: the sign is the direction of motion towards the singularity; the largest
        magnitude is the proximity, 0 at `FAR` and above, 1 at the singularity.
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
    """Returns the geometric Jacobian (6, m) of the flange, lengths in units of the robot's reach.

    It has a column for every joint that moves the flange, all n of a serial robot. It is computed
    from the sites at the joints, because a double has no degrees of freedom in MuJoCo.

    Args:
        part: the robot or double, n joints.
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
    """Returns the inverse condition number of a Jacobian and its gradient in the joint angles.

    Args:
        J: (6, n), base frame; a prismatic joint's angular part is zero.

    Returns:
        smallest over largest singular value, and its gradient (n,), per rad or m.
    """
    u, s, vt = np.linalg.svd(J, full_matrices=False)
    if s[0] < 1e-12:
        return 0.0, np.zeros(J.shape[1])
    H = _hessian(J)  # dJ/dq_i is H[i]
    first = np.einsum("a,iab,b->i", u[:, 0], H, vt[0])
    last = np.einsum("a,iab,b->i", u[:, -1], H, vt[-1])
    return float(s[-1] / s[0]), (last - s[-1] / s[0] * first) / s[0]


def _hessian(J: Array) -> Array:
    """Returns dJ/dq, (n, 6, n): the derivative of column j by joint i is [i, :, j]."""
    n = J.shape[1]
    linear, angular = J[:3].T, J[3:].T
    i, j = np.indices((n, n))
    low, high = np.minimum(i, j), np.maximum(i, j)
    H = np.zeros((n, 6, n))
    H[:, :3] = np.swapaxes(np.cross(angular[low], linear[high]), 1, 2)
    turning = np.where((i < j)[..., None], np.cross(angular[i], angular[j]), 0.0)
    H[:, 3:] = np.swapaxes(turning, 1, 2)
    return H
