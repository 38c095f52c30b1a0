"""`SignalPlots`: plots of signals that the user selects."""

from __future__ import annotations

import time
from collections.abc import Collection

import numpy as np

from ..session.signals import PlotSignal, PlotSignals
from ..session.widgets import Plot, PlotLine, Rgb, Widgets
from .torque_plots import time_plot, with_gaps

# Colors that are distinct for the color-blind on a dark background (after Okabe and Ito).
_COLORS: tuple[Rgb, ...] = (
    *((0.45, 0.78, 1.0), (1.0, 0.62, 0.18), (0.75, 0.88, 0.45), (0.80, 0.60, 0.70)),
    *((0.94, 0.89, 0.26), (0.00, 0.62, 0.45), (0.84, 0.37, 0.00), (0.90, 0.90, 0.90)),
)
MAX_PLOTS, MAX_LINES = 8, len(_COLORS)
_MIN_RANGE = 1e-9  # minimum half range of the y axis
_NEW = "new plot"
_HINT = "add or remove a signal"
_SHOWN = " (shown)"
# Lengths in units of the text height.
_TARGET, _GROUP = 7.0, 7.0  # widths of drop-down lists
_MIN_HEIGHT = 8.0  # minimum height of a plot; if there is not enough space, the area scrolls


class SignalPlots:
    """Plots of signals over time, with drop-down lists that add and remove signals."""

    def __init__(self, signals: PlotSignals) -> None:
        self._signals = signals
        self.shown: list[list[PlotSignal]] = []
        self._target, self._group = 0, 0  # plot and group that are selected in the lists
        self._plots: list[Plot] = []
        self._built: list[list[PlotSignal]] = []  # signals of `_plots`
        self._when = float("-inf")

    @property
    def wanted(self) -> Collection[PlotSignal]:
        return {signal for plot in self.shown for signal in plot}

    def add(self, signal: PlotSignal) -> None:
        if signal not in self.wanted and len(self.shown) < MAX_PLOTS:
            self.shown.append([signal])

    def toggle(self, plot: int, signal: PlotSignal) -> str:
        """Adds a signal to a plot, or removes it if the plot already shows it.

        If there is no plot with the index `plot`, the signal is added to a new plot.

        Returns:
            reason why the signal cannot be added, or an empty string.
        """
        if plot >= len(self.shown):
            if len(self.shown) == MAX_PLOTS:
                return f"at most {MAX_PLOTS} plots can be shown"
            self.shown.append([signal])
            return ""
        lines = self.shown[plot]
        if signal in lines:
            lines.remove(signal)
            self.shown = [lines for lines in self.shown if lines]
            return ""
        if len(lines) == MAX_LINES:
            return f"a plot can show at most {MAX_LINES} signals"
        lines.append(signal)
        return ""

    def build_choice(self, ui: Widgets) -> str:
        """Builds the lists of plots, groups and signals, and returns an error message or ""."""
        groups = self._signals.groups
        if not groups:
            return ""
        targets = [f"plot {k + 1}" for k in range(len(self.shown))] + [_NEW]
        ui.width(_TARGET)
        _, self._target = ui.choose("##plot", min(self._target, len(targets) - 1), targets)
        ui.same_line()
        ui.width(_GROUP)
        _, self._group = ui.choose("##group", min(self._group, len(groups) - 1), [*groups])
        group = [*groups][self._group]
        lines = self.shown[self._target] if self._target < len(self.shown) else []
        names = groups[group]
        labels = [_HINT, *(name + _SHOWN * (PlotSignal(group, name) in lines) for name in names)]
        ui.same_line()
        ui.width(0)
        changed, chosen = ui.choose("##signal", 0, labels)
        if not changed or chosen == 0:
            return ""
        return self.toggle(self._target, PlotSignal(group, names[chosen - 1]))

    def build(self, ui: Widgets, now: float) -> None:
        """Builds all plots up to the time `now` in seconds. They share the remaining height."""
        if not self.shown:
            return
        passed = time.monotonic() - self._when
        if passed >= ui.interval or self._built != self.shown:
            self._when = time.monotonic()
            self._built = [[*lines] for lines in self.shown]
            self._plots = [self._plot(lines, now, ui.points) for lines in self.shown]
        height = max(ui.room()[1] / len(self._plots), _MIN_HEIGHT)
        for index, plot in enumerate(self._plots):
            ui.scope(f"plot {index}")
            ui.plot(plot, height)
            ui.end_scope()

    def _plot(self, shown: list[PlotSignal], now: float, points: int) -> Plot:
        lines, names = [], [signal.name for signal in shown]
        for signal, color in zip(shown, _COLORS, strict=False):
            times, values = with_gaps(*self._signals.of(signal, now, points))
            is_one = names.count(signal.name) == 1
            name = signal.name if is_one else f"{signal.group} {signal.name}"
            lines.append(PlotLine(name, color, times, values))
        return time_plot(f"plot {self.shown.index(shown) + 1}", lines, np.inf, _MIN_RANGE)
