"""Torques of a robot's links as functions of its motion, and their derivatives.

Source: Atkeson, An, Hollerbach, Estimation of inertial parameters of manipulator loads and links,
IJRR 5(3), 1986 (torques of rigid bodies as linear functions of ten parameters).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ...base.frames import Array
from ...robots.assemble.robot_dynamics import GRAVITY
from ...robots.declared.robot import SerialRobot
from ...simulate.control.robot_model import RobotModel

_DIFFERENCE_STEP = 1e-4  # s, step of the numerical derivative of the Jacobian
_ANGLE_STEP = 1e-4  # rad or m, step of the numerical derivative of torques by angles
PARAMETERS = ("mass", "hx", "hy", "hz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")


def link_model(robot: SerialRobot) -> RobotModel:
    """Returns the model of a robot whose base does not move."""
    return RobotModel.of(robot.model_copy(update={"mount": None, "free_base": False}))


def link_torques(
    robot: SerialRobot,
    q: Array,
    v: Array,
    a: Array,
    gravity: ArrayLike | None = None,
    model: RobotModel | None = None,
) -> Array:
    """Returns M(q) a + C(q, v) v + g(q) without motor inertias, shape (K, n), Nm or N.

    Args:
        q: joint values, shape (K, n), rad or m; the torques of rows with NaN are NaN.
        v: joint velocities, shape (K, n).
        a: joint accelerations, shape (K, n).
        gravity: gravity in the world, shape (3,), m/s2; None for the declared gravity.
        model: `link_model` of the robot, if it is already known; `gravity` is set in it.
    """
    model = model or link_model(robot)
    if gravity is not None:
        model.skeleton.opt.gravity[:] = gravity
    torques, less = np.zeros((len(q), robot.n)), np.zeros(robot.n)
    for k in np.flatnonzero(np.isfinite(q + v + a).all(axis=1)):
        model.update(q[k], v[k])
        model.write_inverse_dynamics(v[k], a[k], torques[k], less)
        torques[k] -= less
    torques[~np.isfinite(q + v + a).all(axis=1)] = np.nan
    return torques


def torques_by_angle(robot: SerialRobot, q: Array, v: Array, a: Array) -> Array:
    """Returns derivatives of `link_torques` with respect to each joint value, shape (K, n, n)."""
    found, model = np.empty((len(q), robot.n, robot.n)), link_model(robot)
    for j, shift in enumerate(_ANGLE_STEP * np.eye(robot.n)):
        more, less = (
            link_torques(robot, q + side * shift, v, a, model=model) for side in (1.0, -1.0)
        )
        found[:, :, j] = (more - less) / (2.0 * _ANGLE_STEP)
    return found


def mass_matrices(robot: SerialRobot, q: Array) -> Array:
    """Returns M(q) without motor inertias, shape (K, n, n)."""
    still, model = np.zeros_like(q), link_model(robot)
    columns = [
        link_torques(robot, q, still, np.broadcast_to(unit, q.shape), np.zeros(3), model)
        for unit in np.eye(robot.n)
    ]
    return np.stack(columns, axis=-1)


def torques_by_gravity(robot: SerialRobot, q: Array) -> Array:
    """Returns link torques at rest per m/s2 of gravity along each world axis, shape (K, n, 3)."""
    still, model = np.zeros_like(q), link_model(robot)
    return np.stack(
        [link_torques(robot, q, still, still, axis, model) for axis in np.eye(3)], axis=-1
    )


def body_torques(
    robot: SerialRobot, q: Array, v: Array, a: Array, link: int | None = None
) -> Array:
    """Returns link torques per unit of the `PARAMETERS` of a rigid body, shape (K, n, 10).

    For mass m, first moment h = m c and inertia I about the frame of the body, angular velocity w,
    angular acceleration u, and acceleration s of the frame including gravity, all in its axes, the
    force is m s + u x h + w x (w x h), and the moment is h x s + I u + w x (I w).

    Args:
        q: joint values, shape (K, n), rad or m.
        v: joint velocities, shape (K, n).
        a: joint accelerations, shape (K, n).
        link: index of the DH frame with the body, 0 for the base; None for the flange frame.
    """
    table, base = robot.kinematics, robot.base_frame
    at, offset = (robot.flange_link, robot.T_n_flange) if link is None else (link, np.eye(4))

    def jacobian(angles: Array) -> Array:
        return table.jacobian(angles, base, offset, at)

    J = jacobian(q)
    change = (jacobian(q + _DIFFERENCE_STEP * v) - jacobian(q - _DIFFERENCE_STEP * v)) / (
        2.0 * _DIFFERENCE_STEP
    )
    velocity = np.einsum("tij,tj->ti", J, v)
    acceleration = np.einsum("tij,tj->ti", J, a) + np.einsum("tij,tj->ti", change, v)
    acceleration[:, 2] += GRAVITY
    R = (table.frames(q, base)[..., at, :, :] @ offset)[:, :3, :3]

    def in_body(vectors: Array) -> Array:
        return np.asarray(np.einsum("tji,tj->ti", R, vectors))

    moving = acceleration[:, :3], acceleration[:, 3:], velocity[:, 3:]
    s, u, w = (in_body(each) for each in moving)
    wrench = np.zeros((len(q), 6, 10))
    wrench[:, :3, 0] = s
    wrench[:, :3, 1:4] = _cross(u) + _cross(w) @ _cross(w)
    wrench[:, 3:, 1:4] = -_cross(s)
    wrench[:, 3:, 4:] = _tensor_times(u) + _cross(w) @ _tensor_times(w)
    turned = np.concatenate([np.swapaxes(R, 1, 2) @ J[:, :3], np.swapaxes(R, 1, 2) @ J[:, 3:]], 1)
    return np.asarray(np.swapaxes(turned, 1, 2) @ wrench)


def _cross(x: Array) -> Array:
    # Matrices of the cross product with x, (T, 3, 3).
    result = np.zeros((len(x), 3, 3))
    result[:, 0, 1], result[:, 0, 2] = -x[:, 2], x[:, 1]
    result[:, 1, 0], result[:, 1, 2] = x[:, 2], -x[:, 0]
    result[:, 2, 0], result[:, 2, 1] = -x[:, 1], x[:, 0]
    return result


def _tensor_times(x: Array) -> Array:
    # Matrices that map (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) to I x, (T, 3, 6).
    result = np.zeros((len(x), 3, 6))
    for row, columns in enumerate(((0, 3, 4), (3, 1, 5), (4, 5, 2))):
        for axis, column in enumerate(columns):
            result[:, row, column] = x[:, axis]
    return result
