"""Fewer numbers out of many: peak, root mean square, and the envelope of a curve."""

from __future__ import annotations

import numpy as np

from .frames import Array


def envelope(times: Array, values: Array, bins: int) -> tuple[Array, Array]:
    """Keeps the smallest and the largest value of every stretch, at their own times.

    Every point that is returned is one that was given, so that no peak is lost or lowered. Where
    there are few rows, all of them are returned. A stretch without any number is a gap.

    Args:
        times: (T,), rising.
        values: (T,), NaN where nothing is known.
        bins: stretches of equally many rows; up to twice as many points are kept.

    Returns:
        times and values of the points, (k,) each.
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
    # The first and the last row as well, so that lines begin and end where they do.
    kept = np.unique(np.concatenate([low, high, [0, count - 1]]))
    return times[kept], values[kept]


def peak(values: Array) -> int | None:
    """Row of the value (T,) of the greatest size; None where nothing is known."""
    if not np.isfinite(values).any():
        return None
    return int(np.argmax(np.where(np.isfinite(values), np.abs(values), -1.0)))


def rms(values: Array) -> float:
    """Root mean square of the known ones among values (T,); NaN where nothing is known."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan
