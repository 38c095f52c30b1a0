"""Motions through points in time, as joint_trajectory_controller of ros2_control takes them."""

from __future__ import annotations

from math import factorial, perm
from typing import Any

import numpy as np
from numpy.polynomial import polynomial

from ...base.errors import Problem
from ...base.frames import Array
from .messages import MalformedMessage

_ORDERS = ("positions", "velocities", "accelerations")
_MAX_POINTS = 100_000


class JointTrajectory:
    """A `trajectory_msgs/JointTrajectory`, with the point from where it is entered.

    Between two points each joint follows a quintic where all points have accelerations, a cubic
    where they have velocities, and a straight line else; efforts are interpolated linearly. The
    last point is held.

    Args:
        names: of the robot's joints, in its order; the message's order is its own.
        now: s, on the clock of its stamp; a stamp of 0 means now. Points before it are left out.
        entry: (2, n), angles and velocities from where it is entered, now.

    Raises:
        MalformedMessage: it is for other joints, its points are no motion, or it has ended.
    """

    def __init__(self, message: Any, names: list[str], now: float, entry: Array) -> None:
        order = _order(message.joint_names, names)
        points = message.points
        if not 1 <= len(points) <= _MAX_POINTS:
            raise _malformed("points", found=len(points), expected=f"1 to {_MAX_POINTS}")
        stamp = _seconds(message.header.stamp)
        after = np.array([_seconds(point.time_from_start) for point in points])
        if not (np.diff(after, prepend=-1e-9) > 0.0).all():
            raise _malformed("time_from_start", found=after.tolist(), expected="times that grow")
        rows = {
            key: _rows(points, key, order)
            for key in (*_ORDERS, "effort")
            if any(len(getattr(point, key)) for point in points)
        }
        if "positions" not in rows:
            raise _malformed("positions", "are required in every point")
        times = after + (stamp or now)
        if times[-1] < now:
            raise _malformed("header.stamp", found=stamp, expected=f"an end after {now:.3f} s")
        first = min(int(np.searchsorted(times, now, side="right")), len(times) - 1)
        derivatives = []  # (1 + points, n) each
        for key, begin in zip(_ORDERS, (*entry, np.zeros(len(names))), strict=True):
            if key not in rows:
                break
            derivatives.append(np.vstack((begin, rows[key][first:])))
        efforts = rows.get("effort", np.zeros((len(times), len(names))))[first:]
        self._times = np.append(now, times[first:])
        self._efforts = np.vstack((efforts[:1], efforts))
        self._last = derivatives[0][-1]
        self._segments = _segments(self._times, np.array(derivatives))

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Angles, velocities and efforts at a time, (n,) each; rad, rad/s, Nm, or m, m/s, N."""
        times = self._times
        k = int(np.searchsorted(times, time, side="right")) - 1
        if k >= len(times) - 1:
            return self._last, np.zeros_like(self._last), self._efforts[-1]
        duration = times[k + 1] - times[k]
        u = max(0.0, (time - times[k]) / duration)
        coefficients = self._segments[k]
        angles: Array = polynomial.polyval(u, coefficients)
        velocities = polynomial.polyval(u, polynomial.polyder(coefficients)) / duration
        efforts = (1.0 - u) * self._efforts[k] + u * self._efforts[k + 1]
        return angles, velocities, efforts


def _segments(times: Array, derivatives: Array) -> Array:
    d = len(derivatives)
    durations = np.diff(times)
    ends = np.zeros((2 * d, 2 * d))  # derivatives of the powers at 0 and at 1
    for k in range(d):
        ends[k, k] = factorial(k)
        ends[d + k] = [perm(power, k) for power in range(2 * d)]
    scaled = [
        values * durations[:, None] ** k
        for half in (derivatives[:, :-1], derivatives[:, 1:])
        for k, values in enumerate(half)
    ]
    return np.linalg.solve(ends, np.array(scaled).swapaxes(0, 1))


def _order(found: list[str], names: list[str]) -> list[int]:
    if len(found) != len(set(found)):
        raise _malformed("joint_names", "has a joint twice", found=found)
    for name in found:
        if name not in names:
            raise _malformed("joint_names", "no joint", found=name, available=names)
    missing = [name for name in names if name not in found]
    if missing:
        raise _malformed("joint_names", f"without {', '.join(missing)}", expected="all joints")
    return [found.index(name) for name in names]


def _rows(points: list[Any], key: str, order: list[int]) -> Array:
    rows = [getattr(point, key) for point in points]
    for number, row in enumerate(rows):
        if len(row) != len(order):
            where = f"points[{number}].{key}"
            raise _malformed(where, found=len(row), of="numbers", expected=len(order))
    table: Array = np.array(rows, dtype=float)[:, order]
    if not np.isfinite(table).all():
        raise _malformed(f"points[{int(np.argmin(np.isfinite(table).all(1)))}].{key}", "not finite")
    return table


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def _malformed(*args: Any, **details: Any) -> MalformedMessage:
    return MalformedMessage(str(Problem(*args, **details)))
