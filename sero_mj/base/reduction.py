"""Data reduction: peak value, root mean square, and envelope of a curve."""

from __future__ import annotations

import numpy as np

from .frames import Array

_BATCHES = 5


def envelope(times: Array, values: Array, bins: int) -> tuple[Array, Array]:
    """Returns the times and values of the minimum and the maximum in each of `bins` intervals.

    All returned points are input points, so no peak is lost or lowered. If there are at most two
    points per bin, all points are returned. A bin without any known value becomes a gap.

    Args:
        times: increasing times in seconds, shape (T,).
        values: values at these times, shape (T,); NaN if unknown.
    """
    count = len(times)
    if count <= 2 * bins:
        return times, values
    size = -(-count // bins)
    padded = np.full(size * -(-count // size), np.nan)
    padded[:count] = values
    stretches = padded.reshape(-1, size)
    known = np.isfinite(stretches)
    first = np.arange(len(stretches)) * size
    low = first + np.argmin(np.where(known, stretches, np.inf), axis=1)
    high = first + np.argmax(np.where(known, stretches, -np.inf), axis=1)
    # The first and the last point preserve the ends of the curve.
    selected = np.unique(np.concatenate([low, high, [0, count - 1]]))
    return times[selected], values[selected]


def peak(values: Array) -> int | None:
    """Returns the index of the value with the largest magnitude, or None if all values are NaN."""
    if not np.isfinite(values).any():
        return None
    return int(np.argmax(np.where(np.isfinite(values), np.abs(values), -1.0)))


def rms(values: Array) -> float:
    """Returns the root mean square of the values that are not NaN, or NaN if all values are NaN."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def rms_with_error(values: Array) -> tuple[float, float]:
    """Returns the root mean square of the known values, and its standard error.

    The error is that of batch means: the scatter between the mean squares of consecutive fifths,
    because neighboring values are not independent. Both are NaN if there are too few values.
    """
    known = values[np.isfinite(values)]
    if len(known) < _BATCHES:
        return np.nan, np.nan
    found = rms(known)
    squares = [np.mean(batch**2) for batch in np.array_split(known, _BATCHES)]
    error = np.std(squares, ddof=1) / np.sqrt(_BATCHES)
    return found, float(error / (2.0 * found)) if found > 0.0 else 0.0
