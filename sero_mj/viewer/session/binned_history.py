"""`BinnedHistory`: the minima and maxima of recent samples in bins of 2 ms."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...base.frames import Array

SPAN = 8.0  # duration of the plots, s
_BIN = 0.002  # width of a bin, s
SHOWN = round(SPAN / _BIN) + 1  # number of bins of a plot


class BinnedHistory:
    """History of a signal for plots. It stores extreme values in bins, so that no peak is lost.

    Args:
        shape: shape of a sample.
        span: duration of the history in seconds.
    """

    def __init__(self, shape: tuple[int, ...] = (), span: float = SPAN) -> None:
        self._count = count = round(span / _BIN) + 1  # number of bins
        self._times = np.full(count, np.nan)  # time of the last sample in each bin
        self._low = np.full((count, *shape), np.nan, np.float32)
        self._high = np.full((count, *shape), np.nan, np.float32)
        self._last: int | None = None  # number of the newest bin; bin i is in row i % count
        self.newest = 0.0

    def restart(self) -> None:
        self._last = None

    def add(self, times: Array, values: Array) -> None:
        """Adds samples, shape (n, ...), at times in seconds, shape (n,). NaN means no data."""
        bins = np.floor(times / _BIN + 1e-6).astype(np.intp)
        newest = int(bins[-1])
        if self._last is None:
            self.newest = -np.inf
            self._times[:] = np.nan
            self._low[:] = self._high[:] = np.nan
        elif newest > self._last:
            new = np.arange(max(self._last, newest - self._count) + 1, newest + 1) % self._count
            self._times[new] = np.nan
            self._low[new] = self._high[new] = np.nan
        self._last = newest if self._last is None else max(newest, self._last)
        self.newest = max(float(times[-1]), self.newest)
        is_new = bins > self._last - self._count
        if not is_new.any():
            return
        bins, times, values = bins[is_new], times[is_new], values[is_new]
        bins, begins = np.unique(bins, return_index=True)
        ends = np.append(begins[1:], len(times)) - 1
        rows = bins % self._count
        self._times[rows] = np.fmax(self._times[rows], times[ends])
        with np.errstate(over="ignore"):  # Implausible values may exceed float32.
            self._low[rows] = np.fmin(self._low[rows], np.fmin.reduceat(values, begins, axis=0))
            self._high[rows] = np.fmax(self._high[rows], np.fmax.reduceat(values, begins, axis=0))

    def forget(self, since: Array) -> None:
        """Deletes samples after `since`, which has a time in s for each element of a sample."""
        with np.errstate(invalid="ignore"):
            past = self._times.reshape(-1, *(1,) * np.ndim(since)) > since
        for extremes in (self._low, self._high):
            np.copyto(extremes, np.nan, where=past)

    def until(
        self, time: float | None, points: int = 2 * SHOWN, at: tuple[Any, ...] = ()
    ) -> tuple[Array, Array]:
        """Returns the samples of a plot, which covers `SPAN` seconds, oldest first.

        Args:
            time: last time of the plot in seconds; None for the time of the newest sample.
            points: approximate maximum number of returned samples, at least 2. Each of them is the
                minimum or maximum of an interval.
            at: index that selects a scalar or a vector of each sample.

        Returns:
            times in seconds, shape (k,), and values, shape (m, k); NaN for no data.
        """
        nothing = np.zeros(0), np.zeros((self._low[(0, *at)].size, 0))
        if self._last is None:
            return nothing
        last = self._last
        if time is not None:
            last = min(last, int(np.floor(time / _BIN + 1e-6)))
        bins = np.arange(max(last - SHOWN, self._last - self._count) + 1, last + 1)
        bins = bins[np.isfinite(self._times[bins % self._count])]
        if not len(bins):
            return nothing
        rows = bins % self._count
        times = self._times[rows]
        low = self._low[(rows, *at)].reshape(len(rows), -1)
        high = self._high[(rows, *at)].reshape(len(rows), -1)
        points = max(points, 2)
        if 2 * len(bins) > points:
            # Intervals start at multiples of their length, so that lines do not flicker.
            intervals = bins // -(-2 * (int(bins[-1] - bins[0]) + 1) // points)
            begins = np.flatnonzero(np.diff(intervals, prepend=intervals[0] - 1))
            low = np.fmin.reduceat(low, begins, axis=0)
            high = np.fmax.reduceat(high, begins, axis=0)
            times = times[np.append(begins[1:], len(times)) - 1]
        both = np.arange(len(times)).repeat(1 + (low < high).any(axis=1))
        is_high = np.diff(both, prepend=-1) == 0
        return times[both], np.where(is_high[:, None], high[both], low[both]).T
