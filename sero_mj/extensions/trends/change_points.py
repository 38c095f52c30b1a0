"""Fits a series by segments that are constant or linear in time, and finds the change points.

The fit minimizes the weighted sum of squared residuals plus a penalty for each change point and for
each slope, over all segmentations (Jackson et al., An algorithm for optimal partitioning of data on
an interval, IEEE Signal Processing Letters 12(2), 2005; PELT of Killick et al., 2012, finds the
same minimum). The penalty is the squared Student t whose probability in a series without changes,
summed over all possible positions (Bonferroni), is `chance`.

The standard errors describe one recording. If the values scatter more from recording to recording,
the errors are multiplied by the Birge ratio, which is estimated from successive differences (von
Neumann et al., 1941) without a drift, because steps hardly change it. The largest differences are
left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, exp, log, sqrt
from statistics import NormalDist

import numpy as np

from ...base.frames import Array

_KEPT = 0.8  # share of the successive differences that determine the Birge ratio
_MIN_DIFFERENCES = 6  # minimum number of differences for estimating it
# Minimum scatter between recordings as a share of the value: if it is estimated, and otherwise.
_REPEATABILITY, _UNKNOWN_REPEATABILITY = 0.01, 0.05
_MIN_FREEDOM = 5.0
_MIN_SLOPED = 4  # minimum number of values on a slope
_NORMAL = NormalDist()


@dataclass(frozen=True)
class Segment:
    """Values between two change points.

    Attributes:
        begin: index of the first value.
        end: index after the last value.
        center: weighted mean time, s.
        mean: weighted mean value.
        error: standard error of the mean.
        slope: change per second; 0 if the segment is constant.
        slope_error: standard error of the slope.
    """

    begin: int
    end: int
    center: float
    mean: float
    error: float
    slope: float = 0.0
    slope_error: float = 0.0

    def at(self, time: float) -> float:
        """Returns the fitted value at a time in seconds."""
        return self.mean + self.slope * (time - self.center)

    def error_at(self, time: float) -> float:
        """Returns the standard error of the fitted value at a time in seconds."""
        return float(np.hypot(self.error, self.slope_error * (time - self.center)))


def fit_segments(times: Array, values: Array, errors: Array, chance: float) -> list[Segment]:
    """Returns the segments of a series in the order of time.

    Args:
        times: increasing times, shape (n,), s.
        values: finite values, shape (n,).
        errors: standard errors, shape (n,); NaN if unknown.
        chance: probability of a change point or slope in a series without changes.
    """
    errors = scatter(times, values, errors)
    count, weights = len(values), errors**-2.0
    penalty = _penalty(chance, count)
    # Without offsets and scales, so that the sums below lose no digits.
    span = float(np.ptp(times)) or 1.0
    t, y = (times - times.mean()) / span, values - np.median(values)
    sums = np.cumsum([weights * each for each in (t**0, t, t * t, y, t * y, y * y)], axis=1)
    sums = np.concatenate([np.zeros((6, 1)), sums], axis=1)
    cost, previous = np.full(count + 1, -penalty), np.zeros(count + 1, int)
    for end in range(1, count + 1):
        w, wt, wtt, wy, wty, wyy = sums[:, end : end + 1] - sums[:, :end]
        constant = wyy - wy**2 / w
        variance, covariance = wtt - wt**2 / w, wty - wt * wy / w
        explained = covariance**2 / np.maximum(variance, 1e-12 * w)
        is_sloped = end - np.arange(end) >= _MIN_SLOPED
        of_segment = constant - np.where(is_sloped, np.maximum(explained - penalty, 0.0), 0.0)
        total = cost[:end] + of_segment + penalty
        previous[end] = int(total.argmin())
        cost[end] = total[previous[end]]
    ends = [count]
    while previous[ends[-1]] > 0:
        ends.append(int(previous[ends[-1]]))
    begins = [*ends[1:], 0]
    return [
        _segment(begin, end, times, values, weights, penalty)
        for begin, end in zip(reversed(begins), reversed(ends), strict=True)
    ]


def scatter(times: Array, values: Array, errors: Array) -> Array:
    """Returns the standard errors including the scatter between recordings, (n,)."""
    is_estimated = len(values) > _MIN_DIFFERENCES
    share = _REPEATABILITY if is_estimated else _UNKNOWN_REPEATABILITY
    least = max(share * float(np.median(np.abs(values))), 1e-12)
    errors = np.hypot(np.nan_to_num(errors), least)
    if not is_estimated:
        return np.asarray(errors)
    differences, intervals = np.diff(values), np.diff(times)
    drift = np.median(differences / np.maximum(intervals, 1e-9)) * intervals
    squares = (differences - drift) ** 2 / (errors[1:] ** 2 + errors[:-1] ** 2)
    kept = ceil(_KEPT * len(squares))
    # Mean square of a standard normal variable without its largest values.
    share = kept / (len(squares) + 1)
    bound = _NORMAL.inv_cdf(0.5 + 0.5 * share)
    expected = 1.0 - 2.0 * bound * _NORMAL.pdf(bound) / share
    ratio = np.sort(squares)[:kept].mean() / expected
    return np.asarray(errors * sqrt(max(ratio, 1.0)))


def _penalty(chance: float, count: int) -> float:
    # Squared Student t of a two-sided probability, by the inverse of Wallace's approximation
    # (Annals of Mathematical Statistics 30, 1959). Not all differences are independent.
    freedom = max(0.75 * (count - 1), _MIN_FREEDOM)
    normal = -_NORMAL.inv_cdf(0.5 * chance / max(2 * (count - 1), 1))
    factor = (8.0 * freedom + 3.0) / (8.0 * freedom + 1.0)
    return float(freedom * (exp(min((normal * factor) ** 2 / freedom, log(1e6))) - 1.0))


def _segment(
    begin: int, end: int, times: Array, values: Array, weights: Array, penalty: float
) -> Segment:
    t, y, w = times[begin:end], values[begin:end], weights[begin:end]
    center, mean = float(np.average(t, weights=w)), float(np.average(y, weights=w))
    error = float(w.sum() ** -0.5)
    variance = float(w @ (t - center) ** 2)
    if end - begin >= _MIN_SLOPED and variance > 0.0:
        slope = float(w @ ((t - center) * (y - mean))) / variance
        if slope**2 * variance > penalty:
            return Segment(begin, end, center, mean, error, slope, variance**-0.5)
    return Segment(begin, end, center, mean, error)
