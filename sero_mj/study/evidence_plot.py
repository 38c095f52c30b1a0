"""Draws the evidence of explanations: residuals over time and over an explaining quantity.

Residuals before the explanation are gray, and those after it are in the color of differences.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .evidence import MEANINGS
from .explanation import Explanation
from .figure import BLUE, FAULT, GREY, INK, Figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PER_PAGE = 6  # maximum number of explanations on a page
_ROW = 40.0  # height of the panels of an explanation, mm
_PAD = 10.0  # points; the next experiment is below the title
_MARGIN = 0.02  # of the horizontal range, as a share
_LOOK: Any = {"linewidth": 0.0, "marker": ".", "markeredgewidth": 0.0}


def height_of(explanations: Sequence[Explanation]) -> float:
    """Returns the height of the panels of explanations, mm."""
    return _ROW * len(explanations)


def draw_evidence(figure: Figure, explanations: Sequence[Explanation]) -> None:
    """Draws a pair of panels for each explanation with evidence below the panels of a figure."""
    panels: Any = figure.below.subplots(len(explanations), 2, squeeze=False, width_ratios=[1.35, 1])
    for (left, right), each in zip(panels.tolist(), explanations, strict=True):
        _draw_over_time(left, each)
        _draw_over_quantity(right, each)


def _draw_over_time(panel: Axes, explanation: Explanation) -> None:
    evidence = explanation.evidence
    assert evidence is not None
    panel.plot(evidence.times, evidence.before, color=GREY, linewidth=1.4, label="before")
    panel.plot(evidence.times, evidence.after, color=BLUE, linewidth=0.8, label="after")
    if not explanation.from_start:
        panel.axvline(explanation.begin, color=FAULT, linewidth=0.7)
    if explanation.end is not None:
        panel.axvline(explanation.end, color=FAULT, linewidth=0.7, linestyle=(0, (4, 2)))
    panel.axhline(0.0, color=GREY, linewidth=0.5)
    panel.set_xlim(evidence.times[0], evidence.times[-1])
    title = f"{explanation.joint}: {explanation.short}, {100.0 * explanation.confidence:.0f} %"
    if explanation.joint != evidence.joint:
        title += f" (residuals of {evidence.joint})"
    panel.set_title(title, fontsize=7.0, loc="left", pad=_PAD, color=FAULT)
    if explanation.next:  # extends over both panels
        panel.text(0.0, 1.02, f"next: {explanation.next}", transform=panel.transAxes, fontsize=5.5,
                   va="bottom", color=GREY, in_layout=False)  # fmt: skip
    panel.set_xlabel(f"time, s; {evidence.rows_text}", labelpad=2.0)
    panel.set_ylabel(f"{evidence.side} side, {evidence.torque_unit}")
    panel.legend(loc="best", fontsize=5.5, frameon=False, ncols=2, handlelength=1.2)


def _draw_over_quantity(panel: Axes, explanation: Explanation) -> None:
    evidence = explanation.evidence
    assert evidence is not None
    panel.plot(evidence.values, evidence.before, color=GREY, **_LOOK, markersize=4.0)
    panel.plot(evidence.values, evidence.after, color=BLUE, **_LOOK, markersize=2.2)
    begin = evidence.times[0] - 1.0 if explanation.from_start else explanation.begin
    panel.plot(*evidence.fit(begin, explanation.end), color=FAULT, linewidth=1.0)
    panel.axhline(0.0, color=GREY, linewidth=0.5)
    panel.set_title(MEANINGS[evidence.side], fontsize=5.5, loc="right", pad=_PAD, color=INK)
    panel.set_xlabel(f"{evidence.quantity}, {evidence.unit}", labelpad=2.0)
    panel.margins(x=_MARGIN)


def with_evidence(explanations: Sequence[Explanation]) -> list[Explanation]:
    """Returns the explanations that have evidence, with the most confident ones first."""
    found = [each for each in explanations if each.evidence is not None
             and np.isfinite(each.evidence.before).any()]  # fmt: skip
    return sorted(found, key=lambda each: -each.confidence)
