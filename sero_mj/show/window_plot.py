"""Commanded against measured torque of the selected joint, live."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.world import World
from ..decor.quantities import joint_values

Array = NDArray[np.float64]

SPAN = 8.0  # s that are shown
_MOST = 1000  # points of a line; an MjvFigure has room for 1001
_SHOWN = ("torques", "commanded_torques")
_NAMES = ("measured", "commanded")
# Colour-blind safe against each other and on a dark ground: light blue and orange.
_RGB = ((0.45, 0.78, 1.0), (1.0, 0.62, 0.18))
_LIMIT_RGB = (0.85, 0.30, 0.30)
_HEADROOM = 1.15  # of the range over what is in it
_LEAST_RANGE = 1.0  # Nm or N


class TorqueHistory:
    """The last seconds of all joints' torques, one sample a frame.

    Going back in time forgets what came later.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._times = np.full(_MOST, np.nan)
        self._values = np.full((len(_SHOWN), len(world.joints.names), _MOST), np.nan)
        self._count = 0  # samples ever taken; the newest is at (count - 1) % MOST

    def clear(self) -> None:
        """Forgets all."""
        self._count = 0

    def add(self, data: mujoco.MjData) -> None:
        """Takes a sample at `data.time`, if that has moved on by enough to be seen."""
        time = float(data.time)
        if self._count:
            last = self._times[(self._count - 1) % _MOST]
            if time < last - 1e-9:
                self.clear()
            elif time - last < SPAN / _MOST:
                return
        values = joint_values(self._world, data)
        at = self._count % _MOST
        self._times[at] = time
        for row, key in zip(self._values, _SHOWN, strict=True):
            row[:, at] = values[key]
        self._count += 1

    def of(self, joint: int) -> tuple[Array, Array]:
        """The samples of a joint, oldest first.

        Returns:
            times (k,), s before the newest (0 and below), and values (2, k): measured and
            commanded, Nm or N, NaN where there is no data.
        """
        k = min(self._count, _MOST)
        order = np.arange(self._count - k, self._count) % _MOST
        times = self._times[order]
        if not k:
            return times, self._values[:, joint, order]
        times = times - times[-1]
        kept = times >= -SPAN
        return times[kept], self._values[:, joint, order[kept]]


def y_range(values: Array, limit: float) -> tuple[float, float]:
    """Lower and upper end of the plot, Nm or N.

    Args:
        values: all that is shown, NaN where there is nothing.
        limit: of the torque, inf for none; it is in the picture when torques come near it.
    """
    finite = values[np.isfinite(values)]
    if not len(finite):
        return -_LEAST_RANGE, _LEAST_RANGE
    low, high = float(finite.min()), float(finite.max())
    if np.isfinite(limit) and max(abs(low), abs(high)) > 0.8 * limit:
        high, low = (max(high, limit), low) if high > -low else (high, min(low, -limit))
    middle, half = (low + high) / 2, max((high - low) / 2, _LEAST_RANGE)
    return middle - _HEADROOM * half, middle + _HEADROOM * half


def joint_name(world: World, joint: int) -> str:
    """A joint with its robot or double: `lwr/A4`."""
    owner = list(world.owners)[int(world.joints.owner[joint])]
    name = world.joints.names[joint]
    return name if name.startswith(f"{owner}/") else f"{owner}/{name}"


class TorquePlot:
    """Fills an `MjvFigure` with the history of one joint."""

    def __init__(self, world: World) -> None:
        self._world = world
        figure = self.figure = mujoco.MjvFigure()
        mujoco.mjv_defaultFigure(figure)
        figure.flg_legend = 1
        figure.flg_ticklabel[:] = 1
        figure.flg_extend = 0
        figure.gridsize[:] = 5, 5
        figure.gridrgb[:] = 0.32, 0.36, 0.42
        figure.figurergba[:] = 0.07, 0.09, 0.12, 0.82
        figure.panergba[:] = 0.10, 0.12, 0.16, 0.75
        figure.legendrgba[:] = 0.07, 0.09, 0.12, 0.6
        figure.textrgb[:] = 0.88, 0.90, 0.93
        figure.linewidth, figure.gridwidth = 2.5, 1.0
        figure.xformat, figure.yformat = "%.0f", "%.0f"
        figure.range[0] = -SPAN, 0.0
        figure.linergb[: len(_RGB)] = _RGB
        figure.linergb[2] = _LIMIT_RGB
        figure.linergb[3] = _LIMIT_RGB

    def fill(self, history: TorqueHistory, joint: int) -> mujoco.MjvFigure:
        """Returns the figure of a joint of the world."""
        figure, joints = self.figure, self._world.joints
        times, values = history.of(joint)
        limit = float(joints.torque_limit[joint])
        low, high = y_range(values, limit)
        unit = "Nm" if joints.revolute[joint] else "N"
        figure.title = f"{joint_name(self._world, joint)}: {'torque' if unit == 'Nm' else 'force'}"
        figure.xlabel = f"{unit} over s"
        figure.range[1] = low, high
        figure.yformat = "%.1f" if high - low < 8 else "%.0f"
        for line, row in enumerate(values):
            there = np.isfinite(row)
            count = int(there.sum())
            figure.linepnt[line] = count
            figure.linename[line] = _NAMES[line] if count else ""
            points = figure.linedata[line]
            points[0 : 2 * count : 2] = times[there]
            points[1 : 2 * count : 2] = row[there]
        for line, bound in ((2, limit), (3, -limit)):
            inside = np.isfinite(limit) and low <= bound <= high
            figure.linepnt[line] = 2 if inside else 0
            if inside:
                figure.linedata[line][:4] = -SPAN, bound, 0.0, bound
        return figure
