"""Nearness to singularity, joint by joint, from the Jacobian.

Round arrows were first made to show it (the paper's reference 14). The measure is the inverse
condition number c of the Jacobian with lengths in units of the robot's reach: 0 at a singularity,
at most 1. Near it every joint's arrow turns the way that leads closer to the singularity, as wide
as the joint's part in it.

Source: inverse condition number as in Angeles, Fundamentals of Robotic Mechanical Systems, 4.9;
the Jacobian's derivative as in Haviland and Corke, Manipulator Differential Kinematics, part 2.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.parts import Owner
from ..assemble.world_view import WorldView

Array = NDArray[np.float64]

FAR = 0.15  # inverse condition number above which nothing is shown


def towards_singularity(world: WorldView, data: mujoco.MjData, part: Owner) -> Array:
    """How near a singularity is, and which way every joint leads to it.

    Args:
        world: the compiled scene.
        data: its state, frames up to date.
        part: the robot or double, n joints.

    Returns:
        (n,), -1 to 1: the sign is the direction of motion that leads nearer; the largest
        magnitude is the nearness, 0 at `FAR` and above, 1 at the singularity.
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
    """Geometric Jacobian (6, m) of the flange, lengths in units of the robot's reach.

    Its columns are those joints that move the flange, all n of a serial robot. It is made from the
    sites at the joints, for a double has no degrees of freedom in MuJoCo.
    """
    chain = part.chain
    sites = world.joints.centre_site[part.joints][chain]
    rotation = data.site_xmat[sites].reshape(-1, 3, 3)
    axis = rotation[:, :, 2]
    # The site is moved from the axis by `offsets_to_center_of_joints`.
    on_axis = data.site_xpos[sites] - np.einsum("nij,nj->ni", rotation, part.robot.offsets[chain])
    flange = world.frames.names.index(part.flange_name)
    lever = data.site_xpos[world.frames.site[flange]] - on_axis
    turns = part.dh.revolute[chain][:, None]
    linear = np.where(turns, np.cross(axis, lever), axis) / part.reach
    return np.concatenate([linear, np.where(turns, axis, 0.0)], axis=1).T


def inverse_condition(J: Array) -> tuple[float, Array]:
    """Inverse condition number of a Jacobian and its gradient in the joint angles.

    Args:
        J: (6, n), base frame; a prismatic joint's angular part is zero.

    Returns:
        smallest over largest singular value, and its gradient (n,).
    """
    u, s, vt = np.linalg.svd(J, full_matrices=False)
    if s[0] < 1e-12:
        return 0.0, np.zeros(J.shape[1])
    H = _hessian(J)  # dJ/dq_i is H[i]
    first = np.einsum("a,iab,b->i", u[:, 0], H, vt[0])
    last = np.einsum("a,iab,b->i", u[:, -1], H, vt[-1])
    return float(s[-1] / s[0]), (last - s[-1] / s[0] * first) / s[0]


def _hessian(J: Array) -> Array:
    """dJ/dq, (n, 6, n): the derivative by joint i of column j is [i, :, j]."""
    n = J.shape[1]
    linear, angular = J[:3].T, J[3:].T
    i, j = np.indices((n, n))
    low, high = np.minimum(i, j), np.maximum(i, j)
    H = np.zeros((n, 6, n))
    H[:, :3] = np.swapaxes(np.cross(angular[low], linear[high]), 1, 2)
    turning = np.where((i < j)[..., None], np.cross(angular[i], angular[j]), 0.0)
    H[:, 3:] = np.swapaxes(turning, 1, 2)
    return H
