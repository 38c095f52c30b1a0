"""Torques of a run as they can be compared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .run_log import RunLog

Array = NDArray[np.float64]


def commanded_torques(log: RunLog, robot: str) -> Array:
    """What was commanded, (T, n), Nm; NaN in the first row where nothing was yet.

    Zeros in the first row only are what a log starts with before anybody commands anything, and
    would be the largest error of many a run.

    Raises:
        KeyError: nothing is known of what was commanded.
    """
    commanded = log.of(robot, "commanded_torques")
    if len(commanded) == 0 or commanded[0].any():
        return commanded
    commanded = commanded.copy()
    commanded[0] = np.nan
    return commanded


def torque_error(log: RunLog, robot: str) -> Array:
    """Commanded less measured torque, (T, n), Nm; raises KeyError."""
    return np.asarray(commanded_torques(log, robot) - log.of(robot, "torques"))


def compared_signal(log: RunLog, robot: str, signal: str) -> Array:
    """A signal of a robot, (T, n); commanded torques as above."""
    if signal == "commanded_torques":
        return commanded_torques(log, robot)
    return log.of(robot, signal)
