"""Target motions of the flange: straight lines between poses, turning about one axis at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ..declaration import Declaration, Frame, by_kind
from ..errors import DeclarationError, Problem
from .laws import Arrivals
from .time_laws import TimeLaw, along, schedule

Array = NDArray[np.float64]


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


class CartesianLaw(Declaration):
    """Base of the declarations of target motions of the flange."""

    def sample(self, times: Array, start: Array) -> CartesianMotion:
        """The motion of a whole run.

        Args:
            times: (T,), s, rising.
            start: T_world_flange (4, 4), m, at first.

        Raises:
            DeclarationError: fields that do not fit each other.
        """
        raise NotImplementedError


class CartesianConstant(CartesianLaw):
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
        pose = start if self.pose is None else _in_world(self.pose, start, self.relative_to)
        still = np.zeros((len(times), 6))
        return CartesianMotion(times, np.tile(pose, (len(times), 1, 1)), still, still)


class CartesianWayPoints(CartesianLaw):
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
    times: Arrivals = None
    speed: float | None = Field(None, gt=0, le=100)
    angular_speed: float = Field(1.0, gt=0, le=100)
    acceleration: float = Field(1.0, gt=0, le=1e3)
    angular_acceleration: float = Field(4.0, gt=0, le=1e3)
    time_law: TimeLaw = "quintic"
    dwell: float = Field(0.0, ge=0)

    @model_validator(mode="after")
    def _one_of_two(self) -> CartesianWayPoints:
        if (self.times is None) == (self.speed is None):
            found = "neither" if self.times is None else "both"
            raise ValueError(f"found {found} of times and speed; expected one of them")
        return self

    def sample(self, times: Array, start: Array) -> CartesianMotion:
        """Straight lines; the flange turns about one axis that stays (slerp, Shoemake 1985)."""
        poses = [start, *(_in_world(pose, start, self.relative_to) for pose in self.poses)]
        starts: Array | None = None
        if self.times is not None:
            poses, starts, durations, blends = self._timed(poses)
        frames = np.array(poses)
        lines = np.diff(frames[:, :3, 3], axis=0)
        turns = np.array([_turn(a, b) for a, b in pairwise(frames)])
        if starts is None:
            length, angle = (np.linalg.norm(part, axis=1) for part in (lines, turns))
            speeds = np.minimum(_over(self.speed or 1.0, length), _over(self.angular_speed, angle))
            rates = np.minimum(
                _over(self.acceleration, length), _over(self.angular_acceleration, angle)
            )
            starts, durations, blends = schedule(speeds, rates, self.time_law, self.dwell)
        index, way, speed, rate = along(times, starts, durations, blends)
        result: Array = np.tile(np.eye(4), (len(times), 1, 1))
        result[:, :3, 3] = frames[index, :3, 3] + way[:, None] * lines[index]
        result[:, :3, :3] = frames[index, :3, :3] @ _rotations(way[:, None] * turns[index])
        axes = np.einsum("mij,mj->mi", frames[:-1, :3, :3], turns)  # in world axes
        directions = np.hstack([lines, axes])[index]
        return CartesianMotion(
            times, result, speed[:, None] * directions, rate[:, None] * directions
        )

    def _timed(self, poses: list[Array]) -> tuple[list[Array], Array, Array, None]:
        arrivals = self.times
        assert arrivals is not None
        if len(arrivals) != len(poses) - 1:
            wanted = f"expected {len(poses) - 1}, one per pose"
            raise DeclarationError([Problem("times", f"found {len(arrivals)} entries; {wanted}")])
        if arrivals[0] == 0.0:
            poses = poses[1:] if len(poses) > 2 else [poses[1], poses[1]]
            arrivals = arrivals if len(arrivals) > 1 else np.array([0.0, 1.0])
        else:
            arrivals = np.hstack([0.0, arrivals])
        return poses, arrivals[:-1], np.diff(arrivals), None


def _in_world(pose: Array, start: Array, relative_to: str) -> Array:
    return np.asarray(start @ pose) if relative_to == "start" else pose


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


CARTESIAN_LAWS: Mapping[str, type[CartesianLaw]] = {
    "cartesian_constant": CartesianConstant,
    "cartesian_way_points": CartesianWayPoints,
}


def cartesian_law_from(table: Any) -> CartesianLaw:
    """Builds the declaration of a target motion of the flange from a table of a file.

    Args:
        table: `kind` and its fields; a declaration comes back as it is.

    Raises:
        DeclarationError: there is no such kind, or fields are wrong.
    """
    return by_kind(table, CARTESIAN_LAWS, CartesianLaw)
