"""Change points of series, by exhaustive search, SciPy and simulated series."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy import stats

from sero_mj.base.frames import Array
from sero_mj.extensions.trends.change_points import Segment, _penalty, fit_segments, scatter

DAY = 86400.0


def cost_of(cuts: tuple[int, ...], times: Array, values: Array, errors: Array) -> float:
    """Returns the penalized sum of squares, with NumPy's regression for each segment."""
    penalty = _penalty(0.05, len(values))
    total = penalty * len(cuts)
    for begin, end in zip((0, *cuts), (*cuts, len(values)), strict=True):
        t, y, weights = times[begin:end], values[begin:end], 1.0 / errors[begin:end]
        costs = [((y - np.average(y, weights=weights**2)) * weights) @
                 ((y - np.average(y, weights=weights**2)) * weights)]  # fmt: skip
        if end - begin >= 4:
            left = (y - np.polyval(np.polyfit(t, y, 1, w=weights), t)) * weights
            costs.append(left @ left + penalty)
        total += min(costs)
    return total


@pytest.mark.parametrize("seed", range(6))
def test_fit_is_the_best_of_all_segmentations(seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 2.0, 9))
    values = rng.normal(0.0, 1.0, 9) + 60.0 * (np.arange(9) >= 4) * (seed % 3 > 0)
    values += 25.0 * times * (seed % 2)
    errors = rng.uniform(0.5, 2.0, 9)
    found = fit_segments(1.7e9 + DAY * times, values, errors, 0.05)
    used = scatter(1.7e9 + DAY * times, values, errors)
    best = min(
        (cuts for count in range(5) for cuts in combinations(range(1, 9), count)),
        key=lambda cuts: cost_of(cuts, times, values, used),
    )
    assert tuple(each.begin for each in found[1:]) == best
    for each in found:
        if each.slope:
            part = slice(each.begin, each.end)
            line, covariance = np.polyfit(
                times[part], values[part], 1, w=1.0 / used[part], cov="unscaled"
            )
            assert DAY * each.slope == pytest.approx(line[0])
            assert DAY * each.slope_error == pytest.approx(np.sqrt(covariance[0, 0]))
            assert each.at(1.7e9) == pytest.approx(line[1], abs=1e-3)


@pytest.mark.parametrize("kind", ["last", "half", "drift", "outlier"])
def test_change_of_half_is_found_at_its_night(kind: str) -> None:
    nights = np.arange(12)
    change = {
        "last": 0.33 * (nights == 11),
        "half": 0.33 * (nights >= 6),
        "drift": 0.33 * nights / 11.0,
        "outlier": 0.33 * (nights == 5),
    }[kind]
    expected = {"last": [0, 11], "half": [0, 6], "drift": [0], "outlier": [0, 5, 6]}
    rng = np.random.default_rng(4)
    values = 0.61 + 0.01 * rng.standard_normal(12) + change
    found = fit_segments(DAY * nights, values, np.full(12, 0.008), 0.05 / 40)
    assert [each.begin for each in found] == expected[kind]
    if kind == "drift":
        assert DAY * found[0].slope == pytest.approx(0.03, abs=3.0 * DAY * found[0].slope_error)
    if kind == "half":
        assert found[0].mean == pytest.approx(0.61, abs=3.0 * found[0].error)
        assert found[1].mean == pytest.approx(0.94, abs=3.0 * found[1].error)
        assert found[0].error == pytest.approx(np.std(values[:6]) / np.sqrt(6), rel=1.0)


def is_changed(segments: list[Segment]) -> bool:
    return len(segments) > 1 or bool(segments[0].slope)


# Share of the scatter that the standard errors declare.
@pytest.mark.parametrize("declared", [1.0, 0.3, np.nan])
@pytest.mark.parametrize(
    "count", [30, *(pytest.param(n, marks=pytest.mark.thorough) for n in (2, 4, 7, 12, 60))]
)
def test_stationary_series_rarely_have_changes(declared: float, count: int) -> None:
    rng = np.random.default_rng(count)
    times = DAY * np.arange(count)
    false = [
        is_changed(fit_segments(times, 1.0 + 0.05 * rng.standard_normal(count),
                                np.full(count, 0.05 * declared), 0.05))
        for _ in range(600)
    ]  # fmt: skip
    assert np.mean(false) <= 0.05


@pytest.mark.parametrize("seed", range(4))
def test_drift_that_begins_late_is_found_with_its_start(seed: int) -> None:
    nights = np.arange(30)
    values = 0.61 + 0.01 * np.random.default_rng(seed).standard_normal(30)
    values += 0.02 * np.maximum(nights - 15, 0)
    before, after = fit_segments(DAY * nights, values, np.full(30, 0.01), 0.05 / 40)
    assert before.slope == 0.0 and after.begin in range(14, 20)
    assert DAY * after.slope == pytest.approx(0.02, abs=4.0 * DAY * after.slope_error)


# Share of the scatter that the standard errors of the recordings declare.
@pytest.mark.parametrize("declared", [1.0, 0.2])
@pytest.mark.parametrize("count", [13, 30])
def test_error_of_a_drift_is_its_scatter_over_series(count: int, declared: float) -> None:
    rng, nights = np.random.default_rng(1), np.arange(count)
    errors, slope = np.full(count, 0.016 * declared), 0.024
    deviations = []
    for _ in range(400):
        values = 0.8 + slope * nights + 0.016 * rng.standard_normal(count)
        found = fit_segments(DAY * nights, values, errors, 0.05 / 40)
        if len(found) == 1:
            deviations.append((found[0].slope - slope / DAY) / found[0].slope_error)
    assert len(deviations) > 390
    assert np.mean(deviations) == pytest.approx(0.0, abs=3.0 / np.sqrt(400.0))
    # If the declared errors contain all of the scatter, its minimum makes the error a bit larger.
    assert 0.7 < np.std(deviations) < 1.15


@pytest.mark.parametrize("count", [7, 12, 30, 200])
@pytest.mark.parametrize("chance", [0.05, 0.001])
def test_penalty_is_the_quantile_of_the_t_distribution(count: int, chance: float) -> None:
    freedom = max(0.75 * (count - 1), 5.0)
    quantile = stats.t.isf(0.5 * chance / (2 * (count - 1)), freedom)
    assert _penalty(chance, count) == pytest.approx(quantile**2, rel=0.1)


@pytest.mark.parametrize("shape", ["constant", "steps", "drift"])
def test_scatter_is_estimated_in_spite_of_changes(shape: str) -> None:
    rng, nights = np.random.default_rng(1), np.arange(40)
    change = {"constant": 0.0, "steps": 3.0 * (nights > 9) - 5.0 * (nights > 31),
              "drift": 0.1 * nights}[shape]  # fmt: skip
    ratios = [
        scatter(DAY * nights, 10.0 + change + 0.3 * rng.standard_normal(40), np.full(40, 0.02))
        / 0.3
        for _ in range(40)
    ]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.2)
    assert np.std(ratios) < 0.25


def test_equal_times_and_equal_values_are_possible() -> None:
    found = fit_segments(np.zeros(9), np.ones(9), np.full(9, np.nan), 0.05)
    assert [(each.begin, each.end, each.slope) for each in found] == [(0, 9, 0.0)]
    found = fit_segments(np.arange(9.0), np.zeros(9), np.zeros(9), 0.05)
    assert not is_changed(found) and found[0].mean == 0.0
