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
CLOSE = 1e-3  # m or rad; a goal with a smaller error is reached
_DAMPING = 1e-4  # m2 and rad2
_MAX_STEP = 0.2  # rad or m per iteration
_AT_LIMIT = 1e-6  # rad or m
_POSTURE_GAIN = 0.5  # fraction of the way to the posture, per iteration
_MIN_POSTURE_STEP = 1e-4  # rad or m; smaller null-space steps end the iteration
# Maps joint values to a frame (4, 4), m, and its Jacobian (6, n), with linear rows first.
Place = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Reached:
    """The result of the inverse kinematics.

    Attributes:
        distance: remaining distance to the goal, m.
        angle: remaining rotation to the goal, rad; 0 for a goal without orientation.
        at_limit: mask (n,) of joints at a position limit.
    """

    angles: Array
    distance: float
    angle: float
    at_limit: Bools

    @property
    def is_there(self) -> bool:
        return self.distance <= CLOSE and self.angle <= CLOSE


def frame_place(robot: SerialRobot, base: Array, link: int, at: Array) -> Place:
    """Returns a function from the independent joint values to a frame of a robot.

    Args:
        base: T_world_base (4, 4), m.
        link: index of the link of the frame, 0 for the base.
        at: T_link_frame (4, 4), m.
    """
    tree, coupled = robot.kinematics, robot.coupled
    follows: Array = np.zeros(
        (coupled.n, coupled.k)
    )  # maps rates of independent joints to all joints
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
    """Returns limits (k, 2) of the independent joints that also satisfy those of coupled joints."""
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
    """Returns joint values that bring a frame as close as possible to a pose, within the limits.

    Args:
        goal: T_world_frame (4, 4), m.
        angles: initial joint values, shape (n,), rad or m.
        limits: position limits, shape (n, 2), rad or m, or None.
        turns: whether the goal includes the orientation.
        posture: target of the null space, shape (n,), rad or m, or None.
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
    """Returns a step towards the pose in which joints stop at their limits."""
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
