"""Motions that an FCI client commands, and the limits that its commands must satisfy.

The limits are those that a Franka Research 3 checks (sources: `rate_limiting.h` of libfranka, and
the control parameters at frankarobotics.github.io/docs).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...base.frames import Array
from ...simulate.control.robot_model import RobotModel
from .messages import EXTERNAL, JOINT_POSITION, JOINT_VELOCITY, RobotCommand

CYCLE = 1e-3  # time between two states, s
JOINTS = 7
MAX_TORQUES: Array = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])  # Nm
MAX_TORQUE_RATE = 1000.0  # Nm/s
MAX_ACCELERATION = 10.0  # rad/s2
MAX_LOST = 20  # number of consecutive missing commands that end a motion
MAX_NUMBER = 1e9  # limit of received numbers; larger numbers are not physical and could overflow
_WINDOW = 100  # number of commands over which the success rate is averaged
# Clients compute with float32 states. Rounding causes acceleration errors of 0.5 rad/s2.
_RATE_TOLERANCE, _ACCELERATION_TOLERANCE = 1.0, 1.0
_START_TOLERANCE = 1e-3  # tolerance of the first commanded angles, rad (our choice)


class Violation(Exception):
    """Raised for a command that violates a limit. Its `error` is one of `receiver.ERRORS`."""

    def __init__(self, error: str, why: str, *, is_input: bool = False) -> None:
        super().__init__(why)
        self.error, self.why, self.is_input = error, why, is_input


@dataclass
class Motion:
    """A motion that a client has started and not yet finished.

    Attributes:
        since: time of the start on the system clock, s.
        at: simulation time of the last received command, s.
        came: whether each of the last 100 commands has arrived in time.
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
        """Fraction of the last 100 commands that have arrived in time."""
        return sum(self.came) / len(self.came) if self.came else 0.0


class Desired:
    """The desired motion of the joints, which commands of a client update.

    Attributes:
        torques: torques that the client commands, without gravity, shape (7,), Nm.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self.angles, self.velocities, self.accelerations, self.torques = np.zeros((4, JOINTS))

    def rest_at(self, angles: Array, velocities: Array) -> None:
        """Resets the desired motion to the measured angles and velocities of the robot."""
        self.angles[:], self.velocities[:] = angles, velocities
        self.accelerations[:] = self.torques[:] = 0.0

    def brake(self) -> None:
        """Decelerates the desired motion by one cycle."""
        max_change = MAX_ACCELERATION * CYCLE
        self.velocities -= np.clip(self.velocities, -max_change, max_change)
        self.angles += self.velocities * CYCLE

    def extrapolate(self) -> None:
        """Continues the desired motion by one cycle, with the last commanded acceleration."""
        self.velocities += self.accelerations * CYCLE
        self.angles += self.velocities * CYCLE

    def command(self, motion: Motion, command: RobotCommand, gravity: Array) -> None:
        """Updates the desired motion with a command; `gravity` is added to its torques in Nm.

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
            reason = f"the commanded {what} is not finite or too large"
            raise Violation(error, reason, is_input=True)
