"""Target motions through way points: straight lines from rest to rest, of the joints or the flange.

All joints, and all six directions of the flange, share a time law (the share of the way, 0 to 1,
over time): they start and arrive together.

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

_QUINTIC_SPEED = 15.0 / 8.0  # its greatest speed, for a way of one in a time of one
_QUINTIC_ACCELERATION = 10.0 / np.sqrt(3.0)
_THIRD = 1.0 / 3.0  # of the time a trapezoid speeds up where nothing else says how long
_NOTHING = 1e-12  # s; shorter ways count as none


def _rising(times: Array | None) -> Array | None:
    if times is not None:
        if not len(times) or times[0] < 0:
            raise Problem(found=times.tolist(), expected="times from 0 s on").error()
        if (np.diff(times) <= 0).any():
            raise Problem(found=times.tolist(), expected="times that rise").error()
    return times


def _positive(values: Array | None) -> Array | None:
    if values is not None and (values <= 0).any():
        raise Problem(found=values[values <= 0][0], expected="positive numbers").error()
    return values


_Arrivals = Annotated[Vector | None, AfterValidator(_rising)]


def _one_of_two(times: Array | None, speed: float | None) -> None:
    if (times is None) == (speed is None):
        found = "neither" if times is None else "both"
        raise ValueError(f"found {found} of times and speed; expected one of them")


def _timed(points: Array, times: Array, each: str) -> tuple[Array, Array, Array]:
    if len(times) != len(points) - 1:
        raise Problem(
            "times", found=len(times), of="entries", expected=f"{len(points) - 1}, one per {each}"
        ).error()
    if times[0] > 0.0:
        times = np.hstack([0.0, times])
    elif len(points) > 2:
        points = points[1:]
    else:  # it stays there
        points, times = points[[1, 1]], np.array([0.0, 1.0])
    return points, times[:-1], np.diff(times)


class WayPoints(JointTargetMotion):
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
        """Straight lines in joint space."""
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
                blends.append(trapezoid_blend(duration, _room(line, rates)))
            except ValueError as error:
                joint = robot.names[int(np.argmax(_shares(line, rates)))]
                when = f"to arrive at t = {start + duration:.3f} s"
                message = f"joint {joint} is too slow {when}: {error}; expected more time"
                raise Problem("times", message).error() from None
        return np.array(blends)

    def _fast(self, lines: Array, robot: SerialRobot) -> tuple[Array, Array, Array | None]:
        limits, rates = robot.velocity_limits, self._accelerations(robot)
        if limits is None or rates is None:
            lacks = "velocity_limits" if limits is None else "acceleration_limits"
            hint = "times" if limits is None else "accelerations"
            message = f"robot '{robot.name}' has no {lacks}; expected {hint} here"
            raise Problem("speed", message).error()
        speeds = np.array([_room(line, float(self.speed or 1.0) * limits) for line in lines])
        shares = np.array([_room(line, rates) for line in lines])
        return _schedule(speeds, shares, self.time_law, self.dwell)

    def _accelerations(self, robot: SerialRobot) -> Array | None:
        if self.accelerations is not None:
            return self.per_joint("accelerations", robot.n)
        return robot.acceleration_limits


def _shares(line: Array, limits: Array | None) -> Array:
    return np.zeros(len(line)) if limits is None else np.abs(line) / limits


def _room(line: Array, limits: Array | None) -> float:
    """The limit on the way (0 to 1) that the joint with the least room sets; inf for none."""
    most = float(_shares(line, limits).max())
    return 1.0 / most if most > _NOTHING else np.inf


class CartesianWayPoints(CartesianTargetMotion):
    """Goes to one pose after the other, from rest to rest.

    Either `times` say when it arrives, or it goes as fast as the speeds and accelerations allow.

    Attributes:
        poses: frames of the flange: 4x4, or `{ xyz = [...], rpy_deg = [...] }`.
        relative_to: the `world`, or the flange at its `start`.
        times: s, when it arrives at each; a first of 0 is where it starts.
        speed: m/s.
        angular_speed: rad/s.
        acceleration: m/s2.
        angular_acceleration: rad/s2.
        time_law: `quintic` or `trapezoidal`; at times always quintic.
        dwell: s at each pose, where there are no `times`.
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
        """Straight lines; the flange turns about one axis that stays (slerp, Shoemake 1985)."""
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
    """How much of each way there is room for in a second; inf for ways of no length."""
    return np.where(lengths > 1e-12, limit / np.maximum(lengths, 1e-12), np.inf)


