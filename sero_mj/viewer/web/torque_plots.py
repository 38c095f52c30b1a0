"""Plots of the page: commanded, measured and error torques of a joint."""

from __future__ import annotations

import math
import time

import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.implot import implot

from ...base.frames import Array
from ...base.reduction import envelope
from ...robots.assemble.world_view import WorldView
from ..session.torque_history import SPAN, TorqueHistory, joint_name, split_at_gaps

# Limits of update rate and points: plots would be most of the data sent to the browser.
_INTERVAL = 1.0 / 15.0  # s
_POINTS = 320
# The colours of lines cannot be set in Studio's ImPlot; its defaults start with blue and orange.
_LIMIT_RGB = (0.80, 0.20, 0.10)
_NEAR = 0.6  # fraction of the limit from which on it is in the visible range
_LEGEND = int(implot.LegendFlags.Outside) | int(implot.LegendFlags.Horizontal)
_ROOM_FOR_TWO = 240.0  # pixels, minimum height with a plot of the error
_LEAST = 0.5  # Nm or N, minimum half range of a plot


def decimate(times: Array, values: Array, points: int = _POINTS) -> tuple[Array, Array]:
    """Reduces the samples of a line to about `points`, keeping its extremes and gaps.

    Args:
        times: (k,), s, rising.
        values: (k,), NaN for no data.
        points: approximate number of samples to keep.

    Returns:
        times and values, with one NaN in every gap.
    """
    size = max(int(np.ceil(2 * np.isfinite(values).sum() / points)), 1)
    kept: list[tuple[Array, Array]] = []
    for piece in split_at_gaps(times, values):
        if kept:
            kept.append((times[piece[:1]], np.array([np.nan])))
        kept.append(envelope(times[piece], values[piece], -(-len(piece) // size)))
    if not kept:
        return times[:0], values[:0]
    return np.concatenate([x for x, _ in kept]), np.concatenate([y for _, y in kept])


class TorquePlots:
    """Plots commanded, measured and error torques of a joint of a world, with limits.

    Args:
        world: the compiled scene.
    """

    def __init__(self, world: WorldView) -> None:
        self._world = world
        self._names = [joint_name(world, i) for i in range(len(world.joints.names))]
        self._lines: dict[str, tuple[list[float], list[float]]] = {}
        self._when = float("-inf")
        self._joint = -1

    def build(self, history: TorqueHistory, joint: int) -> int:
        """Builds the plots of a joint and returns the joint that the user has selected.

        Args:
            history: the torques.
            joint: index in the world.
        """
        imgui.SetNextItemWidth(160.0)
        changed, chosen = imgui.Combo("##joint", joint, self._names)
        joint = chosen if changed else joint
        self._refresh(history, joint)
        joints = self._world.joints
        unit = "Nm" if joints.revolute[joint] else "N"
        limit = float(joints.torque_limit[joint])
        imgui.SameLine()
        imgui.TextUnformatted(f"limit {limit:g} {unit}" if np.isfinite(limit) else "no limit")
        room = imgui.GetContentRegionAvail()
        upper = room.y if room.y < _ROOM_FOR_TWO else 0.58 * room.y - 4.0
        self._plot(f"torque [{unit}]", ("measured", "commanded"), limit, upper)
        if upper < room.y:
            self._plot(f"error [{unit}]", ("commanded - measured",), np.inf, room.y - upper - 8.0)
        return joint

    def _refresh(self, history: TorqueHistory, joint: int) -> None:
        now = time.monotonic()
        if joint == self._joint and now - self._when < _INTERVAL:
            return
        self._joint, self._when = joint, now
        times, values = history.of(joint)
        lines = dict(zip(("measured", "commanded", "commanded - measured"), values, strict=True))
        self._lines = {}
        for name, values in lines.items():
            x, y = decimate(times, values)
            self._lines[name] = (x.tolist(), y.tolist())

    def _plot(self, title: str, names: tuple[str, ...], limit: float, height: float) -> None:
        if not implot.BeginPlot(f"##{title}", imgui.Vec2(-1.0, max(height, 50.0))):
            return
        implot.SetupAxes("s", title)
        implot.SetupLegend(int(implot.Location.North), _LEGEND)
        implot.SetupAxisLimits(int(implot.Axis.X1), -SPAN, 0.0, int(implot.Cond.Always))
        low, high = self._range(names, limit)
        implot.SetupAxisLimits(int(implot.Axis.Y1), low, high, int(implot.Cond.Always))
        for name in names:
            x, y = self._lines[name]
            implot.PlotLine(name, x, y)
        for number, bound in enumerate((limit, -limit)):
            if low <= bound <= high:
                flags = int(implot.DragToolFlags.NoInputs) | int(implot.DragToolFlags.NoFit)
                implot.DragLineY(number, bound, imgui.Vec4(*_LIMIT_RGB, 1.0), 1.5, flags)
                implot.TagY(bound, imgui.Vec4(*_LIMIT_RGB, 1.0), "limit")
        implot.EndPlot()

    def _range(self, names: tuple[str, ...], limit: float) -> tuple[float, float]:
        """Returns the range of the axis, rounded so that it rarely changes."""
        values = [v for name in names for v in self._lines[name][1] if math.isfinite(v)]
        low, high = (min(values), max(values)) if values else (0.0, 0.0)
        if np.isfinite(limit):
            high = limit if high > _NEAR * limit else high
            low = -limit if low < -_NEAR * limit else low
        middle, half = (low + high) / 2, max((high - low) / 2 * 1.15, _LEAST)
        step = 10.0 ** np.floor(np.log10(half)) / 2
        return (
            float(np.floor((middle - half) / step) * step),
            float(np.ceil((middle + half) / step) * step),
        )
