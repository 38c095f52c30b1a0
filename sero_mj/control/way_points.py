"""Way points in joint space: straight lines between them, from rest to rest."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field, model_validator

from ..assemble.robot import SerialRobot
from ..declaration import Vector, of_shape
from ..errors import DeclarationError, Problem
from .gains import MaybePerJoint
from .law import Law, Motion
from .time_laws import TimeLaw, along, schedule, trapezoid_blend

Array = NDArray[np.float64]
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
