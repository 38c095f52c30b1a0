"""Masses and lengths that a robot can hardly have: those of a file in g or mm, for example."""

from __future__ import annotations

import numpy as np

from ..declared.robot import SerialRobot
from .robot_dynamics import LinkInertia, RobotDynamics, holding_efforts

# The largest arms on the market have 4.7 m and 4.7 t; few have more than this.
_LARGE_REACH, _LARGE_MASS = 4.0, 1500.0  # m, kg
# Torque that holds the stretched arm over the torque limit; robots have 0.2 to 1.3.
_LARGE_SHARE = 10.0
_LONG_STROKE, _LONGEST_STROKE = 1.0, 20.0  # m: shorter ones and longer ones need no comparison
_STROKES = 10.0  # times the reach without any; arms on rails have up to 6


def about_units(robot: SerialRobot, dynamics: RobotDynamics) -> list[str]:
    """Returns a sentence for everything that is probably in another unit."""
    notes = []
    names, types = robot.names, robot.types
    limits = robot.plausible_limits
    strokes = np.ptp(np.where(np.isfinite(limits), limits, 0.0), axis=1)
    plain = robot.model_copy(update={"position_limits": None}).reach
    for k in range(robot.n):
        stroke = float(strokes[k])
        is_long = stroke > max(_STROKES * plain, _LONG_STROKE) or stroke > _LONGEST_STROKE
        if types[k] == "prismatic" and is_long:
            notes.append(f"joint {names[k]} has a range of {stroke:.4g} m: are its limits in mm?")
    reach = plain if notes else robot.reach
    if reach > _LARGE_REACH:
        notes.append(f"few robots reach {reach:.4g} m: are lengths in mm?")
    mass = float(dynamics.masses.sum())
    if mass > _LARGE_MASS:
        is_estimate = "masses" in dynamics.estimated
        cause = "lengths in mm" if is_estimate else "masses in g"
        notes.append(f"few robots weigh {mass:,.0f} kg: are {cause}?")
    links = LinkInertia(dynamics.masses, dynamics.centers, dynamics.tensors)
    shares = holding_efforts(robot, links) / robot.torque_bounds
    most = int(np.argmax(shares))
    if shares[most] > _LARGE_SHARE:
        notes.append(
            f"joint {names[most]} needs up to {shares[most]:,.0f} times its torque limit to hold "
            "the robot against gravity: are masses in g, lengths in mm, or is the limit in another "
            "unit?"
        )
    return notes
