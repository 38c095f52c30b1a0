"""Plots of a window: torques of a joint over time, drawn by MuJoCo, with text in our typeface."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ..session.torque_history import SPAN, TorqueHistory, joint_name, split_at_gaps
from ..typesetting import Rgb, Text
from .hud import BAR, DIM, TEXT, Hud, shortened

_PER_POINT = 3  # pixels; of flat lines of shorter pieces software OpenGL leaves out some
_POINTS = 980  # an MjvFigure has a capacity of 1001 per line
# Light blue and orange: distinct for the colour-blind and on a dark background.
_RGB = ((0.45, 0.78, 1.0), (1.0, 0.62, 0.18))
_ERROR_RGB = (0.75, 0.88, 0.45)
_LIMITS = (2, 3)  # indices of the limits among the lines of a figure
_LIMIT_RGB = (0.85, 0.30, 0.30)
_MARGIN = 0.05  # above and below the lines, of their range
# Distance of the grid's lines, in powers of ten, by how many of these are in the range at most.
_STEPS = {1: 0.2, 3: 0.5, 7: 1.0, 12: 2.0}
_HUGE = 1e5  # Nm or N, from which on numbers have an exponent
_LEAST_RANGE = 1.0  # Nm or N

_NOTHING = (0.0, 0.0, 0.0, 0.0)
_X_STEPS = 4  # of the grid
# Around the grid, line heights: title and names above it, times below it, numbers beside it.
_HEAD, _FOOT, _BESIDE = 3.0, 1.5, 0.5
_SWATCH = (0.8, 0.2)  # of a line's name: width and height, line heights


@dataclass(frozen=True, eq=False)
class Plot:
    """A plot.

    Attributes:
        figure: its lines and grid, without text.
        title: of the plot.
        names: names and colours of its lines.
        numbers: at the lines of the grid, from the lowest.
    """

    figure: mujoco.MjvFigure
    title: str
    names: list[tuple[str, Rgb]]
    numbers: list[str]

    def draw(self, hud: Hud, rect: mujoco.MjrRect, context: mujoco.MjrContext) -> None:
        """Draws it in a rectangle of the window."""
        h, margin = hud.font.height, context.charHeight // 2  # margin of MuJoCo's figures
        wide = max(hud.font.width(number) for number in self.numbers) + 2 * _BESIDE * h
        left, bottom = rect.left + round(wide), rect.bottom + round(_FOOT * h)
        width = rect.width - round(wide) - round(_BESIDE * h)
        height = rect.height - round((_FOOT + _HEAD) * h)
        hud.box(rect.left, rect.bottom, rect.width, rect.height, BAR)
        if width < 2 * h or height < h:
            return
        around = left - margin, bottom - margin, width + 2 * margin, height + 2 * margin
        mujoco.mjr_figure(mujoco.MjrRect(*around), self.figure, context)

        title = shortened(self.title, hud.font, rect.width - 2 * _BESIDE * h)
        texts = [Text(_BESIDE * h, 1.6 * h, title, TEXT, is_strong=True)]
        x = _BESIDE * h
        for name, rgb in self.names:
            middle = rect.bottom + rect.height - (_HEAD - 0.85) * h
            swatch_width, swatch_height = _SWATCH[0] * h, _SWATCH[1] * h
            hud.box(
                rect.left + x, middle - swatch_height / 2, swatch_width, swatch_height, (*rgb, 1.0)
            )
            x += swatch_width + 0.4 * h
            texts.append(Text(x, 0.35 * h, name, TEXT))
            x += hud.font.width(name) + 1.2 * h
        head = (rect.left, rect.bottom + rect.height - _HEAD * h, rect.width, _HEAD * h)
        hud.panel(head, texts, _NOTHING, is_round=False)

        step = height / (len(self.numbers) - 1)
        numbers = [
            Text(wide - _BESIDE * h - hud.font.width(number), k * step, number, DIM)
            for k, number in enumerate(self.numbers)
        ]
        hud.panel((rect.left, bottom - h / 2, wide, height + h), numbers, _NOTHING, is_round=False)
        times = [f"{-SPAN + k * SPAN / _X_STEPS:.0f}" for k in range(_X_STEPS + 1)]
        times[-1] += " s"
        middles = wide + width * np.arange(_X_STEPS + 1) / _X_STEPS
        places = middles - [hud.font.width(time) / 2 for time in times]
        places[-1] = min(places[-1], rect.width - hud.font.width(times[-1]) - 2)
        below = [Text(x, 0.3 * h, time, DIM) for x, time in zip(places, times, strict=True)]
        hud.panel((rect.left, rect.bottom, rect.width, _FOOT * h), below, _NOTHING, is_round=False)


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
    low, high = middle - (0.5 + _MARGIN) * span, middle + (0.5 + _MARGIN) * span
    for _ in range(2):  # repeated if rounding has made it longer than ten powers
        # `mjr_figure` always widens a range to whole powers of ten.
        unit = 10.0 ** np.floor(np.log10((high - low) * (1 + 1e-9)))
        whole = max(_step((high - low) / unit), 1.0) * unit
        low, high = float(np.floor(low / whole) * whole), float(np.ceil(high / whole) * whole)
    count = (high - low) / unit
    return low, high, round(count / _step(count))


def _step(count: float) -> float:
    """Returns the distance of the grid's lines for a range of so many powers of ten."""
    return next(step for most, step in _STEPS.items() if count <= most + 1e-6)


