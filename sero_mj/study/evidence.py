"""`Evidence`: the residuals that an explanation is based on, with and without the explanation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ..base.frames import Array, Bools

Side = Literal["link", "drive"]
# What residuals of each side are differences of.
MEANINGS: Mapping[Side, str] = {
    "link": "measured minus model torque",
    "drive": "commanded minus measured torque, without declared friction and inertia",
}
_BINS = 40  # maximum number of points of a fit over its quantity
_FILTERED = 0.05  # s, duration of the begin and end of a fault after the low-pass filter


@dataclass(frozen=True, eq=False)
class Evidence:
    """The residuals of one side of a joint, before and after an explanation.

    Attributes:
        joint: name of the joint at which the explanation has its largest effect.
        side: `link` for measured minus model torques, `drive` for commanded minus measured torques.
        times: times of the rows, shape (K,), s.
        before: residuals without all other explanations, shape (K,), Nm or N; NaN for rows that
            were not used.
        after: residuals without all explanations, shape (K,).
        quantity: name of the quantity that explains the residuals, such as `angle`.
        unit: unit of the quantity.
        values: values of the quantity, shape (K,).
        torque_unit: unit of the residuals.
        left_out: mapping from reasons to numbers of rows that were not used.
    """

    joint: str
    side: Side
    times: Array
    before: Array
    after: Array
    quantity: str
    unit: str
    values: Array
    torque_unit: str
    left_out: Mapping[str, int] = field(default_factory=dict)

    @property
    def used(self) -> int:
        """Number of rows that were used."""
        return int(np.isfinite(self.before).sum())

    @property
    def rows_text(self) -> str:
        """The number of rows that were used, and why others were left out, as text."""
        text = f"{self.used} of {len(self.times)} rows"
        reasons = ", ".join(f"{count} {reason}" for reason, count in self.left_out.items())
        return f"{text}; left out: {reasons}" if reasons else text

    def fit(self, begin: float, end: float | None) -> tuple[Array, Array]:
        """Returns the explained torque over the quantity, as medians of bins, shape (B,) each.

        `begin` and `end` are the times of the fault, s; None for the end of the run.
        """
        last = np.inf if end is None else end - _FILTERED
        acts = (self.times > begin + _FILTERED) & (self.times < last)
        effect = self.before - self.after
        rows = np.flatnonzero(np.isfinite(effect + self.values) & (effect != 0.0) & acts)
        if not len(rows):
            return np.zeros(0), np.zeros(0)
        rows = rows[np.argsort(self.values[rows], kind="stable")]
        bins = np.array_split(rows, min(_BINS, len(rows)))
        return (
            np.array([np.median(self.values[each]) for each in bins]),
            np.array([np.median(effect[each]) for each in bins]),
        )

    def as_json(self) -> dict[str, Any]:
        """Returns the evidence without its rows as JSON types."""
        known = np.isfinite(self.before)
        rms_before, rms_after = (
            float(np.sqrt(np.mean(each[known] ** 2))) if known.any() else None
            for each in (self.before, self.after)
        )
        return {
            "joint": self.joint,
            "side": self.side,
            "rows": len(self.times),
            "used": self.used,
            "left_out": dict(self.left_out),
            "quantity": self.quantity,
            "rms_before": rms_before,
            "rms_after": rms_after,
        }


def count_left_out(unknown: Bools, reasons: Mapping[str, Bools]) -> dict[str, int]:
    """Counts unknown rows by their first reason; rows without a reason belong to other verdicts.

    Args:
        unknown: mask of the rows that were not used, shape (K,) or (K, n).
        reasons: mapping from reasons to masks of the same shape.
    """
    counts, rest = {}, unknown.copy()
    for reason, rows in reasons.items():
        counts[reason] = int((rest & rows).sum())
        rest = rest & ~rows
    counts["other verdict"] = int(rest.sum())
    return {reason: count for reason, count in counts.items() if count}
