"""History of the joints' commanded and measured torques, for the plots of live hosts."""

from __future__ import annotations

import mujoco
import numpy as np

from ..assemble.world_view import WorldView
from ..decor.quantities import joint_values
from ..decor.staleness import Staleness
from ..frames import Array, Ints

SPAN = 8.0  # duration of the plots, s
_GAP = 0.25  # minimum duration of a visible gap, s
_MOST = 1000  # samples; an MjvFigure has a capacity of 1001 points
_SHOWN = ("torques", "commanded_torques")


class TorqueHistory:
    """Ring buffer of all joints' torques, with a sample for every frame or every few ms.

    When time goes back, later samples are deleted.
    """

    def __init__(self, world: WorldView) -> None:
        self._world = world
        self._staleness = Staleness(world)
        self._times = np.full(_MOST, np.nan)
        self._values = np.full((len(_SHOWN), len(world.joints.names), _MOST), np.nan)
        self._count = 0  # samples in total; the newest is at (count - 1) % MOST

    def add(self, data: mujoco.MjData) -> None:
        """Adds a sample at `data.time`, if enough time has passed since the last one."""
        time = float(data.time)
        if self._count:
            last = self._times[(self._count - 1) % _MOST]
            if time < last - 1e-9:
                self._count = 0
            elif time - last < 0.9 * SPAN / _MOST:
                return
        values = joint_values(self._world, data)
        stale = self._staleness.find(data)
        at = self._count % _MOST
        self._times[at] = time
        for row, key in zip(self._values, _SHOWN, strict=True):
            row[:, at] = values[key]
        if stale:  # the line ends at the time of the last data, not when it became stale
            gap = self._staleness.time_without_data(data, stale)[:, None]
            self._values[:, (gap > 0) & (self._times > time - gap + 1e-6)] = np.nan
        self._count += 1

    def of(self, joint: int) -> tuple[Array, Array]:
        """Returns the samples of a joint, oldest first.

        Returns:
            times (k,), s, relative to the newest (0 and below), and values (2, k): measured and
            commanded, Nm or N, NaN for no data.
        """
        k = min(self._count, _MOST)
        order = np.arange(self._count - k, self._count) % _MOST
        times = self._times[order]
        if not k:
            return times, self._values[:, joint, order]
        times = times - times[-1]
        kept = times >= -SPAN
        return times[kept], self._values[:, joint, order[kept]]


def split_at_gaps(times: Array, values: Array) -> list[Ints]:
    """Splits the samples of a line at gaps in the data.

    Args:
        times: (k,), s, rising.
        values: (k,), NaN for no data; gaps shorter than `GAP` are ignored.

    Returns:
        indices of the samples of each piece; none is NaN.
    """
    there = np.isfinite(values).nonzero()[0]
    if not len(there):
        return []
    is_gap = (np.diff(there) > 1) & (np.diff(times[there]) > _GAP)
    return np.split(there, is_gap.nonzero()[0] + 1)


def joint_name(world: WorldView, joint: int) -> str:
    """Returns the name of a joint with its robot or double: `lwr/A4`."""
    owner = list(world.owners)[int(world.joints.owner[joint])]
    name = world.joints.names[joint]
    return name if name.startswith(f"{owner}/") else f"{owner}/{name}"
