"""Target motions: of the joints, and of the flange.

Way points, for both, are in `way_points.py`; all kinds by name are in `plan.py`.
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


@dataclass(frozen=True, eq=False)
class CartesianMotion:
    """A target motion of the flange, a row for every time.

    Attributes:
        times: (T,), s.
        poses: (T, 4, 4), T_world_flange, m.
        twists: (T, 6), in world axes, m/s, then rad/s.
        accelerations: (T, 6), in world axes, m/s2, then rad/s2.
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
    """Base of the declarations of target motions."""


class JointTargetMotion(TargetMotion):
    """Base of the declarations of target motions in joint space."""

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
        """The motion of a whole run, within the robot's limits.

        Args:
            times: (T,), s, rising.
            start: (n,), rad or m, where it stands at first.

        Raises:
            DeclarationError: it does not fit the robot, or leaves its limits: by joint and time.
        """
        motion = self.motion(np.asarray(times, float), robot, np.asarray(start, float))
        if robot.couplings:
            motion = _coupled(motion, robot.coupled)
        problems = beyond_limits(motion, robot)
        if not problems and (warning := degrees_warning(robot, motion.angles)):
            _warn(warning)
        ramp = getattr(self, "ramp", None)
        if problems and ramp and not beyond_limits(motion.since(ramp), robot):
            hint = f"; it grows within {ramp:g} s: ramp = {2 * ramp:g} is gentler"
            problems = [replace(each, expected=f"{each.expected}{hint}") for each in problems]
        if problems:
            raise DeclarationError(problems)
        return motion

    @abstractmethod
    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """The motion of a whole run, whose limits are not checked.

        Args:
            times: (T,), s, rising.
            start: (n,), rad or m, where it stands at first.
        """

    def per_joint(self, key: str, n: int) -> Array:
        """A field of one number for all joints or of n, as (n,).

        Raises:
            DeclarationError: it is missing, or has another number of entries.
        """
        value = getattr(self, key)
        degrees = f" or {key}_deg" if key in self.in_degrees else ""
        if value is None:
            raise Problem(key, f"is required; expected {key}{degrees}").error()
        return per_joint(key, value, n)

    def rows(self, key: str, n: int) -> Array:
        """A field of rows of n joint angles, (m, n).

        Raises:
            DeclarationError: it is missing, empty, or has another number of joints.
        """
        value = getattr(self, key)
        if value is None:
            raise Problem(key, f"is required; expected {key} or {key}_deg").error()
        if value.shape[-1] != n or not value.size:
            message = f"found rows of {value.shape[-1]}; expected {n} angles, one per joint"
            raise Problem(key, message if value.size else "found no rows").error()
        return np.asarray(value)


@cache  # once, however often a motion is sampled
def _warn(warning: str) -> None:
    log.warning("target of %s", warning)


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
                found, of = factor * angles[row], f"{unit} at t = {motion.times[row]:.3f} s"
                allowed = f"{factor * low:.4g} to {factor * high:.4g} {unit}"
                if look_like_degrees(robot, motion.angles[row])[joint]:
                    allowed += "; is it in degrees?"
                where = f"joint {name} is to be at"
                problems.append(Problem("", where, found=found, of=of, expected=allowed))
                continue
        if speeds is not None:
            fast = np.abs(motion.velocities[:, joint])
            if (fast > speeds[joint] * (1.0 + _SLACK)).any():
                row = int(np.argmax(fast))
                found, of = factor * fast[row], f"{unit}/s at t = {motion.times[row]:.3f} s"
                allowed = f"up to {factor * speeds[joint]:.4g} {unit}/s"
                where = f"joint {name} is to move at"
                problems.append(Problem("", where, found=found, of=of, expected=allowed))
    return problems


class CartesianTargetMotion(TargetMotion):
    """Base of the declarations of target motions of the flange."""

    @abstractmethod
    def sample(self, times: Array, start: Array) -> CartesianMotion:
        """The motion of a whole run.

        Args:
            times: (T,), s, rising.
            start: T_world_flange (4, 4), m, at first.

        Raises:
            DeclarationError: fields that do not fit each other.
        """


_Hertz = Annotated[PerJoint, within(0.0, 1e3, "Hz")]


class Constant(JointTargetMotion):
    """Stands still.

    Attributes:
        angles: (n,), rad or m; where the robot starts by default.
        angles_deg: the same in degrees.
    """

    kind: Literal["constant"] = "constant"
    angles: MaybePerJoint = None
    angles_deg: MaybePerJoint = None
    in_degrees: ClassVar[tuple[str, ...]] = ("angles",)

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """Every row the same."""
        angles = start if self.angles is None else self.per_joint("angles", robot.n)
        still = np.zeros((len(times), robot.n))
        return Motion(times, np.tile(angles, (len(times), 1)), still, still)


