"""`MotionLimits`: bounds of a designed motion, which are a share of the limits of a robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.frames import Array
from ...robots.assemble.robot_dynamics import robot_dynamics
from ...robots.declared.joint_speeds import UNDECLARED, joint_speeds
from ...robots.declared.robot import SerialRobot


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """The bounds of the k independent joints of a robot, which move its n joints.

    Attributes:
        names: names of the independent joints.
        share: share of the limits of the robot; for positions, about the middle of the range.
        positions: lower and upper bounds, shape (k, 2), rad or m.
        velocities: bounds of speeds, shape (k,), rad/s or m/s.
        torques: bounds of torques, shape (k,), Nm or N; infinite if the robot declares none.
        coupling: motion of each joint per motion of each independent joint, shape (n, k).
        notes: sentences about limits and masses that the robot does not declare.
    """

    names: list[str]
    share: float
    positions: Array
    velocities: Array
    torques: Array
    coupling: Array
    notes: list[str]

    @classmethod
    def of(cls, robot: SerialRobot, share: float) -> MotionLimits:
        coupled = robot.coupled
        free = coupled.independent
        ranges = robot.display_ranges[free]
        middle = ranges.mean(axis=1, keepdims=True)
        coupling = np.zeros((robot.n, coupled.k))
        coupling[np.arange(robot.n), coupled.source] = coupled.ratio
        return cls(
            [robot.names[i] for i in free],
            share,
            middle + share * (ranges - middle),
            share * joint_speeds(robot, "target")[free],
            share * robot.torque_bounds[free],
            coupling,
            _notes(robot),
        )

    def used(self, q: Array, v: Array, torques: Array) -> dict[str, Array]:
        """Returns how much of its bounds a motion uses, as shares of shape (T, k) by quantity.

        Args:
            q: positions of the independent joints, shape (T, k), rad or m.
            v: velocities, shape (T, k), rad/s or m/s.
            torques: torques at all joints, shape (T, n), Nm or N.
        """
        half = 0.5 * np.ptp(self.positions, axis=1)
        return {
            "position": np.abs(q - self.positions.mean(axis=1)) / half,
            "velocity": np.abs(v) / self.velocities,
            # The drive of an independent joint also moves the joints that are coupled to it.
            "torque": np.abs(torques @ self.coupling) / self.torques,
        }


def _notes(robot: SerialRobot) -> list[str]:
    speed, slide = UNDECLARED["target"]
    speeds = np.full(robot.n, np.inf) if robot.velocity_limits is None else robot.velocity_limits
    limits = {
        "no position limits are declared; ±180 deg or ±1 m is assumed": robot.plausible_limits,
        f"no velocity limits are declared; {speed:g} rad/s or {slide:g} m/s is assumed": speeds,
        "no torque limits are declared, so torques are not bounded": robot.torque_bounds,
    }
    notes = []
    for text, values in limits.items():
        names = [robot.names[i] for i in robot.coupled.independent
                 if not np.isfinite(values[i]).all()]  # fmt: skip
        if names:
            notes.append(f"{', '.join(names)}: {text}")
    if "masses" in robot_dynamics(robot).estimated:
        notes.append("no masses are declared; torques are those of estimated masses")
    return notes
