"""Parameters of a robot over many recordings: when they changed, and where they are heading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...base.errors import UsageError
from ...base.frames import Array
from ...study.explanation import Parameter
from ...study.junit import TestCase
from .change_points import Segment, fit_segments, scatter
from .measured import DEGREES, Measured

if TYPE_CHECKING:
    from rich.table import Table

_CHANCE = 0.05  # probability of a change point in a report of a robot that does not change
_HORIZON = 3650.0  # days; later dates are not predicted
_MAX_ROWS = 60  # maximum number of rows of a table in the terminal
_DAY = 86400.0  # s
_DATES = ("%Y-%m-%d", "%Y-%m-%d %H:%M", "%Y-%m-%d %H:%M:%S")
_TIMES = ("%H:%M", "%H:%M:%S")  # if all dates are of the same day
NUMBERS = ("baseline", "last", "change", "significance")  # headings of columns with numbers


@dataclass(frozen=True, eq=False)
class Trend:
    """A parameter of a joint over the recordings that determine it, in the order of time.

    Attributes:
        parameter: the parameter in the baseline.
        runs: recordings.
        dates: dates of the recordings as text.
        values: values, shape (n,).
        errors: standard errors, shape (n,); NaN if unknown.
        segments: fit by `fit_segments`.
        baseline: index of the baseline.
        tolerance: relative change up to which a parameter is not reported as changed.
        limit: relative change whose date is predicted.
    """

    parameter: Parameter
    runs: Sequence[Measured]
    dates: Sequence[str]
    values: Array
    errors: Array
    segments: Sequence[Segment]
    baseline: int
    tolerance: float
    limit: float

    @property
    def name(self) -> str:
        """The joint and the parameter, such as `A4 Coulomb friction`."""
        return f"{self.parameter.joint} {self.parameter.label}"

    @cached_property
    def times(self) -> Array:
        """Times of the recordings since the epoch, shape (n,), s."""
        return times_of(self.runs)

    @property
    def latest(self) -> int:
        """Index of the last recording that is not the baseline."""
        return len(self.values) - (2 if self.baseline == len(self.values) - 1 else 1)

    @property
    def reference(self) -> float:
        """The fitted value at the baseline."""
        return self._fit(self.baseline)

    @property
    def last(self) -> float:
        """The fitted value at the last recording."""
        return self._fit(self.latest)

    @property
    def is_changed(self) -> bool:
        """Whether the fit changes from the baseline to the last recording beyond the tolerance."""
        return self._is_relevant(self.last - self.reference)

    @property
    def change(self) -> float:
        """The change from the baseline to the last recording, fitted if the parameter changed."""
        if self.is_changed:
            return self.last - self.reference
        return float(self.values[self.latest] - self.values[self.baseline])

    @property
    def significance(self) -> float:
        """The magnitude of the change in its standard errors."""
        both = [self.latest, self.baseline]
        errors = scatter(self.times, self.values, self.errors)[both]
        if self.is_changed:
            errors = np.array([self._segment_of(k).error_at(self.times[k]) for k in both])
        return float(abs(self.change) / np.linalg.norm(errors))

    @property
    def steps(self) -> list[int]:
        """Indexes of the first recordings after the relevant steps."""
        begins = [segment.begin for segment in self.segments[1:]]
        return [k for k in begins if self._is_relevant(self._fit(k) - self._fit(k - 1))]

    @property
    def events(self) -> list[str]:
        """Sentences about the relevant steps, the drift, and the date of the limit."""
        texts = [self._step_text(k) for k in self.steps]
        has_drift = bool(self.segments[-1].slope)
        if has_drift and (texts or self.is_changed or self.limit_date is not None):
            texts.append(self._drift_text())
        return texts

    @property
    def limit_date(self) -> datetime | None:
        """The date at which the drift reaches the limit; None without a drift or such a date."""
        slope, base = self.segments[-1].slope, self.reference
        if not slope or not self._has_percent(base):
            return None
        target = base + self.limit * abs(base) * float(np.sign(slope))
        days = (target - self.last) / slope / _DAY
        latest = self.runs[self.latest].date
        return latest + timedelta(days=days) if 0.0 < days < _HORIZON else None

    @property
    def shown_change(self) -> str:
        """The change as text without the unit, and in percent if this is meaningful."""
        base = self.reference if self.is_changed else self.values[self.baseline]
        return f"{self.change:+.2g}{self._percent(self.change, base)}"

    @property
    def short_change(self) -> str:
        """The change in percent if this is meaningful, otherwise with its unit."""
        short = self._percent(self.change, self.reference).strip(" ()")
        return short or f"{self.change:+.2g} {self.parameter.unit}"

    @property
    def shown_at(self) -> str:
        """The date of the last relevant step or of the start of the drift; otherwise empty."""
        if self.steps:
            return self.dates[self.steps[-1]]
        return f"since {self.dates[self.segments[-1].begin]}" if self.events else ""

    def shown_value(self, index: int) -> str:
        """Returns the value of a recording with its standard error, as text without the unit."""
        value, error = self.values[index], self.errors[index]
        return _with_error(value, error) if error > 0.0 else f"{value:.3g}"

    def cells(self) -> dict[str, str]:
        """Returns the row of the trend in tables, by heading."""
        return {
            "joint": self.parameter.joint,
            "parameter": f"{self.parameter.label}, {self.parameter.unit}",
            "baseline": self.shown_value(self.baseline),
            "last": self.shown_value(self.latest),
            "change": self.shown_change,
            "at": self.shown_at,
            "significance": f"{self.significance:.1f}",
            "verdict": "changed" if self.is_changed else "ok",
        }

    def _step_text(self, k: int) -> str:
        low, high, unit = self._fit(k - 1), self._fit(k), self.parameter.unit
        change = high - low
        return (
            f"{self.name} {'rose' if change > 0.0 else 'fell'} from {_rounded(low, change)} to "
            f"{_rounded(high, change)} {unit}{self._percent(change, low)} between "
            f"{self.dates[k - 1]} and {self.dates[k]}"
        )

    def _drift_text(self) -> str:
        segment, change = self.segments[-1], self.last - self.reference
        rate = _with_error(_DAY * abs(segment.slope), _DAY * segment.slope_error)
        text = (
            f"{self.name} {'rises' if segment.slope > 0.0 else 'falls'} by {rate} "
            f"{self.parameter.unit} per day since {self.dates[segment.begin]}"
        )
        if self.is_changed:
            text += self._percent(change, self.reference)
        if (date := self.limit_date) is not None:
            sign = "+" if (segment.slope > 0.0) == (self.reference > 0.0) else "-"
            text += f"; at this rate {sign}{100.0 * self.limit:.0f} % on about {date:%Y-%m-%d}"
        return text

    def _is_relevant(self, change: float) -> bool:
        least = max(self.tolerance * abs(self.reference), self.parameter.min_change)
        return abs(change) > least

    def _percent(self, change: float, base: float) -> str:
        return f" ({round(100.0 * change / abs(base)):+d} %)" if self._has_percent(base) else ""

    def _has_percent(self, base: float) -> bool:
        # An offset of zero or a temperature in degrees has no meaningful relative change.
        error = float(np.nan_to_num(self.errors[self.baseline]))
        least = max(3.0 * error, self.parameter.min_change)
        return self.parameter.unit != DEGREES and abs(base) > least

    def _segment_of(self, index: int) -> Segment:
        return next(each for each in self.segments if each.begin <= index < each.end)

    def _fit(self, index: int) -> float:
        return self._segment_of(index).at(self.times[index])


def _with_error(value: float, error: float) -> str:
    return f"{_rounded(value, error)} ± {_rounded(error, error)}"


def _rounded(value: float, precision: float) -> str:
    # With two digits of the precision.
    size = abs(precision) if precision else 1.0
    return f"{value:z.{int(np.clip(1 - np.floor(np.log10(size)), 0, 6))}f}"


def times_of(runs: Sequence[Measured]) -> Array:
    """Returns the times of recordings since the epoch, shape (n,), s."""
    return np.array([run.date.timestamp() for run in runs])


def find_trends(
    baseline: Measured, others: Sequence[Measured], tolerance: float, limit: float
) -> list[Trend]:
    """Returns the trends of the parameters that the baseline and another recording determine.

    Args:
        baseline: recording of the intact robot.
        others: other recordings of the robot, in any order.
        tolerance: relative change up to which a parameter is not reported as changed.
        limit: relative change whose date is predicted.

    Raises:
        UsageError: there is no such parameter.
    """
    runs = sorted([baseline, *others], key=lambda run: run.date)
    dates = date_texts([run.date for run in runs])
    by_key = [{each.key: each for each in run.parameters if each.value is not None} for run in runs]
    series = []
    for wanted in baseline.parameters:
        known = [k for k, found in enumerate(by_key) if wanted.key in found]
        if wanted.value is not None and len(known) > 1:
            series.append((wanted, known))
    if not series:
        raise UsageError(f"no recording has a parameter in common with {baseline.path}")
    trends = []
    for wanted, known in series:
        found = [by_key[k][wanted.key] for k in known]
        values = np.array([each.value for each in found], float)
        errors = np.array([each.error for each in found], float)  # None becomes NaN
        used = [runs[k] for k in known]
        segments = fit_segments(times_of(used), values, errors, _CHANCE / len(series))
        position = next(k for k, run in enumerate(used) if run is baseline)
        trends.append(
            Trend(wanted, used, [dates[k] for k in known], values, errors, segments, position,
                  tolerance, limit)
        )  # fmt: skip
    return trends


def date_texts(dates: Sequence[datetime]) -> list[str]:
    """Returns dates as short texts, with the time of day if this is needed to distinguish them."""
    is_one_day = len({date.date() for date in dates}) == 1
    for form in _TIMES if is_one_day else _DATES:
        found = [f"{date:{form}}" for date in dates]
        if len(set(found)) == len(found):
            break
    return found


def as_table(trends: Sequence[Trend], title: str) -> Table:
    """Returns a table for the terminal; of many trends, the most significant ones."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
                  caption_justify="left")  # fmt: skip
    headings = [heading for heading in trends[0].cells() if heading != "significance"]
    for heading in headings:
        table.add_column(heading, justify="right" if heading in NUMBERS else "left", no_wrap=True)
    shown = list(trends)
    if len(trends) > _MAX_ROWS:
        ranked = sorted(trends, key=lambda each: (each.is_changed, each.significance))
        shown = [each for each in trends if each in ranked[-_MAX_ROWS:]]
        table.caption = f"the {_MAX_ROWS} most significant of {len(trends)}; --json prints all"
    joint = None
    for each in shown:
        cells = each.cells()
        cells["joint"], joint = "" if cells["joint"] == joint else cells["joint"], cells["joint"]
        table.add_row(*(cells[heading] for heading in headings))
    return table