class CartesianConstant(CartesianTargetMotion):
    """Stands still.

    Attributes:
        pose: T_world_flange, or T_start_flange; where the robot starts by default.
        relative_to: the `world`, or the flange at its `start`.
    """

    kind: Literal["cartesian_constant"] = "cartesian_constant"
    pose: Frame | None = None
    relative_to: Literal["world", "start"] = "world"

    def sample(self, times: Array, start: Array) -> CartesianMotion:
        """Every row the same."""
        pose = start if self.pose is None else in_world(self.pose, start, self.relative_to)
        still = np.zeros((len(times), 6))
        return CartesianMotion(times, np.tile(pose, (len(times), 1, 1)), still, still)


def in_world(pose: Array, start: Array, relative_to: str) -> Array:
    """T_world_flange of a pose that is relative to the `world` or to the `start`."""
    return np.asarray(start @ pose) if relative_to == "start" else pose


class Step(JointTargetMotion):
    """Jumps by an amplitude, for step responses.

    Attributes:
        amplitude: rad or m per joint, from where the robot starts.
        amplitude_deg: the same in degrees.
        time: s, when.
        duration: s, after which it jumps back; None for never.
    """

    kind: Literal["step"] = "step"
    amplitude: MaybePerJoint = None
    amplitude_deg: MaybePerJoint = None
    time: float = Field(0.0, ge=0)
    duration: float | None = Field(None, gt=0)
    in_degrees: ClassVar[tuple[str, ...]] = ("amplitude",)

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """Angles only; the jump has no velocity."""
        amplitude = self.per_joint("amplitude", robot.n)
        end = np.inf if self.duration is None else self.time + self.duration
        there = (times >= self.time) & (times < end)
        still = np.zeros((len(times), robot.n))
        return Motion(times, start + there[:, None] * amplitude, still, still)


class Sine(JointTargetMotion):
    """Every joint swings about where it starts.

    Attributes:
        amplitude: rad or m per joint.
        amplitude_deg: the same in degrees.
        frequency: Hz per joint.
        phase: rad per joint.
        ramp: s in which the swing grows from nothing, as a quintic; 0 for at once.
    """

    kind: Literal["sine"] = "sine"
    amplitude: MaybePerJoint = None
    amplitude_deg: MaybePerJoint = None
    frequency: _Hertz
    phase: PerJoint = np.zeros(1)
    ramp: float = Field(1.0, ge=0)
    in_degrees: ClassVar[tuple[str, ...]] = ("amplitude",)

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """The swing times its ramp."""
        n = robot.n
        omega = 2.0 * np.pi * self.per_joint("frequency", n)
        angle = times[:, None] * omega + self.per_joint("phase", n)
        swing = np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)
        return _swinging(
            times, start, self.per_joint("amplitude", n), swing, _grown(times, self.ramp)
        )


class Chirp(JointTargetMotion):
    """A swing whose frequency rises or falls linearly, for identification.

    Attributes:
        amplitude: rad or m per joint.
        amplitude_deg: the same in degrees.
        start_frequency: Hz.
        end_frequency: Hz.
        duration: s from one to the other; then it rests where it began.
        ramp: s in which the swing grows at the start and shrinks at the end, as quintics.
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
        """The swing times its ramps."""
        if 2.0 * self.ramp > self.duration:
            raise Problem(
                "ramp", found=self.ramp, of="s", expected="up to half the duration"
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
    """A motion as rows of time and angles, interpolated smoothly; before and after it rests.

    Attributes:
        times: (T,), s, rising.
        angles: (T, n), rad or m.
        angles_deg: the same in degrees.
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
            raise ValueError(f"entry {row + 1} is {times[row]:g} s, after {times[row - 1]:g} s")
        return times

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """Cubic Hermite: through every row, with the velocities of the parabola through three."""
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
    """The polynomial of fifth degree that starts and ends without speed and acceleration.

    Args:
        times: (T,), s from its start; before it and after its end it rests.
        duration: s.

    Returns:
        way (0 to 1), speed (1/s) and acceleration (1/s2), each (T,).
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
    """`amplitude` times swing times ramp by the product rule; both with two derivatives."""
    s, ds, dds = swing
    r, dr, ddr = (part[:, None] for part in ramp)
    return Motion(
        times,
        start + amplitude * (r * s),
        amplitude * (dr * s + r * ds),
        amplitude * (ddr * s + 2.0 * dr * ds + r * dds),
    )
