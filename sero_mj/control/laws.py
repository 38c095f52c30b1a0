"""Target motions in joint space: constant, way points, sine, chirp, step, recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from ..assemble.robot import SerialRobot
from ..declaration import Vector, of_shape
from ..errors import DeclarationError, Problem
from ..kinds import by_kind
from .gains import MaybePerJoint, PerJoint, within
from .law import Law, Motion
from .time_laws import quintic
from .way_points import WayPoints

Array = NDArray[np.float64]
_Rows = Annotated[Array | None, of_shape(None, None)]
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