def make_figure(rgb: tuple[tuple[float, float, float], ...]) -> mujoco.MjvFigure:
    """Returns an empty figure whose first lines have these colours; limits are red."""
    figure = mujoco.MjvFigure()
    mujoco.mjv_defaultFigure(figure)
    figure.flg_legend = figure.flg_extend = 0
    figure.flg_ticklabel[:] = 0
    figure.gridsize[0] = _X_STEPS + 1
    figure.gridrgb[:] = 0.32, 0.36, 0.42
    figure.figurergba[:] = BAR
    figure.panergba[:] = 0.10, 0.12, 0.16, 1.0
    figure.linewidth, figure.gridwidth = 2.5, 1.0
    figure.range[0] = -SPAN, 0.0
    figure.linergb[: len(rgb)] = rgb
    figure.linergb[_LIMITS[0] : _LIMITS[1] + 1] = _LIMIT_RGB
    return figure


class TorquePlot:
    """Plots the history of one joint: torques, and their error."""

    def __init__(self, world: WorldView) -> None:
        self._world = world
        self._torques, self._error = make_figure(_RGB), make_figure((_ERROR_RGB,))

    def fill(
        self, history: TorqueHistory, joint: int, width: int = _PER_POINT * _POINTS
    ) -> list[Plot]:
        """Returns the plots of a joint of the world, for rectangles of a width in pixels."""
        joints = self._world.joints
        times, values = history.of(joint, min(width // _PER_POINT, _POINTS))
        limit = float(joints.torque_limit[joint])
        what, unit = ("torque", "Nm") if joints.revolute[joint] else ("force", "N")
        bound = f", limit {limit:g}" if np.isfinite(limit) else ""
        title = f"{joint_name(self._world, joint)}: {what} [{unit}]{bound}"
        numbers = _set_lines(self._torques, times, values[:2], limit)
        names = [*zip(("measured", "commanded"), _RGB, strict=True)]
        plot = Plot(self._torques, title, names, numbers)
        numbers = _set_lines(self._error, times, values[2:], np.inf)
        names = [("commanded - measured", _ERROR_RGB)]
        return [plot, Plot(self._error, f"error [{unit}]", names, numbers)]


def _set_lines(figure: mujoco.MjvFigure, times: Array, lines: Array, limit: float) -> list[str]:
    """Sets the lines of a figure and returns the numbers at its grid, from the lowest.

    Args:
        figure: to be changed.
        times: (k,), s.
        lines: values (n, k), Nm or N, NaN for no data.
        limit: of the torque, inf for none.
    """
    low, high, steps = y_range(lines.ravel(), limit)
    figure.range[1] = low, high
    figure.gridsize[1] = steps + 1
    figure.linepnt[:] = 0
    spare = iter(range(_LIMITS[-1] + 1, len(figure.linepnt)))  # for pieces after a gap
    for line, values in enumerate(lines):
        pieces = split_at_gaps(times, values)
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
    places = max(-int(np.floor(np.log10((high - low) / steps * 1.001))), 0)
    form = "{:.3g}" if max(-low, high) >= _HUGE else f"{{:.{places}f}}"
    return [form.format(value + 0.0) for value in np.linspace(low, high, steps + 1)]
