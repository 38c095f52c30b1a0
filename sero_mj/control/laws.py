"""Target motions in joint space: constant, way points, sine, chirp, step, recorded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, field_validator, model_validator

from ..assemble.robot import SerialRobot
from ..declaration import Declaration, Vector, by_kind, of_shape
from ..errors import DeclarationError, Problem
from .controller import MaybePerJoint, PerJoint, within
from .time_laws import TimeLaw, along, quintic, schedule, trapezoid_blend

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
        """The motion of a whole run, whose limits are not checked.

        Args:
            times: (T,), s, rising.
            robot: whose joints move.
            start: (n,), rad or m, where it stands at first.
        """
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


_NOTHING = 1e-12  # s: ways that no joint needs more for are none
_Rows = Annotated[Array | None, of_shape(None, None)]


def rising(times: Array | None) -> Array | None:
    """Returns times that rise and start at zero or later.

    Raises:
        ValueError: they do not.
    """
    if times is not None:
        if not len(times) or times[0] < 0:
            raise ValueError(f"found {times.tolist()}; expected times from 0 s on")
        if (np.diff(times) <= 0).any():
            raise ValueError(f"found {times.tolist()}; expected times that rise")
    return times


def _positive(values: Array | None) -> Array | None:
    if values is not None and (values <= 0).any():
        raise ValueError(f"found {values[values <= 0][0]:g}; expected positive numbers")
    return values


Arrivals = Annotated[Vector | None, AfterValidator(rising)]


class WayPoints(Law):
    """Goes to one point after the other; all joints start and arrive together.

    Either `times` say when it arrives, or it goes as fast as `speed` allows.

    Attributes:
        way_points: (m, n), rad or m.
        way_points_deg: the same in degrees.
        times: (m,), s, when it arrives; a first of 0 is where it starts.
        speed: share of the robot's velocity limits, 0 to 1.
        accelerations: rad/s2 or m/s2 per joint; the robot's `acceleration_limits` by default.
        time_law: `quintic` (no jumps in acceleration) or `trapezoidal` (faster).
        dwell: s at each point, where there are no `times`.
    """

    kind: Literal["way_points"] = "way_points"
    way_points: _Rows = None
    way_points_deg: _Rows = None
    times: Arrivals = None
    speed: float | None = Field(None, gt=0, le=1)
    accelerations: Annotated[MaybePerJoint, AfterValidator(_positive)] = None
    time_law: TimeLaw = "quintic"
    dwell: float = Field(0.0, ge=0)
    in_degrees: ClassVar[tuple[str, ...]] = ("way_points",)

    @model_validator(mode="after")
    def _one_of_two(self) -> WayPoints:
        if (self.times is None) == (self.speed is None):
            found = "neither" if self.times is None else "both"
            raise ValueError(f"found {found} of times and speed; expected one of them")
        return self

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """Straight lines in joint space."""
        points = np.vstack([start, self.rows("way_points", robot.n)])
        if self.times is not None:
            points, starts, durations, blends = self._timed(points, robot)
        else:
            starts, durations, blends = self._fast(np.diff(points, axis=0), robot)
        index, way, speed, rate = along(times, starts, durations, blends)
        lines = np.diff(points, axis=0)[index]
        return Motion(
            times,
            points[index] + way[:, None] * lines,
            speed[:, None] * lines,
            rate[:, None] * lines,
        )

    def _timed(self, points: Array, robot: SerialRobot) -> tuple[Array, Array, Array, Array | None]:
        """Points, and when the ways between them start and how long they take."""
        arrivals = self.times
        assert arrivals is not None
        if len(arrivals) != len(points) - 1:
            message = (
                f"found {len(arrivals)} entries; expected {len(points) - 1}, one per way point"
            )
            raise DeclarationError([Problem("times", message)])
        if arrivals[0] == 0.0:
            points = points[1:]
            if len(points) == 1:
                points, arrivals = np.vstack([points, points]), np.array([0.0, 1.0])
        else:
            arrivals = np.hstack([0.0, arrivals])
        starts, durations = arrivals[:-1], np.diff(arrivals)
        if self.time_law == "quintic":
            return points, starts, durations, None
        blends = []
        for row, (line, duration) in enumerate(
            zip(np.diff(points, axis=0), durations, strict=True)
        ):
            share = self._share(line, self._accelerations(robot))
            try:
                blends.append(trapezoid_blend(duration, share))
            except ValueError as error:
                joint = robot.names[int(np.argmax(self._shares(line, self._accelerations(robot))))]
                when = f"to arrive at t = {starts[row] + duration:.3f} s"
                message = f"joint {joint} is too slow {when}: {error}; expected more time"
                raise DeclarationError([Problem("times", message)]) from None
        return points, starts, durations, np.array(blends)

    def _fast(self, lines: Array, robot: SerialRobot) -> tuple[Array, Array, Array | None]:
        """When the ways start, and how long they take at the declared speed."""
        limits, rates = robot.velocity_limits, self._accelerations(robot)
        if limits is None or rates is None:
            lacks = "velocity_limits" if limits is None else "acceleration_limits"
            hint = "times" if limits is None else "accelerations"
            message = f"robot '{robot.name}' has no {lacks}; expected {hint} here"
            raise DeclarationError([Problem("speed", message)])
        speeds = np.array([self._share(line, float(self.speed or 1.0) * limits) for line in lines])
        shares = np.array([self._share(line, rates) for line in lines])
        return schedule(speeds, shares, self.time_law, self.dwell)

    def _accelerations(self, robot: SerialRobot) -> Array | None:
        if self.accelerations is not None:
            return self.per_joint("accelerations", robot.n)
        return robot.acceleration_limits

    @staticmethod
    def _shares(line: Array, limits: Array | None) -> Array:
        """How much of its limit every joint takes of each unit of the way."""
        return np.zeros(len(line)) if limits is None else np.abs(line) / limits

    @classmethod
    def _share(cls, line: Array, limits: Array | None) -> float:
        """The limit on the way (0 to 1) that the joint with the least room sets; inf for none."""
        most = float(cls._shares(line, limits).max())
        return 1.0 / most if most > _NOTHING else np.inf


_Hertz = Annotated[PerJoint, within(0.0, 1e3, "Hz")]


class Constant(Law):
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


class Step(Law):
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


class Sine(Law):
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


class Chirp(Law):
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
            message = f"found {self.ramp:g} s; expected up to half the duration"
            raise DeclarationError([Problem("ramp", message)])
        rate = 2.0 * np.pi * (self.end_frequency - self.start_frequency) / self.duration
        omega = (2.0 * np.pi * self.start_frequency + rate * times)[:, None]
        angle = (2.0 * np.pi * self.start_frequency * times + 0.5 * rate * times**2)[:, None]
        sin, cos = np.sin(angle), np.cos(angle)
        swing = sin, omega * cos, rate * cos - omega**2 * sin
        up, down = _grown(times, self.ramp), _grown(times - self.duration + self.ramp, self.ramp)
        ramp = tuple(a - b for a, b in zip(up, down, strict=True))
        return _swinging(times, start, self.per_joint("amplitude", robot.n), swing, ramp)


class Recorded(Law):
    """A motion as rows of time and angles, interpolated smoothly; before and after it rests.

    Attributes:
        times: (T,), s, rising.
        angles: (T, n), rad or m.
        angles_deg: the same in degrees.
    """

    kind: Literal["recorded"] = "recorded"
    times: Vector
    angles: _Rows = None
    angles_deg: _Rows = None
    in_degrees: ClassVar[tuple[str, ...]] = ("angles",)

    @field_validator("times")
    @classmethod
    def _rise(cls, times: Array) -> Array:
        if len(times) < 2:
            raise ValueError(f"found {len(times)} entries; expected two or more")
        if (np.diff(times) <= 0).any():
            row = int(np.argmax(np.diff(times) <= 0)) + 1
            raise ValueError(f"entry {row + 1} is {times[row]:g} s, after {times[row - 1]:g} s")
        return times

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        """Cubic Hermite: through every row, with the velocities of the parabola through three."""
        knots, rows = self.times, self.rows("angles", robot.n)
        if len(rows) != len(knots):
            message = f"found {len(rows)} rows; expected {len(knots)}, one per time"
            raise DeclarationError([Problem("angles", message)])
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


def _grown(times: Array, ramp: float) -> tuple[Array, Array, Array]:
    """A quintic from 0 at t = 0 to 1 at the end of the ramp, with its two derivatives."""
    if ramp == 0.0:
        return np.ones(len(times)), np.zeros(len(times)), np.zeros(len(times))
    return quintic(times, ramp)


def _swinging(
    times: Array, start: Array, amplitude: Array, swing: tuple[Any, ...], ramp: tuple[Any, ...]
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


LAWS: Mapping[str, type[Law]] = {
    "constant": Constant,
    "way_points": WayPoints,
    "sine": Sine,
    "chirp": Chirp,
    "step": Step,
    "recorded": Recorded,
}


def law_from(table: Any) -> Law:
    """Builds the declaration of a target motion from a table of a file.

    Args:
        table: `kind` and its fields; a declaration comes back as it is.

    Raises:
        DeclarationError: there is no such kind, or fields are wrong.
    """
    return by_kind(table, LAWS, Law)
