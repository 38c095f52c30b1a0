"""A plug-in: a target motion in which every joint moves back and forth.

Its pyproject.toml has:

    [project.entry-points."sero_mj.target_motions"]
    nod = "nodding:Nod"
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from sero_mj import SerialRobot
from sero_mj.simulate.control.controller import PerJoint
from sero_mj.simulate.control.target_motions import JointTargetMotion, Motion


class Nod(JointTargetMotion):
    """Every joint moves back and forth: q = q_0 + a (1 - cos(2 pi t / T)) / 2.

    Attributes:
        amplitude: amplitude in rad or m, one number or one per joint.
        period: s.
        count: number of periods; the robot then rests.
    """

    kind: Literal["nod"] = "nod"
    amplitude: PerJoint
    period: float = Field(2.0, gt=0)
    count: int = Field(3, ge=1)

    def motion(self, times: np.ndarray, robot: SerialRobot, start: np.ndarray) -> Motion:
        """Returns the motion of a run: rows are times, columns are joints."""
        omega = 2 * np.pi / self.period
        t = np.minimum(times, self.count * self.period)[:, None]
        moves = (times < self.count * self.period)[:, None]
        half = self.per_joint("amplitude", robot.n) / 2
        return Motion(
            times=times,
            angles=start + half * (1 - np.cos(omega * t)),
            velocities=half * omega * np.sin(omega * t) * moves,
            accelerations=half * omega**2 * np.cos(omega * t) * moves,
        )