def _turn(a: Array, b: Array) -> Array:
    """Rotation vector (3,), rad, in a's axes, that turns a (4, 4) to b the short way."""
    quaternion, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, (a[:3, :3].T @ b[:3, :3]).reshape(9))
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


def _rotations(vectors: Array) -> Array:
    """Rotations (T, 3, 3) by rotation vectors (T, 3), rad (Rodrigues)."""
    angles = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.maximum(angles, 1e-300)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    sin, rest = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sin * cross + rest * (cross @ cross))


def trapezoid(times: Array, duration: float, blend: float) -> Samples:
    """Constant acceleration, constant speed, constant deceleration.

    Args:
        times: (T,), s from its start; before it and after its end it rests.
        duration: s.
        blend: s of speeding up, and of slowing down; at most half the duration.

    Returns:
        way (0 to 1), speed (1/s) and acceleration (1/s2), each (T,).
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
    """Shortest duration, s, of a quintic way of one within speed (1/s) and acceleration (1/s2)."""
    return float(max(_QUINTIC_SPEED / speed, np.sqrt(_QUINTIC_ACCELERATION / acceleration), 0.0))


def trapezoid_duration(speed: float, acceleration: float) -> tuple[float, float]:
    """Shortest duration and blend, s, of a trapezoidal way of one within the limits.

    Args:
        speed: 1/s; not reached where the way is too short for it.
        acceleration: 1/s2.
    """
    if speed**2 >= acceleration:
        blend = float(1.0 / np.sqrt(acceleration))
        return 2.0 * blend, blend
    return 1.0 / speed + speed / acceleration, speed / acceleration


def trapezoid_blend(duration: float, acceleration: float) -> float:
    """Blend, s, with which a way of one takes the duration; a third of it with an infinite one.

    Raises:
        ValueError: the acceleration (1/s2) is too low for the duration.
    """
    if not np.isfinite(acceleration):
        return duration * _THIRD
    least = 4.0 / duration**2
    if acceleration < least * (1.0 - 1e-9):
        raise ValueError(f"{least / acceleration:.3g} times the acceleration would be needed")
    root = np.sqrt(max(duration**2 - 4.0 / acceleration, 0.0))
    return float((duration - root) / 2.0)


def _schedule(
    speeds: Array, rates: Array, time_law: TimeScaling, dwell: float
) -> tuple[Array, Array, Array | None]:
    """Starts, durations and, for trapezoids, blends of ways, as fast as is allowed, (m,) each, s.

    Args:
        speeds: (m,), 1/s; infinite where there is no way to go.
        rates: (m,), 1/s2; likewise.
        dwell: s between two.
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
    """Index of the way (T,), and way, speed and acceleration on it, (T,) each, with rests between.

    Args:
        times: (T,), s.
        starts: (m,), s, when each way begins; rising.
        durations: (m,), s.
        blends: (m,), s, of trapezoids; None for quintics.
    """
    index = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, None)
    samples = np.zeros((3, len(times)))
    for way in np.unique(index):
        rows = index == way
        local = times[rows] - starts[way]
        if durations[way] <= 0.0:  # nothing to move
            samples[0, rows] = 1.0
        elif blends is None:
            samples[:, rows] = quintic(local, durations[way])
        else:
            samples[:, rows] = trapezoid(local, durations[way], blends[way])
    return index, *samples
