"""`marks_of_explanations`: explanations on the timeline of a page, with plots of their evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..base.frames import Array
from ..viewer.player.capture import Mark, MarkPlot
from .align import Pair
from .explanation import Explanation

_DIGITS = 5  # significant digits of plotted values


def marks_of_explanations(pair: Pair, explanations: Sequence[Explanation]) -> list[Mark]:
    """Returns marks with times relative to the start of two aligned runs."""
    first, last = float(pair.times[0]), float(pair.times[-1])
    marks = []
    for each in explanations:
        begin = 0.0 if each.from_start else each.begin - first
        end = last - first if each.end is None else each.end - first
        text = f"{each.joint}: {each.short}"
        marks.append(Mark(begin, end, text, "fault", _plot(pair, each, first)))
    return marks


def _plot(pair: Pair, explanation: Explanation, first: float) -> MarkPlot | None:
    evidence = explanation.evidence
    if evidence is None:
        return None
    begin = -float("inf") if explanation.from_start else explanation.begin
    x, y = evidence.fit(begin, explanation.end)
    notes = [f"{explanation.text}, {100.0 * explanation.confidence:.0f} %", evidence.rows_text]
    if explanation.alternatives:
        notes.append(explanation.or_else)
    if explanation.next:
        notes.append(f"next: {explanation.next}")
    return MarkPlot(
        joint=f"{pair.robot.name}/{evidence.joint}",
        notes=notes,
        label=f"{evidence.joint}, {evidence.side} side [{evidence.torque_unit}]",
        times=[each for each in _rounded(evidence.times - first) if each is not None],
        before=_rounded(evidence.before),
        after=_rounded(evidence.after),
        quantity=f"over {evidence.quantity} [{evidence.unit}]",
        unit=evidence.unit,
        values=_rounded(evidence.values),
        fit=[(float(a), float(b)) for a, b in zip(x, y, strict=True)],
    )


def _rounded(values: Array) -> list[float | None]:
    return [float(f"{each:.{_DIGITS}g}") if math.isfinite(each) else None
            for each in values.tolist()]  # fmt: skip
