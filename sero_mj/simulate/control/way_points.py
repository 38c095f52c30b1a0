"""Target motions through way points, along straight lines, of the joints or of the flange.

All joints, or all six directions of the flange, share one time scaling (the path parameter, 0 to 1,
over time). They start and arrive together, and rest at each way point.

Source: Siciliano, Sciavicco, Villani, Oriolo 2009, Robotics: Modelling, Planning and Control, 4.2.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, ClassVar, Literal

import mujoco
import numpy as np
from pydantic import AfterValidator, Field, model_validator

from ...base.declaration import Frame, Vector
from ...base.errors import Problem
from ...base.frames import Array, Ints
from ...robots.declared.robot import SerialRobot
from .controller import MaybePerJoint
from .target_motions import (
    CartesianMotion,
    CartesianTargetMotion,
    JointTargetMotion,
    Motion,
    Rows,
    Samples,
    in_world,
    quintic,
)  # fmt: skip

TimeScaling = Literal["quintic", "trapezoidal"]

# Maximum speed and acceleration of a quintic from 0 to 1 in 1 s.
_QUINTIC_SPEED, _QUINTIC_ACCELERATION = 15.0 / 8.0, 10.0 / np.sqrt(3.0)
_THIRD = 1.0 / 3.0  # share of the duration in which a trapezoid accelerates, without a limit
_ZERO = 1e-12  # tolerance for rounding, rad or m


def _rising(times: Array | None) -> Array | None:
    if times is not None:
        if not len(times) or times[0] < 0:
            raise Problem(found=times.tolist(), expected="times of at least 0 s").error()
        if (np.diff(times) <= 0).any():
            raise Problem(found=times.tolist(), expected="ascending times").error()
    return times


def _positive(values: Array | None) -> Array | None:
    if values is not None and (values <= 0).any():
        raise Problem(found=values[values <= 0][0], expected="positive numbers").error()
    return values


_Arrivals = Annotated[Vector | None, AfterValidator(_rising)]


def _one_of_two(times: Array | None, speed: float | None) -> None:
    if (times is None) == (speed is None):
        found = "neither" if times is None else "both"
        raise ValueError(f"found {found}; expected exactly one of `times` and `speed`")


def _timed(points: Array, times: Array, each: str) -> tuple[Array, Array, Array]:
    if len(times) != len(points) - 1:
        raise Problem(
            "times", found=len(times), of="entries", expected=f"{len(points) - 1}, one per {each}"
        ).error()
    if times[0] > 0.0:
        times = np.hstack([0.0, times])
    elif len(points) > 2:
        points = points[1:]
    else:  # the robot starts at the only way point, and rests there
        points, times = points[[1, 1]], np.array([0.0, 1.0])
    return points, times[:-1], np.diff(times)


class WayPoints(JointTargetMotion):
    """Moves the joints from one way point to the next. All joints start and arrive together.

    Exactly one of `times` and `speed` must be given.

    Attributes:
        way_points: joint angles, one row per way point, rad or m.
        way_points_deg: `way_points` in degrees.
        times: arrival time at each way point, s. If the first time is 0, the motion starts there.
        speed: share of the velocity limits of the robot, 0 to 1.
        accelerations: maximum acceleration of each joint, rad/s2 or m/s2 (default: the
            `acceleration_limits` of the robot).
        time_law: `quintic` (continuous acceleration) or `trapezoidal` (faster).
        dwell: time of rest at each way point, s; only with `speed`.
    """

    kind: Literal["way_points"] = "way_points"
    way_points: Rows = None
    way_points_deg: Rows = None
    times: _Arrivals = None
    speed: float | None = Field(None, gt=0, le=1)
    accelerations: Annotated[MaybePerJoint, AfterValidator(_positive)] = None
    time_law: TimeScaling = "quintic"
    dwell: float = Field(0.0, ge=0)
    in_degrees: ClassVar[tuple[str, ...]] = ("way_points",)

    @model_validator(mode="after")
    def _times_or_speed(self) -> WayPoints:
        _one_of_two(self.times, self.speed)
        return self

    def motion(self, times: Array, robot: SerialRobot, start: Array) -> Motion:
        points = np.vstack([start, self.rows("way_points", robot.n)])
        if self.times is not None:
            points, starts, durations = _timed(points, self.times, "way point")
            blends = self._blends(np.diff(points, axis=0), starts, durations, robot)
        else:
            starts, durations, blends = self._fast(np.diff(points, axis=0), robot)
        index, way, speed, rate = _along(times, starts, durations, blends)
        lines = np.diff(points, axis=0)[index]
        return Motion(
            times,
            points[index] + way[:, None] * lines,
            speed[:, None] * lines,
            rate[:, None] * lines,
        )

    def _blends(
        self, lines: Array, starts: Array, durations: Array, robot: SerialRobot
    ) -> Array | None:
        if self.time_law == "quintic":
            return None
        blends = []
        rates = self._accelerations(robot)
        for line, start, duration in zip(lines, starts, durations, strict=True):
            try:
                blends.append(trapezoid_blend(duration, _path_limit(line, rates)))
            except ValueError as error:
                joint = robot.names[int(np.argmax(_shares(line, rates)))]
                when = f"to arrive at t = {start + duration:.3f} s"
                message = f"joint {joint} is too slow {when}: {error}; allow more time"
                raise Problem("times", message).error() from None
        return np.array(blends)

    def _fast(self, lines: Array, robot: SerialRobot) -> tuple[Array, Array, Array | None]:
        limits, rates = robot.velocity_limits, self._accelerations(robot)
        if limits is None or rates is None:
            lacks = "velocity_limits" if limits is None else "acceleration_limits"
            hint = "times instead of" if limits is None else "accelerations in addition to"
            message = f"robot '{robot.name}' has no {lacks}; expected {hint} speed"
            raise Problem("speed", message).error()
        speeds = np.array([_path_limit(line, float(self.speed or 1.0) * limits) for line in lines])
        path_rates = np.array([_path_limit(line, rates) for line in lines])
        return _schedule(speeds, path_rates, self.time_law, self.dwell)

    def _accelerations(self, robot: SerialRobot) -> Array | None:
        if self.accelerations is not None:
            return self.per_joint("accelerations", robot.n)
        return robot.acceleration_limits


def _shares(line: Array, limits: Array | None) -> Array:
    return np.zeros(len(line)) if limits is None else np.abs(line) / limits


def _path_limit(line: Array, limits: Array | None) -> float:
    """Returns the limit of the path parameter due to the limits of all joints, or infinity."""
    largest = float(_shares(line, limits).max())
    return 1.0 / largest if largest > _ZERO else np.inf


class CartesianWayPoints(CartesianTargetMotion):
    """Moves the flange from one pose to the next, and rests at each pose.

    Exactly one of `times` and `speed` must be given.

    Attributes:
        poses: poses of the flange: 4x4 matrices, or `{ xyz = [...], rpy_deg = [...] }`.
        relative_to: frame of the poses: `world`, or the initial flange frame (`start`).
        times: arrival time at each pose, s. If the first time is 0, the motion starts there.
        speed: maximum speed, m/s.
        angular_speed: maximum angular speed, rad/s; only with `speed`.
        acceleration: maximum acceleration, m/s2; only with `speed`.
        angular_acceleration: maximum angular acceleration, rad/s2; only with `speed`.
        time_law: `quintic` or `trapezoidal`; always quintic with `times`.
        dwell: time of rest at each pose, s; only with `speed`.
    """

    kind: Literal["cartesian_way_points"] = "cartesian_way_points"
    poses: list[Frame] = Field(min_length=1)
    relative_to: Literal["world", "start"] = "world"
    times: _Arrivals = None
    speed: float | None = Field(None, gt=0, le=100)
    angular_speed: float = Field(1.0, gt=0, le=100)
    acceleration: float = Field(1.0, gt=0, le=1e3)
    angular_acceleration: float = Field(4.0, gt=0, le=1e3)
    time_law: TimeScaling = "quintic"
    dwell: float = Field(0.0, ge=0)

    @model_validator(mode="after")
    def _times_or_speed(self) -> CartesianWayPoints:
        _one_of_two(self.times, self.speed)
        return self

    def sample(self, times: Array, start: Array) -> CartesianMotion:
        # Rotations about a constant axis (slerp, Shoemake 1985).
        poses = (in_world(pose, start, self.relative_to) for pose in self.poses)
        frames: Array = np.array([start, *poses])
        blends: Array | None = None
        if self.times is not None:
            frames, starts, durations = _timed(frames, self.times, "pose")
        lines = np.diff(frames[:, :3, 3], axis=0)
        turns = np.array([_turn(a, b) for a, b in pairwise(frames)])
        if self.times is None:
            length, angle = (np.linalg.norm(part, axis=1) for part in (lines, turns))
            speeds = np.minimum(_over(self.speed or 1.0, length), _over(self.angular_speed, angle))
            rates = np.minimum(
                _over(self.acceleration, length), _over(self.angular_acceleration, angle)
            )
            starts, durations, blends = _schedule(speeds, rates, self.time_law, self.dwell)
        index, way, speed, rate = _along(times, starts, durations, blends)
        result: Array = np.tile(np.eye(4), (len(times), 1, 1))
        result[:, :3, 3] = frames[index, :3, 3] + way[:, None] * lines[index]
        result[:, :3, :3] = frames[index, :3, :3] @ _rotations(way[:, None] * turns[index])
        axes = np.einsum("mij,mj->mi", frames[:-1, :3, :3], turns)  # in world axes
        directions = np.hstack([lines, axes])[index]
        return CartesianMotion(
            times, result, speed[:, None] * directions, rate[:, None] * directions
        )


def _over(limit: float, lengths: Array) -> Array:
    return np.where(lengths > _ZERO, limit / np.maximum(lengths, _ZERO), np.inf)


def _turn(a: Array, b: Array) -> Array:
    """Returns the shortest rotation vector from frame a to b in axes of a, shape (3,), rad."""
    quaternion, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, (a[:3, :3].T @ b[:3, :3]).reshape(9))
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


def _rotations(vectors: Array) -> Array:
    """Returns rotation matrices for rotation vectors, (T, 3), rad (Rodrigues' formula)."""
    angles = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.maximum(angles, 1e-300)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    sin, rest = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sin * cross + rest * (cross @ cross))


