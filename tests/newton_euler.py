"""The recursive Newton-Euler algorithm for a DH table in NumPy, to check results of MuJoCo.

Source: Craig, Introduction to Robotics, section 6.5. Here, all vectors are in the base frame.
"""

from __future__ import annotations

import numpy as np

from sero_mj.robots.assemble.robot_dynamics import RobotDynamics
from sero_mj.robots.declared.robot import SerialRobot


def inverse_dynamics(
    robot: SerialRobot,
    dynamics: RobotDynamics,
    q,
    velocities=None,
    accelerations=None,
    gravity: float = 9.81,
    force=(0.0, 0.0, 0.0),
) -> np.ndarray:
    """Returns joint torques (n,) that move links, without motors and friction.

    Args: force: (3,), external force on the flange, in the base frame, N.
    """
    n, table = robot.n, robot.dh
    qd = np.zeros(n) if velocities is None else np.asarray(velocities)
    qdd = np.zeros(n) if accelerations is None else np.asarray(accelerations)
    T = table.frames(q)
    axes, points = table.joint_axes(T)
    omega, alpha = np.zeros(3), np.zeros(3)
    origin, acceleration = np.zeros(3), np.array([0.0, 0.0, gravity])
    velocity = np.zeros(3)
    forces, moments, centers = [], [], []
    for i in range(n):
        z, R = axes[i], T[i + 1, :3, :3]
        # The axis moves with the previous link. The joint acts at the foot of the axis.
        arm = points[i] - origin
        acceleration = acceleration + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
        velocity = velocity + np.cross(omega, arm)
        origin = points[i]
        if table.revolute[i]:
            alpha = alpha + z * qdd[i] + np.cross(omega, z) * qd[i]
            omega = omega + z * qd[i]
        else:
            acceleration = acceleration + z * qdd[i] + 2 * np.cross(omega, z) * qd[i]
        center = T[i + 1, :3, 3] + R @ dynamics.centers[i + 1]
        tensor = R @ dynamics.tensors[i + 1] @ R.T
        arm = center - origin
        at_center = acceleration + np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm))
        forces.append(dynamics.masses[i + 1] * at_center)
        moments.append(tensor @ alpha + np.cross(omega, tensor @ omega))
        centers.append(center)
    flange = (T[-1] @ robot.flange_frame)[:3, 3]
    torques = np.zeros(n)
    for i in range(n):
        total, moment = -np.asarray(force, float), np.cross(flange - points[i], -np.asarray(force))
        for k in range(i, n):
            total = total + forces[k]
            moment = moment + moments[k] + np.cross(centers[k] - points[i], forces[k])
        torques[i] = axes[i] @ (moment if table.revolute[i] else total)
    return torques