def as_json(trend: Trend) -> dict[str, Any]:
    """Returns a trend as JSON types, in SI units."""
    date, drift = trend.limit_date, trend.segments[-1]
    recordings = [run.path for run in trend.runs]
    return {
        "joint": trend.parameter.joint,
        "parameter": trend.parameter.name,
        "unit": trend.parameter.unit,
        "recordings": recordings,
        "values": trend.values.tolist(),
        "errors": trend.errors.tolist(),
        "baseline": trend.reference,
        "last": trend.last,
        "significance": trend.significance,
        "changed": bool(trend.is_changed),
        "change_points": [recordings[k] for k in trend.steps],
        "slope_per_day": _DAY * drift.slope,
        "slope_error_per_day": _DAY * drift.slope_error,
        "limit_date": None if date is None else f"{date:%Y-%m-%d}",
        "events": trend.events,
    }


def test_cases(trends: Sequence[Trend], skipped: Sequence[tuple[str, str]]) -> list[TestCase]:
    """Returns a test case per trend, which fails if it changed, and one per skipped recording."""
    cases = []
    for each in trends:
        failure = ""
        if each.is_changed:
            changed = f"{each.name} changed by {each.shown_change} {each.parameter.unit}"
            failure = "; ".join(each.events) or changed
        cases.append(TestCase(each.parameter.joint, each.parameter.name, failure=failure))
    return cases + [TestCase("recordings", path, skipped=reason) for path, reason in skipped]
