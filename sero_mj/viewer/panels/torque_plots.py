"""`TorquePlots`: plots of the measured torque, commanded torque and torque error of a joint."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ..decor.quantities import joint_name, torque_and_unit, torque_text
from ..session.binned_history import SPAN
from ..session.torque_history import TorqueHistory, split_at_gaps
from ..session.widgets import Plot, PlotLine, Rgb, Widgets

# Light blue and orange are distinct for the color-blind and on a dark background.
_MEASURED: Rgb = (0.45, 0.78, 1.0)
_COMMANDED: Rgb = (1.0, 0.62, 0.18)
_ERROR: Rgb = (0.75, 0.88, 0.45)
_MIN_RANGE = 0.5  # minimum half range of the y axis, in the unit of the joint
# Lengths in units of the text height.
_NAMES, _BESIDE = 11.0, 8.0  # widths of the list of joints, and of the text beside the list
_ROOM_FOR_TWO = 20.0  # minimum height at which the error is plotted, too
_SHARE = 0.56  # height of the torque plot, fraction of the total height
_MIN_HEIGHT = 4.0  # minimum height of a plot
_NOTE = 2.2  # height of the text that replaces the error plot


class TorquePlots:
    """Plots of the torques of one joint over time, with its limits."""

    def __init__(self, world: WorldView, points: int, interval: float = 0.0) -> None:
        self._world, self._points, self._interval = world, points, interval
        self._names = [joint_name(world, i) for i in range(len(world.joints.names))]
        self._plots: list[Plot] = []
        self._when = float("-inf")
        self._joint = -1

    def build(self, ui: Widgets, history: TorqueHistory, joint: int, height: float = np.inf) -> int:
        """Builds the plots of a joint, and returns the index of the joint that the user selects.

        Args:
            height: maximum height of the plots, in text heights.
        """
        ui.width(max(min(_NAMES, ui.room()[0] - _BESIDE), 1.0))
        changed, chosen = ui.choose("##joint", joint, self._names)
        joint = chosen if changed else joint
        now = time.monotonic()
        if joint != self._joint or now - self._when >= self._interval:
            self._joint, self._when = joint, now
            self._plots = self.plots(history, joint)
        limit = float(self._world.joints.torque_limit[joint])
        what, (factor, unit) = torque_and_unit(self._world, joint)
        ui.same_line()
        text = f"limit {factor * limit:g} {unit}" if np.isfinite(limit) else "no limit"
        if self._world.joints.is_largest[joint]:
            text = f"largest so far {torque_text(self._world, joint, limit)}"
        ui.label(text)
        torques, error = self._plots
        room = min(ui.room()[1], height)
        is_for_two = room >= _ROOM_FOR_TWO
        note = _without(what, torques) if is_for_two else ""
        if room >= _MIN_HEIGHT:
            share = room - _NOTE if note else _SHARE * room
            ui.plot(torques, share if is_for_two else room)
        if note:
            ui.text(note, "quiet")
        elif is_for_two:
            ui.plot(error, ui.room()[1] if height >= ui.room()[1] else (1 - _SHARE) * room)
        return joint

    def plots(self, history: TorqueHistory, joint: int) -> list[Plot]:
        times, (measured, commanded, error) = history.of(joint, self._points)
        joints = self._world.joints
        limit = np.inf if joints.is_largest[joint] else float(joints.torque_limit[joint])
        what, (factor, unit) = torque_and_unit(self._world, joint)
        torques = [
            PlotLine("measured", _MEASURED, *with_gaps(times, factor * measured)),
            PlotLine("commanded", _COMMANDED, *with_gaps(times, factor * commanded)),
        ]
        errors = [PlotLine("commanded - measured", _ERROR, *with_gaps(times, factor * error))]
        return [
            time_plot(f"{what} [{unit}]", torques, factor * limit, _MIN_RANGE),
            time_plot(f"error [{unit}]", errors, np.inf, _MIN_RANGE),
        ]


def _without(what: str, torques: Plot) -> str:
    missing = [line.name for line in torques.lines if not len(line.x)]
    if not missing:
        return ""
    which = f"{missing[0]} " if len(missing) < len(torques.lines) else ""
    return f"no {which}{what}s are received, so no error can be plotted"


_NEAR = 0.8  # fraction of the limit beyond which values bring the limit into view
_MARGIN = 1.15  # visible range, relative to the range of the values
_MIN_RATIO = 1e-3  # minimum half range, relative to the magnitude of the center


def time_plot(label: str, lines: Sequence[PlotLine], limit: float, least: float) -> Plot:
    """Returns a plot of lines over the last seconds.

    Args:
        limit: magnitude of the limit that the plot marks; inf for no limit.
        least: minimum half range of the y axis.
    """
    values = np.concatenate([line.y for line in lines]) if lines else np.zeros(0)
    return Plot("s", label, lines, (-SPAN, 0.0), y_range(values, limit, least), (limit, -limit))


def with_gaps(times: Array, values: Array) -> tuple[Array, Array]:
    """Returns the times and values of a line with one NaN in each gap of the samples."""
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
    """Returns the lower and upper end of the y axis, rounded so that the axis rarely changes.

    Args:
        limit: magnitude of the limit; inf for no limit. The range includes the limit if values are
            close to it.
        least: minimum half range.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    if np.isfinite(limit):
        high = max(high, limit) if high > _NEAR * limit else high
        low = min(low, -limit) if low < -_NEAR * limit else low
    middle = (low + high) / 2
    half = max((high - low) / 2 * _MARGIN, least, _MIN_RATIO * abs(middle))
    step = 10.0 ** np.floor(np.log10(half)) / 2
    return (
        float(np.floor((middle - half) / step) * step),
        float(np.ceil((middle + half) / step) * step),
    )