def trapezoid(times: Array, duration: float, blend: float) -> Samples:
    """Returns the path parameter (0 to 1), its speed (1/s) and acceleration (1/s2), shape (T,).

    A phase of constant speed is between phases of constant acceleration and deceleration.

    Args:
        times: times since the start, shape (T,), s. The motion rests before start and after end.
        duration: duration of the motion, s.
        blend: time of acceleration, and of deceleration, at most half of the duration, s.
    """
    speed = 1.0 / (duration - blend)
    rate = speed / blend
    t = np.clip(times, 0.0, duration)
    left = duration - t
    up, down = t < blend, left < blend
    way = np.where(up, 0.5 * rate * t**2, speed * (t - 0.5 * blend))
    way = np.where(down, 1.0 - 0.5 * rate * left**2, way)
    speeds = np.where(up, rate * t, np.where(down, rate * left, speed))
    rates = np.where(up, rate, np.where(down, -rate, 0.0))
    rates = np.where((times < 0.0) | (times >= duration), 0.0, rates)
    return way, speeds, rates


def quintic_duration(speed: float, acceleration: float) -> float:
    """Returns a quintic's shortest duration in s within speed (1/s) and acceleration (1/s2)."""
    return float(max(_QUINTIC_SPEED / speed, np.sqrt(_QUINTIC_ACCELERATION / acceleration), 0.0))


