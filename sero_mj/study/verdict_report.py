"""`write_markdown`: a report of a comparison in Markdown, for issues and CI summaries."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ..base.errors import UsageError
from .align import Pair
from .compare import Difference, shown_as
from .explanation import Explanation


def write_markdown(
    pair: Pair,
    differences: Sequence[Difference],
    explanations: Sequence[Explanation],
    about: Sequence[str],
    path: Path,
    figure: Path | None = None,
) -> None:
    """Writes the differences, the explanations with their evidence, and a link to a figure.

    Raises:
        UsageError: the file cannot be written.
    """
    title = f"# {pair.names[0]} minus {pair.names[1]}: {pair.robot.name}"
    parts = [title, "\n".join(f"- {line}" for line in about)]
    parts += [_about(each) for each in explanations] or ["No difference was explained."]
    shown = [each for each in differences
             if each.signal != "joint_angles" or not pair.has_one_motion]  # fmt: skip
    parts.append("## Differences\n\n" + _table(
        ("joint", "signal", "rms", "peak", "at"), [_row(each) for each in shown]
    ))  # fmt: skip
    if figure is not None:
        parts.append(f"![evidence]({os.path.relpath(figure, path.parent)})")
    try:
        path.write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def _about(explanation: Explanation) -> str:
    lines = [f"## {explanation.joint}: {explanation}", ""]
    lines.append(f"- confidence: {100.0 * explanation.confidence:.0f} %")
    if explanation.alternatives:
        lines.append(f"- {explanation.or_else}")
    if explanation.next:
        lines.append(f"- next: {explanation.next}")
    if explanation.evidence is not None:
        found = explanation.evidence.as_json()
        before, after = (found[f"rms_{which}"] or 0.0 for which in ("before", "after"))
        unit = explanation.evidence.torque_unit
        where = f"{explanation.evidence.joint}, {explanation.evidence.side} side"
        lines.append(f"- residual of {where}: rms {before:.3g} {unit} before, {after:.3g} after")
        lines.append(f"- used: {explanation.evidence.rows_text}")
    return "\n".join(lines)


def _row(difference: Difference) -> tuple[str, ...]:
    factor, unit = shown_as(difference.unit)
    rms, peak = factor * difference.rms, factor * difference.peak
    values = f"{rms:.3g} {unit}", f"{peak:+.3g} {unit}", f"{difference.at:.3f} s"
    return difference.joint, difference.signal.replace("_", " "), *values


def _table(heading: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
