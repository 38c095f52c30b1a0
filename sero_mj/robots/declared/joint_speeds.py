"""Speeds of joints: the declared limits, or defaults for joints without limits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from ...base.frames import Array
from .robot import SerialRobot

Use = Literal["shown", "target", "agent", "runaway"]

# rad/s of revolute and m/s of prismatic joints, by purpose: a robot that is only shown; a target
# followed by a controller; an agent's actions; and the threshold above which a simulated joint has
# run away.
UNDECLARED: Mapping[Use, tuple[float, float]] = {
    "shown": (4.0, 1.0),
    "target": (1.5, 0.5),
    "agent": (1.0, 0.25),
    "runaway": (20.0, 5.0),
}


def undeclared_speeds(robot: SerialRobot, use: Use) -> Array:
    """Speeds (n,), rad/s or m/s, as if the robot declared no velocity limits."""
    turns, slides = UNDECLARED[use]
    return np.array([turns if kind == "revolute" else slides for kind in robot.types])


def joint_speeds(robot: SerialRobot, use: Use) -> Array:
    """The velocity limits (n,), rad/s or m/s, or the default of a joint without one."""
    speeds, limits = undeclared_speeds(robot, use), robot.velocity_limits
    return speeds if limits is None else np.where(np.isfinite(limits), limits, speeds)
