"""Velocity limits of joints, with defaults for joints without a declared limit."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from ...base.frames import Array
from .robot import SerialRobot

Use = Literal["shown", "target", "agent", "runaway"]

# Default velocity limits by purpose for revolute (rad/s) and prismatic (m/s) joints: display,
# targets of controllers, actions of agents, and threshold for a runaway joint in simulation.
UNDECLARED: Mapping[Use, tuple[float, float]] = {
    "shown": (4.0, 1.0),
    "target": (1.5, 0.5),
    "agent": (1.0, 0.25),
    "runaway": (20.0, 5.0),
}


def undeclared_speeds(robot: SerialRobot, use: Use) -> Array:
    """Returns the default velocity limits of the joints for a purpose, shape (n,), rad/s or m/s."""
    turns, slides = UNDECLARED[use]
    return np.array([turns if kind == "revolute" else slides for kind in robot.types])


def joint_speeds(robot: SerialRobot, use: Use) -> Array:
    """Returns declared or else default velocity limits of the joints, shape (n,), rad/s or m/s."""
    speeds, limits = undeclared_speeds(robot, use), robot.velocity_limits
    return speeds if limits is None else np.where(np.isfinite(limits), limits, speeds)
