"""Time laws: the share of a path, 0 to 1, over time, from rest to rest.

All joints of a robot, and all six directions of a flange, share one: they start and arrive together
and move on a straight line.

Source: Siciliano, Sciavicco, Villani, Oriolo 2009, Robotics: Modelling, Planning and Control, 4.2.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TimeLaw = Literal["quintic", "trapezoidal"]
Samples = tuple[Array, Array, Array]

_QUINTIC_SPEED = 15.0 / 8.0  # its greatest speed, for a way of one in a time of one
_QUINTIC_ACCELERATION = 10.0 / np.sqrt(3.0)
_THIRD = 1.0 / 3.0  # of the time a trapezoid speeds up where nothing else says how long


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


def schedule(
    speeds: Array, accelerations: Array, time_law: TimeLaw, dwell: float
) -> tuple[Array, Array, Array | None]:
    """Start times and durations of consecutive segments, as fast as is allowed.

    Args:
        speeds: (m,), 1/s; infinite where there is no way to go.
        accelerations: (m,), 1/s2; likewise.
        time_law: of all of them.
        dwell: s between two.

    Returns:
        starts, durations and, for trapezoids, blends, (m,) each, s.
    """
    durations: Array = np.zeros(len(speeds))
    blends: Array = np.zeros(len(speeds))
    for way, (speed, rate) in enumerate(zip(speeds, accelerations, strict=True)):
        if not np.isfinite(speed):
            continue
        if time_law == "quintic":
            durations[way] = quintic_duration(speed, rate)
        else:
            durations[way], blends[way] = trapezoid_duration(speed, rate)
    starts: Array = np.hstack([0.0, np.cumsum(durations + dwell)[:-1]])
    return starts, durations, None if time_law == "quintic" else blends


def along(
    times: Array, starts: Array, durations: Array, blends: Array | None
) -> tuple[NDArray[np.intp], Array, Array, Array]:
    """Position, speed and acceleration along consecutive segments, with rests between them.

    Args:
        times: (T,), s.
        starts: (m,), s, when each way begins; rising.
        durations: (m,), s.
        blends: (m,), s, of trapezoids; None for quintics.

    Returns:
        index of the way (T,), and way, speed and acceleration on it, (T,) each.
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
