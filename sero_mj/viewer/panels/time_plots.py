"""What plots over time are made of: lines with gaps, and ranges that rarely change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.frames import Array
from ..session.binned_history import SPAN
from ..session.torque_history import split_at_gaps
from ..session.widgets import Line, Plot

_NEAR = 0.8  # fraction of the limit from which on it is in the visible range
_MARGIN = 1.15  # of the range over that of the values
_NARROWEST = 1e-3  # half a range, of its middle


def time_plot(label: str, lines: Sequence[Line], limit: float, least: float) -> Plot:
    """Returns a plot of the last seconds."""
    values = np.concatenate([line.y for line in lines]) if lines else np.zeros(0)
    return Plot("s", label, lines, (-SPAN, 0.0), y_range(values, limit, least), (limit, -limit))


def with_gaps(times: Array, values: Array) -> tuple[Array, Array]:
    """Returns the samples of a line, with one NaN in every gap."""
    values = values.astype(float)
    x, y = [times[:0]], [values[:0]]
    for piece in split_at_gaps(times, values):
        if len(x) > 1:
            x.append(times[piece[:1]])
            y.append(np.array([np.nan]))
        x.append(times[piece])
        y.append(values[piece])
    return np.concatenate(x), np.concatenate(y)


def y_range(values: Array, limit: float, least: float) -> tuple[float, float]:
    """Returns lower and upper end of a plot, rounded so that they rarely change.

    Args:
        limit: of their magnitude, inf for none; it is in the range when values come close to it.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    if np.isfinite(limit):
        high = max(high, limit) if high > _NEAR * limit else high
        low = min(low, -limit) if low < -_NEAR * limit else low
    middle = (low + high) / 2
    half = max((high - low) / 2 * _MARGIN, least, _NARROWEST * abs(middle))
    step = 10.0 ** np.floor(np.log10(half)) / 2
    return (
        float(np.floor((middle - half) / step) * step),
        float(np.ceil((middle + half) / step) * step),
    )
