"""Motions that a client of FCI commands: what the robot is to do, and the limits of commands.

The limits are those of a Franka Research 3, which the robot itself checks (libfranka's
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
MOST_TORQUES: Array = np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0])  # Nm
MOST_TORQUE_RATE = 1000.0  # Nm/s
MOST_ACCELERATION = 10.0  # rad/s2
MAX_LOST = 20  # commands in a row
MOST_NUMBER = 1e9  # what is beyond can be no quantity of a robot, and overflows in what follows
_WINDOW = 100  # commands, over which success is counted
# Clients compute from states with float32: 4 um of an angle of 4 rad are 0.5 rad/s2 in a cycle.
_RATE_TOLERANCE, _ACCELERATION_TOLERANCE = 1.0, 1.0
_START_TOLERANCE = 1e-3  # rad, of the first commanded angles; our choice


class Violation(Exception):
    """A command that the robot does not follow.

    Args:
        error: as `sero_mj.extensions.franka.receiver.ERRORS` names it.
    """

    def __init__(self, error: str, why: str, *, is_input: bool = False) -> None:
        super().__init__(why)
        self.error, self.why, self.is_input = error, why, is_input


@dataclass
class Motion:
    """A motion in progress.

    Attributes:
        since: s, when it began on the clock's time.
        at: s, time of the last command that has.
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
        """Share of the last 100 commands that came in time."""
        return sum(self.came) / len(self.came) if self.came else 0.0


class Desired:
    """What is desired of the joints, and what commands may make of it.

    Attributes:
        angles: (7,), rad.
        velocities: (7,), rad/s.
        accelerations: (7,), rad/s2.
        torques: (7,), Nm, commanded by a client, without gravity.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self.angles, self.velocities, self.accelerations, self.torques = np.zeros((4, JOINTS))

    def rest_at(self, angles: Array, velocities: Array) -> None:
        """Begins where the robot is, (7,), rad, moving as it does, (7,), rad/s."""
        self.angles[:], self.velocities[:] = angles, velocities
        self.accelerations[:] = self.torques[:] = 0.0

    def brake(self) -> None:
        """Slows down for one cycle."""
        most = MOST_ACCELERATION * CYCLE
        self.velocities -= np.clip(self.velocities, -most, most)
        self.angles += self.velocities * CYCLE

    def extrapolate(self) -> None:
        """Goes on for a cycle without a command, at the acceleration of the last one."""
        self.velocities += self.accelerations * CYCLE
        self.angles += self.velocities * CYCLE

    def command(self, motion: Motion, command: RobotCommand, gravity: Array) -> None:
        """Takes a command; gravity, (7,), Nm, comes on top of its torques; raises Violation."""
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
        self._check(rates, MOST_TORQUE_RATE, _RATE_TOLERANCE, name, "commanded torque changes by",
                    "Nm/s")  # fmt: skip
        self._check(np.abs(torques + gravity), MOST_TORQUES, 0.0, "tau_J_range_violation",
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
        self._check(np.abs(accelerations), MOST_ACCELERATION, _ACCELERATION_TOLERANCE,
                    f"{before}_velocity_discontinuity", "is commanded to accelerate by",
                    "rad/s2")  # fmt: skip
        low, high = model.position_limits.T
        beyond = np.maximum(low - angles, angles - high)
        self._check(beyond, 0.0, 0.0, f"{before}_position_limits_violation",
                    "is commanded beyond its limit by", "rad")  # fmt: skip
        self.angles[:], self.velocities[:] = angles, velocities
        self.accelerations[:] = accelerations

    def _check(
        self, found: Array, most: Array | float, tolerance: float, error: str, what: str, unit: str
    ) -> None:
        over = found - most
        joint = int(np.argmax(over))
        if over[joint] > tolerance:
            limit = np.broadcast_to(most, found.shape)[joint]
            expected = f"{what} {found[joint]:.4g} {unit}; expected up to {limit:.4g}"
            raise Violation(error, f"{self._model.joint_names[joint]}: {expected}")

    def _check_finite(self, numbers: Sequence[float] | Array, what: str, error: str) -> None:
        if not (np.abs(numbers) < MOST_NUMBER).all():  # nor is NaN
            raise Violation(error, f"a commanded {what} is not finite, or huge", is_input=True)
