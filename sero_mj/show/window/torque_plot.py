"""Live plots of commanded and measured torque of the selected joint."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assemble.world_view import WorldView
from ..torque_history import SPAN, TorqueHistory, joint_name, split_at_gaps

Array = NDArray[np.float64]

_NAMES = ("measured", "commanded")
# Light blue and orange: distinct for the colour-blind and on a dark background.
_RGB = ((0.45, 0.78, 1.0), (1.0, 0.62, 0.18))
_ERROR_RGB = (0.75, 0.88, 0.45)
_LIMITS = (2, 3)  # indices of the limits among the lines of a figure
_LIMIT_RGB = (0.85, 0.30, 0.30)
# Fraction of the half range that the lines use; the legend is above it.
_BELOW, _ABOVE = 0.55, 0.85
# Of the grid, by the whole units that are in the range.
_STEPS = {1: 5, 2: 4, 3: 3, 4: 4, 5: 5, 6: 6, 7: 7, 8: 4, 9: 3, 10: 5}
_HUGE = 1e5  # Nm or N, from which on numbers have an exponent
_LEAST_RANGE = 1.0  # Nm or N


def y_range(values: Array, limit: float) -> tuple[float, float, int]:
    """Returns lower and upper end of the plot, Nm or N, and the number of grid steps.

    Args:
        values: all values of the plot, Nm or N, NaN for no data.
        limit: of the torque, inf for none; it is in the range when torques come close to it.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    if np.isfinite(limit) and max(abs(low), abs(high)) > 0.8 * limit:
        high, low = (max(high, limit), low) if high > -low else (high, min(low, -limit))
    span, middle = max(high - low, _LEAST_RANGE), (low + high) / 2
    low, high = middle - _BELOW * span, middle + _ABOVE * span
    for _ in range(2):  # repeated if rounding has made it longer than ten units
        # `mjr_figure` always widens a range to whole powers of ten.
        unit = 10.0 ** np.floor(np.log10((high - low) * (1 + 1e-9)))
        low, high = float(np.floor(low / unit) * unit), float(np.ceil(high / unit) * unit)
    return low, high, _STEPS.get(round((high - low) / unit), 5)


def make_figure(rgb: tuple[tuple[float, float, float], ...]) -> mujoco.MjvFigure:
    """Returns an empty figure whose first lines have these colours; limits are red."""
    figure = mujoco.MjvFigure()
    mujoco.mjv_defaultFigure(figure)
    figure.flg_legend, figure.flg_extend = 1, 0
    figure.flg_ticklabel[:] = 1
    figure.gridsize[0] = 5
    figure.gridrgb[:] = 0.32, 0.36, 0.42
    figure.figurergba[:] = 0.07, 0.09, 0.12, 1.0
    figure.panergba[:] = 0.10, 0.12, 0.16, 1.0
    figure.legendrgba[:] = 0.07, 0.09, 0.12, 0.6
    figure.textrgb[:] = 0.88, 0.90, 0.93
    figure.linewidth, figure.gridwidth = 2.5, 1.0
    figure.xformat = "%.0f"
    figure.range[0] = -SPAN, 0.0
    figure.linergb[: len(rgb)] = rgb
    figure.linergb[_LIMITS[0] : _LIMITS[1] + 1] = _LIMIT_RGB
    return figure


class TorquePlot:
    """Fills figures with the history of one joint: torques, and their error."""

    def __init__(self, world: WorldView) -> None:
        self._world = world
        self.torques, self.error = make_figure(_RGB), make_figure((_ERROR_RGB,))

    def fill(self, history: TorqueHistory, joint: int) -> list[mujoco.MjvFigure]:
        """Returns the figures of a joint of the world."""
        joints = self._world.joints
        times, values = history.of(joint)
        limit = float(joints.torque_limit[joint])
        what, unit = ("torque", "Nm") if joints.revolute[joint] else ("force", "N")
        bound = f", limit {limit:g}" if np.isfinite(limit) else ""
        name = joint_name(self._world, joint)
        self.torques.title = f"{name}: {what} [{unit}] over time [s]{bound}"
        _set_lines(self.torques, times, dict(zip(_NAMES, values, strict=True)), limit)
        self.error.title = f"error [{unit}] over time [s]"
        _set_lines(self.error, times, {"commanded - measured": values[1] - values[0]}, np.inf)
        return [self.torques, self.error]


def _set_lines(
    figure: mujoco.MjvFigure, times: Array, lines: dict[str, Array], limit: float
) -> None:
    low, high, steps = y_range(np.concatenate(list(lines.values())), limit)
    figure.range[1] = low, high
    figure.gridsize[1] = steps + 1
    places = -int(np.floor(np.log10((high - low) / steps * 1.001)))
    figure.yformat = "%.3g" if max(-low, high) >= _HUGE else f"%.{max(0, places)}f"
    figure.linepnt[:] = 0
    spare = iter(range(_LIMITS[-1] + 1, len(figure.linepnt)))  # for pieces after a gap
    for line, (name, values) in enumerate(lines.items()):
        pieces = split_at_gaps(times, values)
        figure.linename[line] = name if pieces else ""
        for piece, at in zip(reversed(pieces), itertools.chain([line], spare), strict=False):
            count = len(piece)
            figure.linepnt[at] = count
            figure.linergb[at] = figure.linergb[line]
            points = figure.linedata[at]
            points[0 : 2 * count : 2] = times[piece]
            points[1 : 2 * count : 2] = values[piece]
    for line, bound in zip(_LIMITS, (limit, -limit), strict=True):
        if np.isfinite(limit) and low <= bound <= high:
            figure.linepnt[line] = 2
            figure.linedata[line][:4] = -SPAN, bound, 0.0, bound
