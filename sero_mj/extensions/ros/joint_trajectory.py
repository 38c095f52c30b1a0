"""Joint trajectories, interpolated as in joint_trajectory_controller of ros2_control."""

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
    """An interpolated `trajectory_msgs/JointTrajectory` that begins at the current state.

    If all points have accelerations, each joint follows quintic polynomials between points. If the
    points have only velocities, the polynomials are cubic, otherwise linear. Efforts are
    interpolated linearly. After the last point, the joints hold their positions.

    Args:
        names: joint names in the robot's order, which may differ from the order in the message.
        now: current time in seconds on the clock of the message stamp. A stamp of 0 means `now`.
            Points before `now` are skipped.
        entry: joint angles and velocities at `now`, shape (2, n).

    Raises:
        MalformedMessage: the joint names or the points are invalid, or the last point is before
            `now`.
    """

    def __init__(self, message: Any, names: list[str], now: float, entry: Array) -> None:
        order = _order(message.joint_names, names)
        points = message.points
        if not 1 <= len(points) <= _MAX_POINTS:
            raise _malformed("points", found=len(points), expected=f"1 to {_MAX_POINTS}")
        stamp = _seconds(message.header.stamp)
        after = np.array([_seconds(point.time_from_start) for point in points])
        if not (np.diff(after, prepend=-1e-9) > 0.0).all():
            raise _malformed("time_from_start", found=after.tolist(), expected="increasing times")
        rows = {
            key: _rows(points, key, order)
            for key in (*_ORDERS, "effort")
            if any(len(getattr(point, key)) for point in points)
        }
        if "positions" not in rows:
            raise _malformed("positions", "are required in every point")
        times = after + (stamp or now)
        if times[-1] < now:
            raise _malformed(
                "header.stamp", found=stamp, expected=f"a trajectory that ends after {now:.3f} s"
            )
        first = min(int(np.searchsorted(times, now, side="right")), len(times) - 1)
        derivatives = []  # one array per order, shape (1 + points, n)
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
        """Returns joint angles, velocities and efforts at a time in seconds, shape (n,) each."""
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
    ends = np.zeros((2 * d, 2 * d))  # derivatives of the monomials at u = 0 and u = 1
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
        raise _malformed("joint_names", "contains a joint twice: found", found=found)
    for name in found:
        if name not in names:
            raise _malformed("joint_names", "no joint", found=name, available=names)
    missing = [name for name in names if name not in found]
    if missing:
        raise _malformed("joint_names", f"lacks {', '.join(missing)}", expected="all joints")
    return [found.index(name) for name in names]


def _rows(points: list[Any], key: str, order: list[int]) -> Array:
    rows = [getattr(point, key) for point in points]
    for number, row in enumerate(rows):
        if len(row) != len(order):
            where = f"points[{number}].{key}"
            raise _malformed(where, found=len(row), of="numbers", expected=len(order))
    table: Array = np.array(rows, dtype=float)[:, order]
    if not np.isfinite(table).all():
        number = int(np.argmin(np.isfinite(table).all(1)))
        raise _malformed(f"points[{number}].{key}", "contains a number that is not finite")
    return table


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def _malformed(*args: Any, **details: Any) -> MalformedMessage:
    return MalformedMessage(str(Problem(*args, **details)))
