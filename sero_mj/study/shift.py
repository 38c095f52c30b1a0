"""By how much one motion is later than another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LEAST_OVERLAP = 0.3  # of the shorter one
_LEAST_SPEED = 1e-4  # rad/s or m/s, root mean square
_MOST_ROWS = 2**21
# By how much two shifts must differ in likeness so that the one with the longer overlap loses:
# of a motion that repeats itself every period would do, and the nearest is meant.
_FOR_OVERLAP = 0.1


@dataclass(frozen=True)
class Shift:
    """What brings a motion onto another one.

    Attributes:
        seconds: to be added to its times.
        likeness: normalised cross-correlation of the velocities there, 1 for the same motion.
    """

    seconds: float
    likeness: float


def find_shift(times_a: Array, angles_a: Array, times_b: Array, angles_b: Array) -> Shift | None:
    """Finds what must be added to the times of `b`, by the velocities of all joints together.

    The normalised cross-correlation over every overlap of at least 30 % of the shorter motion, and
    a parabola through its highest three values.

    Args:
        times_a: (T,), s.
        angles_a: (T, n).
        times_b: (T',), s.
        angles_b: (T', n).

    Returns:
        None where one of them hardly moves.
    """
    spans = times_a[-1] - times_a[0], times_b[-1] - times_b[0]
    if min(spans) <= 0.0:
        return None
    step = max(
        float(np.median(np.diff(times_a))), float(np.median(np.diff(times_b))),
        sum(spans) / _MOST_ROWS,
    )  # fmt: skip
    a, b = _velocities(times_a, angles_a, step), _velocities(times_b, angles_b, step)
    if min(len(a), len(b)) < 3 or min(_rms(a), _rms(b)) < _LEAST_SPEED:
        return None
    scores, likeness, first = _correlate(a, b)
    best = int(np.argmax(scores))
    # The overlap chooses among hills; how high they are is the likeness alone.
    while best + 1 < len(likeness) and likeness[best + 1] > likeness[best]:
        best += 1
    while best > 0 and likeness[best - 1] > likeness[best]:
        best -= 1
    fraction = 0.0
    if 0 < best < len(scores) - 1 and np.isfinite(scores[best - 1 : best + 2]).all():
        before, at, after = likeness[best - 1 : best + 2]
        bend = before - 2.0 * at + after
        fraction = float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
    seconds = times_a[0] - times_b[0] + (first + best + fraction) * step
    return Shift(float(seconds), float(likeness[best]))


def _correlate(a: Array, b: Array) -> tuple[Array, Array, int]:
    """Score and likeness for every lag of b in rows, and the first of these lags.

    At lag k row i of `b` stands at row i + k of `a`.
    """
    length = len(a) + len(b) - 1
    size = 1 << (length - 1).bit_length()
    product = np.fft.rfft(a, size, axis=0) * np.conj(np.fft.rfft(b, size, axis=0))
    circular = np.fft.irfft(product.sum(axis=1), size)
    first = 1 - len(b)
    raw = np.concatenate([circular[size + first :], circular[: len(a)]])
    lags = np.arange(first, len(a))
    begin, end = np.maximum(lags, 0), np.minimum(lags + len(b), len(a))
    energy_a, energy_b = _summed(a), _summed(b)
    energies = (energy_a[end] - energy_a[begin]) * (energy_b[end - lags] - energy_b[begin - lags])
    overlap = (end - begin) / min(len(a), len(b))
    enough = (overlap >= _LEAST_OVERLAP) & (energies > 1e-9 * energy_a[-1] * energy_b[-1])
    likeness = np.full(len(lags), -np.inf)
    likeness[enough] = raw[enough] / np.sqrt(energies[enough])
    return likeness + _FOR_OVERLAP * np.minimum(overlap, 1.0), likeness, first


def _summed(velocities: Array) -> Array:
    """Energy of all rows before each, (T + 1,)."""
    return np.concatenate([[0.0], np.cumsum(np.sum(velocities**2, axis=1))])


def _velocities(times: Array, angles: Array, step: float) -> Array:
    """By differences of angles at even times, (T, n)."""
    even = np.arange(times[0], times[-1] + 0.5 * step, step)
    sampled = np.stack([np.interp(even, times, column) for column in angles.T], axis=1)
    return np.asarray(np.gradient(sampled, step, axis=0)) if len(even) > 1 else sampled * 0.0


def _rms(velocities: Array) -> float:
    return float(np.sqrt(np.mean(velocities**2)))
