"""Inverse kinematics by damped least squares, starting from the previous joint angles.

Sources: Nakamura and Hanafusa 1986, Inverse Kinematic Solutions With Singularity Robustness,
J. Dyn. Sys. Meas. Control 108; Wampler 1986, IEEE Trans. Systems, Man, and Cybernetics 16.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...base.frames import Array, Bools
from . import joint_ranges
from .robot import SerialRobot

ITERATIONS = 60
CLOSE = 1e-3  # maximum error of a goal that is reached, m or rad
_DAMPING = 1e-4  # squared damping factor, m2 and rad2
_MAX_STEP = 0.2  # maximum joint motion per iteration, rad or m
_AT_LIMIT = 1e-6  # maximum distance of a joint at its limit, rad or m
_POSTURE_GAIN = 0.5  # fraction of the distance to the posture per iteration
_MIN_POSTURE_STEP = 1e-4  # null-space step at which the iteration ends, rad or m
# Function of joint values that returns a frame (4, 4) and its Jacobian (6, n), linear part first
Place = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Reached:
    """The result of the inverse kinematics, with the remaining errors.

    Attributes:
        angles: joint values, shape (n,), rad or m.
        distance: remaining distance to the goal, m.
        angle: remaining rotation to the goal, rad; 0 for a goal without orientation.
        at_limit: mask of the joints at a position limit, shape (n,).
    """

    angles: Array
    distance: float
    angle: float
    at_limit: Bools

    @property
    def is_there(self) -> bool:
        return self.distance <= CLOSE and self.angle <= CLOSE


def frame_place(robot: SerialRobot, base: Array, link: int, at: Array) -> Place:
    """Returns a function of the independent joint values that computes a frame and its Jacobian.

    Args:
        robot: robot to which the frame is fixed.
        base: pose T_world_base of the robot, shape (4, 4), m.
        link: index of the link to which the frame is fixed, 0 for the base.
        at: pose T_link_frame, shape (4, 4), m.
    """
    tree, coupled = robot.kinematics, robot.coupled
    follows: Array = np.zeros((coupled.n, coupled.k))  # rates of all joints per independent rate
    follows[np.arange(coupled.n), coupled.source] = coupled.ratio

    def place(angles: Array) -> tuple[Array, Array]:
        q = coupled.positions(angles)
        frames = tree.frames(q, base)
        axis, point = tree.joint_axes(frames)
        pose = frames[link] @ at
        turns = tree.revolute[:, None]
        linear = np.where(turns, np.cross(axis, pose[:3, 3] - point), axis)
        both = np.concatenate([linear, np.where(turns, axis, 0.0)], axis=1)
        return pose, (both * tree.moves[link][:, None]).T @ follows

    return place


def independent_limits(robot: SerialRobot) -> Array | None:
    """Returns limits within which independent and coupled joints are in range, shape (k, 2)."""
    if robot.position_limits is None:
        return None
    return joint_ranges.independent_limits(robot.position_limits, robot.coupled)


def reach(
    place: Place,
    goal: Array,
    angles: Array,
    limits: Array | None,
    *,
    turns: bool = True,
    posture: Array | None = None,
    iterations: int = ITERATIONS,
) -> Reached:
    """Searches for joint values within the limits that move a frame as close as possible to a goal.

    Args:
        place: function that computes the frame and its Jacobian, such as `frame_place` returns.
        goal: desired pose T_world_frame, shape (4, 4), m.
        angles: initial joint values, shape (n,), rad or m.
        limits: position limits, shape (n, 2), rad or m, or None.
        turns: whether the goal includes the orientation.
        posture: joint values that the null-space motion approaches, shape (n,), rad or m, or None.
        iterations: maximum number of iterations.
    """
    error: Array = np.zeros(6)
    rows = slice(None) if turns else slice(0, 3)
    angle = 0.0
    for iteration in range(iterations):
        pose, jacobian = place(angles)
        error[:3] = goal[:3, 3] - pose[:3, 3]
        if turns:
            error[3:], angle = _turn(goal[:3, :3] @ pose[:3, :3].T)
        left = float(np.linalg.norm(error[:3])), angle
        is_close = max(left) < 1e-2 * CLOSE
        if (is_close and posture is None) or iteration == iterations - 1:
            break
        inner = None if posture is None else _POSTURE_GAIN * (posture - angles)
        step = _step(jacobian[rows], error[rows], angles, limits, inner)
        if is_close and float(np.abs(step).max()) < _MIN_POSTURE_STEP:
            break
        angles = angles + step
    at_limit = np.zeros(len(angles), bool)
    if limits is not None:
        at_limit = (angles <= limits[:, 0] + _AT_LIMIT) | (angles >= limits[:, 1] - _AT_LIMIT)
    return Reached(angles, *left, at_limit)


def _turn(rotation: Array) -> tuple[Array, float]:
    sin = 0.5 * np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    size = float(np.linalg.norm(sin))
    angle = float(np.arctan2(size, 0.5 * (np.trace(rotation) - 1.0)))
    return sin * (angle / size if size > 1e-12 else 1.0), angle


def _step(
    jacobian: Array, error: Array, angles: Array, limits: Array | None, inner: Array | None
) -> Array:
    m, n = jacobian.shape
    low, high = (np.full(n, -np.inf), np.full(n, np.inf)) if limits is None else limits.T
    free: Array = np.ones(n)
    held: Array = np.zeros(n)
    step = held
    for _ in range(n):
        J = jacobian * free
        rest = error - jacobian @ held
        if inner is not None:
            rest = rest - J @ inner
        step = J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(m), rest)
        if inner is not None:
            step = step + free * inner
        step *= min(1.0, _MAX_STEP / max(float(np.abs(step).max()), 1e-12))
        out = (free > 0.0) & ((angles + step < low) | (angles + step > high))
        if not out.any():
            break
        held[out] = np.clip(angles + step, low, high)[out] - angles[out]
        free[out] = 0.0
    return np.asarray(np.where(free > 0.0, step, held))
