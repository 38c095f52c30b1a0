"""What target motions share: samples of a whole run, and whether the robot can make them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from ..assemble.robot import SerialRobot
from ..declaration import Declaration
from ..errors import DeclarationError, Problem

Array = NDArray[np.float64]

_SLACK = 1e-9  # of limits, for targets that go just up to them


@dataclass(frozen=True, eq=False)
class Motion:
    """A target motion of all joints, a row for every time.

    Attributes:
        times: (T,), s.
        angles: (T, n), rad or m.
        velocities: (T, n), per second.
        accelerations: (T, n), per second squared.
    """

    times: Array
    angles: Array
    velocities: Array
    accelerations: Array

    def since(self, time: float) -> Motion:
        """The rows from a time (s) on."""
        rows = self.times >= time
        return Motion(
            self.times[rows], self.angles[rows], self.velocities[rows], self.accelerations[rows]
        )


class Law(Declaration):
    """Base of the declarations of target motions in joint space."""

    in_degrees: ClassVar[tuple[str, ...]] = ()

    @model_validator(mode="after")
    def _from_degrees(self) -> Law:
        for key in self.in_degrees:
            value = getattr(self, f"{key}_deg")
            if value is None:
                continue
            if getattr(self, key) is not None:
                raise ValueError(f"found both {key} and {key}_deg; expected one of them")
            self.__dict__[key] = np.deg2rad(value)
            self.__dict__[f"{key}_deg"] = None
        return self

    def sample(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """The motion of a whole run, within the robot's limits.

        Args:
            times: (T,), s, rising.
            robot: whose joints move, with their limits.
            start: (n,), rad or m, where it stands at first.

        Raises:
            DeclarationError: it does not fit the robot, or leaves its limits: by joint and time.
        """
        motion = self.motion(np.asarray(times, float), robot, np.asarray(start, float))
        problems = beyond_limits(motion, robot)
        ramp = getattr(self, "ramp", None)
        if problems and ramp and not beyond_limits(motion.since(ramp), robot):
            hint = f"; it grows within {ramp:g} s: ramp = {2 * ramp:g} is gentler"
            problems = [Problem(each.key, each.message + hint) for each in problems]
        if problems:
            raise DeclarationError(problems)
        return motion

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """The same, without a look at the limits."""
        raise NotImplementedError

    def per_joint(self, key: str, n: int) -> Array:
        """A field of one number for all joints or of n, as (n,).

        Raises:
            DeclarationError: it is missing, or has another number of entries.
        """
        value = getattr(self, key)
        degrees = f" or {key}_deg" if key in self.in_degrees else ""
        if value is None:
            raise DeclarationError([Problem(key, f"is required; expected {key}{degrees}")])
        if len(value) not in (1, n):
            message = f"found {len(value)} entries; expected {n}, one per joint, or one for all"
            raise DeclarationError([Problem(key, message)])
        return np.array(np.broadcast_to(value, n))

    def rows(self, key: str, n: int) -> Array:
        """A field of rows of n joint angles, (m, n).

        Raises:
            DeclarationError: it is missing, empty, or has another number of joints.
        """
        value = getattr(self, key)
        if value is None:
            raise DeclarationError([Problem(key, f"is required; expected {key} or {key}_deg")])
        if value.shape[-1] != n or not value.size:
            message = f"found rows of {value.shape[-1]}; expected {n} angles, one per joint"
            raise DeclarationError([Problem(key, message if value.size else "found no rows")])
        return np.asarray(value)


def beyond_limits(motion: Motion, robot: SerialRobot) -> list[Problem]:
    """Where every joint is farthest beyond its position or velocity limits."""
    problems = []
    limits, speeds = robot.position_limits, robot.velocity_limits
    for joint, name in enumerate(robot.names):
        factor, unit = (np.rad2deg(1.0), "deg") if robot.types[joint] == "revolute" else (1.0, "m")
        if limits is not None:
            low, high = limits[joint]
            angles = motion.angles[:, joint]
            bad = (angles < low - _SLACK) | (angles > high + _SLACK)
            if bad.any():
                row = int(np.argmax(np.maximum(low - angles, angles - high)))
                where = f"joint {name} is to be at {factor * angles[row]:.4g} {unit}"
                allowed = f"expected {factor * low:.4g} to {factor * high:.4g} {unit}"
                problems.append(Problem("", f"{where} at t = {motion.times[row]:.3f} s; {allowed}"))
                continue
        if speeds is not None:
            fast = np.abs(motion.velocities[:, joint])
            if (fast > speeds[joint] * (1.0 + _SLACK)).any():
                row = int(np.argmax(fast))
                where = f"joint {name} is to move at {factor * fast[row]:.4g} {unit}/s"
                allowed = f"expected up to {factor * speeds[joint]:.4g} {unit}/s"
                problems.append(Problem("", f"{where} at t = {motion.times[row]:.3f} s; {allowed}"))
    return problems