def trapezoid_duration(speed: float, acceleration: float) -> tuple[float, float]:
    """Returns the shortest duration and its blend time in s for a trapezoid within the limits.

    The speed limit (1/s) is not reached if the acceleration limit (1/s2) is too low.
    """
    if speed**2 >= acceleration:
        blend = float(1.0 / np.sqrt(acceleration))
        return 2.0 * blend, blend
    return 1.0 / speed + speed / acceleration, speed / acceleration


def trapezoid_blend(duration: float, acceleration: float) -> float:
    """Returns the blend time in s of a trapezoid with a duration and an acceleration (1/s2).

    With an infinite acceleration, it is a third of the duration. Raises ValueError if the
    acceleration is too low.
    """
    if not np.isfinite(acceleration):
        return duration * _THIRD
    needed = 4.0 / duration**2
    if acceleration < needed * (1.0 - 1e-9):
        raise ValueError(f"it would need {needed / acceleration:.3g} times its acceleration limit")
    root = np.sqrt(max(duration**2 - 4.0 / acceleration, 0.0))
    return float((duration - root) / 2.0)


def _schedule(
    speeds: Array, rates: Array, time_law: TimeScaling, dwell: float
) -> tuple[Array, Array, Array | None]:
    """Returns the earliest start, duration and (for trapezoids) blend time per line, (m,), s.

    Maximum speeds (1/s) and accelerations (1/s2) are infinite for lines of zero length.
    """
    durations, blends = np.zeros((2, len(speeds)))
    for way, (speed, rate) in enumerate(zip(speeds, rates, strict=True)):
        if not np.isfinite(speed):
            continue
        if time_law == "quintic":
            durations[way] = quintic_duration(speed, rate)
        else:
            durations[way], blends[way] = trapezoid_duration(speed, rate)
    starts: Array = np.hstack([0.0, np.cumsum(durations + dwell)[:-1]])
    return starts, durations, None if time_law == "quintic" else blends


def _along(
    times: Array, starts: Array, durations: Array, blends: Array | None
) -> tuple[Ints, Array, Array, Array]:
    """Returns the line's index, path parameter, speed and acceleration at each time, (T,) each.

    `starts` (ascending), `durations` and `blends` (None for quintics), (m,) each, are in seconds.
    """
    index = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, None)
    samples = np.zeros((3, len(times)))
    for way in np.unique(index):
        rows = index == way
        local = times[rows] - starts[way]
        if durations[way] <= 0.0:  # both way points are equal
            samples[0, rows] = 1.0
        elif blends is None:
            samples[:, rows] = quintic(local, durations[way])
        else:
            samples[:, rows] = trapezoid(local, durations[way], blends[way])
    return index, *samples
