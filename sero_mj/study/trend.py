"""Parameters of a robot over many recordings: when they changed, and where they are heading."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import UsageError
from ..base.frames import Array
from .change_points import Segment, fit_segments, scatter
from .explanation import Parameter
from .junit import TestCase
from .measured import DEGREES, Measured

if TYPE_CHECKING:
    from rich.table import Table

_CHANCE = 0.05  # probability of a change point in a report of a robot that does not change
_HORIZON = 3650.0  # days; later dates are not predicted
_MAX_ROWS = 60  # maximum number of rows of a table in the terminal
_DATES = ("%Y-%m-%d", "%Y-%m-%d %H:%M", "%Y-%m-%d %H:%M:%S")
_TIMES = ("%H:%M", "%H:%M:%S")  # if all dates are of the same day


@dataclass(frozen=True, eq=False)
class Trend:
    """A parameter of a joint over the recordings that determine it, in the order of time.

    Attributes:
        parameter: the parameter in the baseline.
        recordings: paths of the recordings.
        dates: local times of the recordings.
        date_texts: dates as text.
        values: values, shape (n,).
        errors: standard errors, shape (n,); NaN if unknown.
        segments: fit by `fit_segments`.
        baseline: index of the baseline.
        tolerance: relative change up to which a parameter is not reported as changed.
        limit: relative change whose date is predicted.
    """

    parameter: Parameter
    recordings: Sequence[str]
    dates: Sequence[datetime]
    date_texts: Sequence[str]
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
        return np.array([date.timestamp() for date in self.dates])

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
    def significance(self) -> float:
        """The magnitude of the change from the baseline to the last recording, in its errors."""
        last, base = self.latest, self.baseline
        segment, reference = self._segment_of(last), self._segment_of(base)
        if segment is not reference or segment.slope:
            errors = segment.error_at(self.times[last]), reference.error_at(self.times[base])
            return float(abs(self.last - self.reference) / np.hypot(*errors))
        spread = scatter(self.times, self.values, self.errors)
        change = self.values[last] - self.values[base]
        return float(abs(change) / np.hypot(spread[last], spread[base]))

    @property
    def is_changed(self) -> bool:
        """Whether the fit changes from the baseline to the last recording beyond the tolerance."""
        return self.is_relevant(self.last - self.reference)

    def is_relevant(self, change: float) -> bool:
        """Returns whether a change exceeds the tolerance and the smallest change that matters."""
        least = max(self.tolerance * abs(self.reference), self.parameter.min_change)
        return abs(change) > least

    @property
    def steps(self) -> list[int]:
        """Indexes of the first recordings after the relevant steps."""
        return [after.begin for after in self.segments[1:] if self.is_relevant(self._step(after))]

    @property
    def events(self) -> list[str]:
        """Sentences about the relevant steps, the drift, and the date of the limit."""
        unit = self.parameter.unit
        told = []
        for k in self.steps:
            low, high = self._fit(k - 1), self._fit(k)
            verb = "rose" if high > low else "fell"
            told.append(
                f"{self.name} {verb} from {_shown(low, high - low)} to {_shown(high, high - low)} "
                f"{unit}{self._percent(high - low, low)} between {self.date_texts[k - 1]} and "
                f"{self.date_texts[k]}"
            )
        segment = self.segments[-1]
        if segment.slope and (told or self.is_changed or self.limit_date is not None):
            verb = "rises" if segment.slope > 0.0 else "falls"
            per_day, error = 86400.0 * abs(segment.slope), 86400.0 * segment.slope_error
            text = (
                f"{self.name} {verb} by {_shown(per_day, per_day)} ± {error:.1g} {unit} per day "
                f"since {self.date_texts[segment.begin]}{self._percent_of_change}"
            )
            if (date := self.limit_date) is not None:
                sign = "+" if (segment.slope > 0.0) == (self.reference > 0.0) else "-"
                text += f"; at this rate {sign}{100.0 * self.limit:.0f} % on about {date:%Y-%m-%d}"
            told.append(text)
        return told

    @property
    def limit_date(self) -> datetime | None:
        """The date at which the drift reaches the limit; None without a drift or such a date."""
        segment, base = self.segments[-1], self.reference
        if not segment.slope or not self._has_percent(base):
            return None
        target = base + self.limit * abs(base) * float(np.sign(segment.slope))
        days = (target - self.last) / segment.slope / 86400.0
        return self.dates[self.latest] + timedelta(days=days) if 0.0 < days < _HORIZON else None

    @property
    def change(self) -> float:
        """The change from the baseline to the last recording, fitted if the parameter changed."""
        if self.is_changed:
            return self.last - self.reference
        return float(self.values[self.latest] - self.values[self.baseline])

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
            return self.date_texts[self.steps[-1]]
        is_told = self.segments[-1].slope and self.events
        return f"since {self.date_texts[self.segments[-1].begin]}" if is_told else ""

    def shown_value(self, index: int) -> str:
        """Returns the value of a recording with its standard error, as text without the unit."""
        value, error = self.values[index], self.errors[index]
        if not error > 0.0:
            return f"{value:.3g}"
        return f"{_shown(value, error)} ± {error:.1g}"

    @property
    def _percent_of_change(self) -> str:
        return self._percent(self.last - self.reference, self.reference) if self.is_changed else ""

    def _percent(self, change: float, base: float) -> str:
        if not self._has_percent(base):
            return ""
        return f" ({round(100.0 * change / abs(base)):+d} %)"

    def _has_percent(self, base: float) -> bool:
        # An offset of zero or a temperature in degrees has no meaningful relative change.
        error = float(np.nan_to_num(self.errors[self.baseline]))
        return self.parameter.unit != DEGREES and abs(base) > max(
            3.0 * error, self.parameter.min_change
        )

    def _segment_of(self, index: int) -> Segment:
        return next(each for each in self.segments if each.begin <= index < each.end)

    def _fit(self, index: int) -> float:
        return self._segment_of(index).at(self.times[index])

    def _step(self, after: Segment) -> float:
        return self._fit(after.begin) - self._fit(after.begin - 1)


def _shown(value: float, precision: float) -> str:
    # With two digits of the precision.
    size = abs(precision) if precision else 1.0
    return f"{value + 0.0:.{int(np.clip(1 - np.floor(np.log10(size)), 0, 6))}f}"


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
    texts = dict(zip(map(id, runs), date_texts([run.date for run in runs]), strict=True))
    by_key = [{each.key: each for each in run.parameters if each.value is not None} for run in runs]
    series = []
    for wanted in baseline.parameters:
        known = [(run, found[wanted.key]) for run, found in zip(runs, by_key, strict=True)
                 if wanted.key in found]  # fmt: skip
        if wanted.value is not None and len(known) > 1:
            series.append((wanted, known))
    if not series:
        raise UsageError(f"no recording has a parameter in common with {baseline.path}")
    trends = []
    for wanted, known in series:
        times = np.array([run.date.timestamp() for run, _ in known])
        values = np.array([each.value for _, each in known], float)
        errors = np.array([each.error for _, each in known], float)  # None becomes NaN
        found = [run for run, _ in known]
        segments = fit_segments(times, values, errors, _CHANCE / len(series))
        trends.append(
            Trend(wanted, [run.path for run in found], [run.date for run in found],
                  [texts[id(run)] for run in found], values, errors, segments,
                  next(k for k, run in enumerate(found) if run is baseline), tolerance, limit)
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
    for heading in ("joint", "parameter", "baseline", "last", "change", "at", "verdict"):
        is_number = heading in ("baseline", "last", "change")
        table.add_column(heading, justify="right" if is_number else "left", no_wrap=True)
    shown = list(trends)
    if len(trends) > _MAX_ROWS:
        ranked = sorted(trends, key=lambda each: (each.is_changed, each.significance))
        shown = [each for each in trends if each in ranked[-_MAX_ROWS:]]
        table.caption = f"the {_MAX_ROWS} most significant of {len(trends)}; --json prints all"
    joint = None
    for each in shown:
        name = "" if each.parameter.joint == joint else each.parameter.joint
        joint = each.parameter.joint
        table.add_row(
            name, f"{each.parameter.label}, {each.parameter.unit}",
            each.shown_value(each.baseline), each.shown_value(each.latest), each.shown_change,
            each.shown_at, "changed" if each.is_changed else "ok",
        )  # fmt: skip
    return table


def as_json(trend: Trend) -> dict[str, Any]:
    """Returns a trend as JSON types, in SI units."""
    date = trend.limit_date
    return {
        "joint": trend.parameter.joint,
        "parameter": trend.parameter.name,
        "unit": trend.parameter.unit,
        "recordings": list(trend.recordings),
        "values": trend.values.tolist(),
        "errors": trend.errors.tolist(),
        "baseline": trend.reference,
        "last": trend.last,
        "significance": trend.significance,
        "changed": bool(trend.is_changed),
        "change_points": [trend.recordings[k] for k in trend.steps],
        "slope_per_day": 86400.0 * trend.segments[-1].slope,
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
