"""Motions that a client of FCI commands, and the limits that its commands must satisfy.

The limits are those of a Franka Research 3, which the robot checks itself (libfranka's
`rate_limiting.h`, and the control parameters at frankarobotics.github.io/docs).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...base.frames import Array
from ...simulate.control.robot_model import RobotModel
from .messages import EXTERNAL, JOINT_POSITION, JOINT_VELOCITY, RobotCommand

CYCLE = 1e-3  # s
JOINTS = 7
MAX_TORQUES: Array = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])  # Nm
MAX_TORQUE_RATE = 1000.0  # Nm/s
MAX_ACCELERATION = 10.0  # rad/s2
MAX_LOST = 20  # consecutive missing commands
MAX_NUMBER = 1e9  # larger values are not physical, and could overflow
_WINDOW = 100  # number of commands over which the success rate is averaged
# Clients compute with float32 states: 4 um of an angle of 4 rad are 0.5 rad/s2 in one cycle.
_RATE_TOLERANCE, _ACCELERATION_TOLERANCE = 1.0, 1.0
_START_TOLERANCE = 1e-3  # rad; tolerance of the first commanded angles, chosen by us


class Violation(Exception):
    """A command that the robot rejects; `error` is one of `receiver.ERRORS`."""

    def __init__(self, error: str, why: str, *, is_input: bool = False) -> None:
        super().__init__(why)
        self.error, self.why, self.is_input = error, why, is_input


@dataclass
class Motion:
    """A motion in progress.

    Attributes:
        since: start on the system clock, s.
        at: simulation time of the last received command, s.
        came: whether each of the last 100 commands arrived in time.
    """

    number: int
    controller: int
    generator: int
    since: float
    is_commanded: bool = False
    lost: int = 0
    at: float = 0.0
    came: deque[bool] = field(default_factory=lambda: deque(maxlen=_WINDOW))

    @property
    def is_external(self) -> bool:
        """Whether the client commands torques."""
        return self.controller == EXTERNAL

    @property
    def success(self) -> float:
        """Fraction of the last 100 commands that arrived in time."""
        return sum(self.came) / len(self.came) if self.came else 0.0


class Desired:
    """Desired joint motion, which commands update.

    Attributes:
        torques: torques commanded by a client, without gravity, shape (7,), Nm.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self.angles, self.velocities, self.accelerations, self.torques = np.zeros((4, JOINTS))

    def rest_at(self, angles: Array, velocities: Array) -> None:
        """Sets the desired motion to the angles and velocities of the robot, shape (7,)."""
        self.angles[:], self.velocities[:] = angles, velocities
        self.accelerations[:] = self.torques[:] = 0.0

    def brake(self) -> None:
        """Decelerates the desired motion for one cycle."""
        max_change = MAX_ACCELERATION * CYCLE
        self.velocities -= np.clip(self.velocities, -max_change, max_change)
        self.angles += self.velocities * CYCLE

    def extrapolate(self) -> None:
        """Continues for one cycle without a command, at the last commanded acceleration."""
        self.velocities += self.accelerations * CYCLE
        self.angles += self.velocities * CYCLE

    def command(self, motion: Motion, command: RobotCommand, gravity: Array) -> None:
        """Applies a command; `gravity`, shape (7,), Nm, is added to its torques.

        Raises:
            Violation: the command violates a limit.
        """
        generator = motion.generator
        if motion.is_external:
            self._check_torques(command.torques, gravity)
        if generator == JOINT_POSITION:
            self._move(command.angles, (command.angles - self.angles) / CYCLE, motion)
        elif generator == JOINT_VELOCITY:
            angles = self.angles + command.velocities * CYCLE
            self._move(angles, command.velocities, motion)
        if motion.is_external:
            self.torques[:] = command.torques

    def _check_torques(self, torques: Array, gravity: Array) -> None:
        name = "controller_torque_discontinuity"
        self._check_finite(torques, "torque", name)
        rates = np.abs(torques - self.torques) / CYCLE
        self._check(rates, MAX_TORQUE_RATE, _RATE_TOLERANCE, name, "commanded torque changes by",
                    "Nm/s")  # fmt: skip
        self._check(np.abs(torques + gravity), MAX_TORQUES, 0.0, "tau_J_range_violation",
                    "commanded torque with gravity is", "Nm")  # fmt: skip

    def _move(self, angles: Array, velocities: Array, motion: Motion) -> None:
        before, model = "joint_motion_generator", self._model
        self._check_finite(np.concatenate([angles, velocities]), "motion",
                           f"{before}_velocity_discontinuity")  # fmt: skip
        if motion.generator == JOINT_POSITION and not motion.is_commanded:
            away = np.abs(angles - self.angles)
            self._check(away, _START_TOLERANCE, 0.0, "joint_position_motion_generator_start_pose_"
                        "invalid", "first command is away from the robot by", "rad")  # fmt: skip
        self._check(np.abs(velocities), model.velocity_limits, 1e-3,
                    f"{before}_velocity_limits_violation", "is commanded to move at",
                    "rad/s")  # fmt: skip
        accelerations = (velocities - self.velocities) / CYCLE
        self._check(np.abs(accelerations), MAX_ACCELERATION, _ACCELERATION_TOLERANCE,
                    f"{before}_velocity_discontinuity", "is commanded to accelerate by",
                    "rad/s2")  # fmt: skip
        low, high = model.position_limits.T
        beyond = np.maximum(low - angles, angles - high)
        self._check(beyond, 0.0, 0.0, f"{before}_position_limits_violation",
                    "is commanded beyond its limit by", "rad")  # fmt: skip
        self.angles[:], self.velocities[:] = angles, velocities
        self.accelerations[:] = accelerations

    def _check(
        self,
        found: Array,
        limits: Array | float,
        tolerance: float,
        error: str,
        what: str,
        unit: str,
    ) -> None:
        over = found - limits
        joint = int(np.argmax(over))
        if over[joint] > tolerance:
            limit = np.broadcast_to(limits, found.shape)[joint]
            expected = f"{what} {found[joint]:.4g} {unit}; expected up to {limit:.4g}"
            raise Violation(error, f"{self._model.joint_names[joint]}: {expected}")

    def _check_finite(self, numbers: Sequence[float] | Array, what: str, error: str) -> None:
        if not (np.abs(numbers) < MAX_NUMBER).all():  # also NaN
            raise Violation(error, f"a commanded {what} is not finite, or too large", is_input=True)
