"""Data reduction: peak, root mean square, and the envelope of a curve."""

from __future__ import annotations

import numpy as np

from .frames import Array


def envelope(times: Array, values: Array, bins: int) -> tuple[Array, Array]:
    """Keeps the smallest and the largest value of every interval, at their own times.

    Every returned point is an input point, so that no peak is lost or lowered. Times (T,) rise, and
    values (T,) are NaN where unknown; up to two points are kept per bin. If there are few rows, all
    of them are returned. An interval without any number is a gap.
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
    # Also the first and the last row, so that lines have the same begin and end.
    kept = np.unique(np.concatenate([low, high, [0, count - 1]]))
    return times[kept], values[kept]


def peak(values: Array) -> int | None:
    """Row of the value (T,) of largest magnitude; None if all are unknown."""
    if not np.isfinite(values).any():
        return None
    return int(np.argmax(np.where(np.isfinite(values), np.abs(values), -1.0)))


def rms(values: Array) -> float:
    """Root mean square of the known values (T,); NaN if all are unknown."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan
