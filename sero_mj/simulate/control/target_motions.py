"""Base classes of target motions of the joints and of the flange, and simple target motions.

Motions through way points are in `way_points.py`.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cache
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from ...base.declaration import Declaration, Frame, Vector, of_shape
from ...base.errors import DeclarationError, Problem
from ...base.frames import Array
from ...robots.declared.couplings import CoupledJoints
from ...robots.declared.degrees import degrees_warning, look_like_degrees
from ...robots.declared.robot import SerialRobot
from .controller import MaybePerJoint, PerJoint, per_joint, within

log = logging.getLogger(__name__)

Samples = tuple[Array, Array, Array]
Rows = Annotated[Array | None, of_shape(None, None)]

_SLACK = 1e-9  # tolerance for targets that just reach a limit


@dataclass(frozen=True, eq=False)
class Motion:
    """Samples of a joint motion: times, shape (T,), s, and angles and derivatives, shape (T, n)."""

    times: Array
    angles: Array
    velocities: Array
    accelerations: Array

    def since(self, time: float) -> Motion:
        rows = self.times >= time
        return Motion(
            self.times[rows], self.angles[rows], self.velocities[rows], self.accelerations[rows]
        )


@dataclass(frozen=True, eq=False)
class CartesianMotion:
    """Samples of a motion of the flange.

    Attributes:
        times: times, shape (T,), s.
        poses: flange poses T_world_flange, shape (T, 4, 4), m.
        twists: flange twists in world axes, shape (T, 6), m/s, then rad/s.
        accelerations: flange accelerations in world axes, shape (T, 6), m/s2, then rad/s2.
    """

    times: Array
    poses: Array
    twists: Array
    accelerations: Array


def _coupled(motion: Motion, coupled: CoupledJoints) -> Motion:
    free = coupled.independent
    return Motion(
        motion.times,
        coupled.positions(motion.angles[:, free]),
        coupled.rates(motion.velocities[:, free]),
        coupled.rates(motion.accelerations[:, free]),
    )


class TargetMotion(Declaration, ABC):
    """Base class of target motion declarations."""


class JointTargetMotion(TargetMotion):
    """Base class of target motion declarations in joint space."""

    in_degrees: ClassVar[tuple[str, ...]] = ()

    @model_validator(mode="after")
    def _from_degrees(self) -> JointTargetMotion:
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
        """Returns the motion for a run, and checks that it is within the limits of the robot.

        Args:
            times: ascending times, shape (T,), s.
            start: initial joint angles, shape (n,), rad or m.

        Raises:
            DeclarationError: the motion does not fit the robot, or leaves its limits. The error
                states joint and time.
        """
        motion = self.motion(np.asarray(times, float), robot, np.asarray(start, float))
        if robot.couplings:
            motion = _coupled(motion, robot.coupled)
        problems = beyond_limits(motion, robot)
        if not problems and (warning := degrees_warning(robot, motion.angles)):
            _warn(warning)
        ramp = getattr(self, "ramp", None)
        if problems and ramp and not beyond_limits(motion.since(ramp), robot):
            hint = f"; only the ramp of {ramp:g} s exceeds it. Try ramp = {2 * ramp:g}"
            problems = [replace(each, expected=f"{each.expected}{hint}") for each in problems]
        if problems:
            raise DeclarationError(problems)
        return motion

    @abstractmethod
    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """Returns the motion like `sample`, but without couplings and limit checks."""

    def per_joint(self, key: str, n: int) -> Array:
        """Returns a field expanded to shape (n,). Raises DeclarationError if it is missing."""
        value = getattr(self, key)
        degrees = f" or {key}_deg" if key in self.in_degrees else ""
        if value is None:
            raise Problem(key, f"is required; expected {key}{degrees}").error()
        return per_joint(key, value, n)

    def rows(self, key: str, n: int) -> Array:
        """Returns a field with m rows of joint angles, shape (m, n).

        Raises DeclarationError if it is missing or empty, or has another number of columns.
        """
        value = getattr(self, key)
        if value is None:
            raise Problem(key, f"is required; expected {key} or {key}_deg").error()
        if value.shape[-1] != n or not value.size:
            message = f"found rows of {value.shape[-1]} angles; expected {n}, one per joint"
            raise Problem(key, message if value.size else "found no rows").error()
        return np.asarray(value)


@cache  # warn once, even if a motion is sampled several times
def _warn(warning: str) -> None:
    log.warning("target of %s", warning)


def beyond_limits(motion: Motion, robot: SerialRobot) -> list[Problem]:
    """Returns the largest violation of each joint that leaves its limits."""
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
                found, of = factor * angles[row], f"{unit} at t = {motion.times[row]:.3f} s"
                allowed = f"{factor * low:.4g} to {factor * high:.4g} {unit}"
                if look_like_degrees(robot, motion.angles[row])[joint]:
                    allowed += "; is the target in degrees?"
                where = f"the target of joint {name} is"
                problems.append(Problem("", where, found=found, of=of, expected=allowed))
                continue
        if speeds is not None:
            fast = np.abs(motion.velocities[:, joint])
            if (fast > speeds[joint] * (1.0 + _SLACK)).any():
                row = int(np.argmax(fast))
                found, of = factor * fast[row], f"{unit}/s at t = {motion.times[row]:.3f} s"
                allowed = f"up to {factor * speeds[joint]:.4g} {unit}/s"
                where = f"the target velocity of joint {name} is"
                problems.append(Problem("", where, found=found, of=of, expected=allowed))
    return problems


class CartesianTargetMotion(TargetMotion):
    """Base class of target motion declarations for the flange."""

    @abstractmethod
    def sample(self, times: Array, start: Array) -> CartesianMotion:
        """Returns the motion of the flange for a run.

        Args:
            times: ascending times, shape (T,), s.
            start: initial flange pose T_world_flange, shape (4, 4), m.

        Raises:
            DeclarationError: fields contradict each other.
        """


_Hertz = Annotated[PerJoint, within(0.0, 1e3, "Hz")]


class Constant(JointTargetMotion):
    """Holds constant joint angles.

    Attributes:
        angles: constant angle of each joint, rad or m (default: the initial angles).
        angles_deg: `angles` in degrees.
    """

    kind: Literal["constant"] = "constant"
    angles: MaybePerJoint = None
    angles_deg: MaybePerJoint = None
    in_degrees: ClassVar[tuple[str, ...]] = ("angles",)

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        angles = start if self.angles is None else self.per_joint("angles", robot.n)
        still = np.zeros((len(times), robot.n))
        return Motion(times, np.tile(angles, (len(times), 1)), still, still)


class CartesianConstant(CartesianTargetMotion):
    """Holds a constant pose of the flange.

    Attributes:
        pose: flange pose T_world_flange or T_start_flange (default: the initial pose).
        relative_to: frame of the pose: `world`, or the initial flange frame (`start`).
    """

    kind: Literal["cartesian_constant"] = "cartesian_constant"
    pose: Frame | None = None
    relative_to: Literal["world", "start"] = "world"

    def sample(self, times: Array, start: Array) -> CartesianMotion:
        pose = start if self.pose is None else in_world(self.pose, start, self.relative_to)
        still = np.zeros((len(times), 6))
        return CartesianMotion(times, np.tile(pose, (len(times), 1, 1)), still, still)


def in_world(pose: Array, start: Array, relative_to: str) -> Array:
    """Returns T_world_flange for a flange pose relative to `world` or `start`."""
    return np.asarray(start @ pose) if relative_to == "start" else pose


class Step(JointTargetMotion):
    """Moves every joint in a step, for step responses.

    Attributes:
        amplitude: amplitude of each joint relative to the initial angle, rad or m.
        amplitude_deg: `amplitude` in degrees.
        time: time of the step, s.
        duration: time until the step back, s (default: no step back).
    """

    kind: Literal["step"] = "step"
    amplitude: MaybePerJoint = None
    amplitude_deg: MaybePerJoint = None
    time: float = Field(0.0, ge=0)
    duration: float | None = Field(None, gt=0)
    in_degrees: ClassVar[tuple[str, ...]] = ("amplitude",)

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        amplitude = self.per_joint("amplitude", robot.n)
        end = np.inf if self.duration is None else self.time + self.duration
        there = (times >= self.time) & (times < end)
        still = np.zeros((len(times), robot.n))
        return Motion(times, start + there[:, None] * amplitude, still, still)


class Sine(JointTargetMotion):
    """Moves every joint sinusoidally about its initial angle.

    Attributes:
        amplitude: amplitude of each joint, rad or m.
        amplitude_deg: `amplitude` in degrees.
        frequency: frequency of each joint, Hz.
        phase: phase of each joint, rad.
        ramp: time in which the amplitude grows from zero along a quintic, s; 0 for no ramp.
    """

    kind: Literal["sine"] = "sine"
    amplitude: MaybePerJoint = None
    amplitude_deg: MaybePerJoint = None
    frequency: _Hertz
    phase: PerJoint = np.zeros(1)
    ramp: float = Field(1.0, ge=0)
    in_degrees: ClassVar[tuple[str, ...]] = ("amplitude",)

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        n = robot.n
        omega = 2.0 * np.pi * self.per_joint("frequency", n)
        angle = times[:, None] * omega + self.per_joint("phase", n)
        swing = np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)
        return _swinging(
            times, start, self.per_joint("amplitude", n), swing, _grown(times, self.ramp)
        )


class Chirp(JointTargetMotion):
    """Moves joints sinusoidally at a frequency that changes linearly, for identification.

    Attributes:
        amplitude: amplitude of each joint, rad or m.
        amplitude_deg: `amplitude` in degrees.
        start_frequency: initial frequency, Hz.
        end_frequency: final frequency, Hz.
        duration: duration of the motion, s. Afterwards the joints rest at their initial angles.
        ramp: time in which the amplitude grows at the start and decreases at the end, s.
    """

    kind: Literal["chirp"] = "chirp"
    amplitude: MaybePerJoint = None
    amplitude_deg: MaybePerJoint = None
    start_frequency: float = Field(0.1, ge=0, le=1e3)
    end_frequency: float = Field(ge=0, le=1e3)
    duration: float = Field(gt=0)
    ramp: float = Field(1.0, gt=0)
    in_degrees: ClassVar[tuple[str, ...]] = ("amplitude",)

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        if 2.0 * self.ramp > self.duration:
            raise Problem(
                "ramp", found=self.ramp, of="s", expected="at most half the duration"
            ).error()
        rate = 2.0 * np.pi * (self.end_frequency - self.start_frequency) / self.duration
        omega = (2.0 * np.pi * self.start_frequency + rate * times)[:, None]
        angle = (2.0 * np.pi * self.start_frequency * times + 0.5 * rate * times**2)[:, None]
        sin, cos = np.sin(angle), np.cos(angle)
        swing = sin, omega * cos, rate * cos - omega**2 * sin
        up, down = _grown(times, self.ramp), _grown(times - self.duration + self.ramp, self.ramp)
        ramp = tuple(a - b for a, b in zip(up, down, strict=True))
        return _swinging(times, start, self.per_joint("amplitude", robot.n), swing, ramp)


class Recorded(JointTargetMotion):
    """Follows recorded joint angles with smooth interpolation, and rests before and after them.

    Attributes:
        times: ascending times, s.
        angles: joint angles, one row per time, rad or m.
        angles_deg: `angles` in degrees.
    """

    kind: Literal["recorded"] = "recorded"
    times: Vector
    angles: Rows = None
    angles_deg: Rows = None
    in_degrees: ClassVar[tuple[str, ...]] = ("angles",)

    @field_validator("times")
    @classmethod
    def _rise(cls, times: Array) -> Array:
        if len(times) < 2:
            raise Problem(found=len(times), of="entries", expected="two or more").error()
        if (np.diff(times) <= 0).any():
            row = int(np.argmax(np.diff(times) <= 0)) + 1
            found = f"entry {row + 1} is {times[row]:g} s"
            raise ValueError(f"{found}; expected more than {times[row - 1]:g} s")
        return times

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        # Cubic Hermite splines, with velocities of parabolas through three rows.
        knots, rows = self.times, self.rows("angles", robot.n)
        if len(rows) != len(knots):
            raise Problem(
                "angles", found=len(rows), of="rows", expected=f"{len(knots)}, one per time"
            ).error()
        slopes = np.gradient(rows, knots, axis=0)
        index = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
        width = np.diff(knots)[index][:, None]
        u = (np.clip(times, knots[0], knots[-1])[:, None] - knots[index][:, None]) / width
        a, b = rows[index], rows[index + 1]
        va, vb = width * slopes[index], width * slopes[index + 1]
        c2, c3 = 3.0 * (b - a) - 2.0 * va - vb, 2.0 * (a - b) + va + vb
        inside = ((times >= knots[0]) & (times <= knots[-1]))[:, None]
        return Motion(
            times,
            a + u * (va + u * (c2 + u * c3)),
            np.where(inside, (va + u * (2.0 * c2 + 3.0 * u * c3)) / width, 0.0),
            np.where(inside, (2.0 * c2 + 6.0 * u * c3) / width**2, 0.0),
        )


def quintic(times: Array, duration: float) -> Samples:
    """Returns the path parameter (0 to 1), its speed (1/s) and acceleration (1/s2), shape (T,).

    It is the polynomial of degree five that starts and ends at rest, without acceleration.

    Args:
        times: times since the start, shape (T,), s. The motion rests before start and after end.
        duration: duration of the motion, s.
    """
    u = np.clip(times / duration, 0.0, 1.0)
    rest = 1.0 - u
    way = u**3 * (10.0 + u * (6.0 * u - 15.0))
    speed = 30.0 * (u * rest) ** 2 / duration
    acceleration = 60.0 * u * rest * (rest - u) / duration**2
    return way, speed, acceleration


def _grown(times: Array, ramp: float) -> Samples:
    if ramp == 0.0:
        return np.ones(len(times)), np.zeros(len(times)), np.zeros(len(times))
    return quintic(times, ramp)


def _swinging(
    times: Array, start: Array, amplitude: Array, swing: Samples, ramp: tuple[Any, ...]
) -> Motion:
    s, ds, dds = swing
    r, dr, ddr = (part[:, None] for part in ramp)
    return Motion(
        times,
        start + amplitude * (r * s),
        amplitude * (dr * s + r * ds),
        amplitude * (ddr * s + 2.0 * dr * ds + r * dds),
    )
