"""Detects joint angles that are probably in degrees instead of radians."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ...base.frames import Array, Bools

FAR_BEYOND = 2 * np.pi  # implausible distance beyond a position limit, rad
MAX_ANGLE = 8 * np.pi  # four rotations, for joints without limits, rad
_MAX_DEGREES = 360.0
_STEP, _ROUNDING = 0.1, 1e-5  # deg: typed angles are often multiples of this


class HasJoints(Protocol):
    """The part of `SerialRobot` that this module needs, because importing it would be circular."""

    name: str

    @property
    def names(self) -> list[str]: ...

    @property
    def types(self) -> list[str]: ...

    @property
    def plausible_limits(self) -> Array: ...


def look_like_degrees(robot: HasJoints, angles: Array) -> Bools:
    """Returns a mask of the joint angles that are probably in degrees, shape (n,).

    An angle is suspicious if it exceeds the position limits by more than `FAR_BEYOND`. The angle of
    a continuous joint is suspicious if it is larger than `MAX_ANGLE`, at most 360, and a multiple
    of 0.1. This excludes wheels that have rotated many times.
    """
    low, high = robot.plausible_limits.T
    with np.errstate(invalid="ignore", over="ignore"):
        beyond = np.maximum(low - angles, angles - high) > FAR_BEYOND
        is_round = np.abs(angles - _STEP * np.round(angles / _STEP)) < _ROUNDING
        size = np.abs(angles)
        many_turns = (size > MAX_ANGLE) & (size <= _MAX_DEGREES) & is_round
    is_free, turns = np.isinf(low) & np.isinf(high), np.array(robot.types) == "revolute"
    return np.asarray((beyond | (is_free & many_turns)) & turns)


def degrees_warning(robot: HasJoints, angles: Array) -> str:
    """Returns a warning about the first joint whose angles are probably in degrees, or "".

    Args:
        angles: joint values, shape (n,) or (T, n), rad or m; may contain NaN.
    """
    known = np.nan_to_num(np.atleast_2d(angles))
    if not known.size:
        return ""
    for found in (known.max(axis=0), known.min(axis=0)):
        joints = np.flatnonzero(look_like_degrees(robot, found))
        if joints.size:
            joint = int(joints[0])
            return f"{robot.name}.{robot.names[joint]}: {_about(robot, joint, found[joint])}"
    return ""


def _about(robot: HasJoints, joint: int, angle: float) -> str:
    low, high = robot.plausible_limits[joint]
    if np.isinf(low) and np.isinf(high):
        return f"{angle:.4g} rad is {abs(angle) / (2 * np.pi):.0f} turns. Is it in degrees?"
    limits = f"±{high:.3g}" if low == -high else f"{low:.3g} to {high:.3g}"
    return f"{angle:.4g} rad is far beyond its limits of {limits} rad. Is it in degrees?"
