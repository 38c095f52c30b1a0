"""Torques of a robot's links as functions of its motion, and their derivatives.

Source: Atkeson, An, Hollerbach, Estimation of inertial parameters of manipulator loads and links,
IJRR 5(3), 1986 (torques of rigid bodies as linear functions of ten parameters).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...base.frames import Array
from ...robots.assemble.robot_dynamics import GRAVITY
from ...robots.declared.robot import SerialRobot
from ...simulate.control.robot_model import RobotModel

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


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """The motion of the n + 1 DH frames of a robot at K times, base first, in world axes.

    Attributes:
        poses: poses of the frames, shape (K, n + 1, 4, 4), m.
        axes: directions of the joint axes, shape (K, n, 3).
        points: points on the joint axes, shape (K, n, 3), m.
        angular_velocities: shape (K, n + 1, 3), rad/s.
        angular_accelerations: shape (K, n + 1, 3), rad/s2.
        accelerations: accelerations of the origins minus gravity, shape (K, n + 1, 3), m/s2.
    """

    poses: Array
    axes: Array
    points: Array
    angular_velocities: Array
    angular_accelerations: Array
    accelerations: Array


def link_motion(robot: SerialRobot, q: Array, v: Array, a: Array) -> LinkMotion:
    """Returns the motion of the links for joint values, velocities, accelerations (K, n).

    This is the forward recursion of the Newton-Euler algorithm (Luh, Walker, Paul, On-line
    computational scheme for mechanical manipulators, 1980).
    """
    table = robot.kinematics
    poses = table.frames(q, robot.base_frame)
    axes, points = table.joint_axes(poses)
    w, u, s = np.zeros((3, len(q), robot.n + 1, 3))
    s[:, 0, 2] = GRAVITY
    for i, parent in enumerate(table.carriers.tolist()):
        z, rate, change = axes[:, i], v[:, [i]], a[:, [i]]
        w[:, i + 1], u[:, i + 1] = w[:, parent], u[:, parent]
        start, end = poses[:, parent, :3, 3], poses[:, i + 1, :3, 3]
        middle = points[:, i] if table.revolute[i] else end
        s[:, i + 1] = s[:, parent] + _relative(w[:, parent], u[:, parent], middle - start)
        if table.revolute[i]:
            u[:, i + 1] += z * change + np.cross(w[:, parent], z * rate)
            w[:, i + 1] += z * rate
            s[:, i + 1] += _relative(w[:, i + 1], u[:, i + 1], end - middle)
        else:
            s[:, i + 1] += z * change + 2.0 * np.cross(w[:, parent], z * rate)
    return LinkMotion(poses, axes, points, w, u, s)


def body_torques(
    robot: SerialRobot,
    q: Array,
    v: Array,
    a: Array,
    link: int | None = None,
    motion: LinkMotion | None = None,
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
        motion: `link_motion` of these values, if it is already known.
    """
    motion = motion or link_motion(robot, q, v, a)
    table = robot.kinematics
    at, offset = (robot.flange_link, robot.T_n_flange) if link is None else (link, np.eye(4))
    pose = motion.poses[:, at] @ offset
    R, origin = pose[:, :3, :3], pose[:, :3, 3]
    w, u = motion.angular_velocities[:, at], motion.angular_accelerations[:, at]
    s = motion.accelerations[:, at] + _relative(w, u, origin - motion.poses[:, at, :3, 3])
    s, u, w = (np.asarray(np.einsum("tji,tj->ti", R, each)) for each in (s, u, w))
    wrench = np.zeros((len(q), 6, 10))
    wrench[:, :3, 0] = s
    wrench[:, :3, 1:4] = _cross(u) + _cross(w) @ _cross(w)
    wrench[:, 3:, 1:4] = -_cross(s)
    wrench[:, 3:, 4:] = _tensor_times(u) + _cross(w) @ _tensor_times(w)
    turns, moves = table.revolute[:, None], table.moves[at][:, None]
    linear = np.where(turns, np.cross(motion.axes, origin[:, None] - motion.points), motion.axes)
    angular = np.where(turns, motion.axes, 0.0)
    turned = np.concatenate([linear * moves @ R, angular * moves @ R], axis=2)
    return np.asarray(turned @ wrench)


def _relative(w: Array, u: Array, r: Array) -> Array:
    # Accelerations (K, 3) at offsets r in bodies that rotate, relative to those of their origins.
    return np.asarray(np.cross(u, r) + np.cross(w, np.cross(w, r)))


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
