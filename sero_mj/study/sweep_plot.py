"""A picture of a sweep: every outcome over every value that was varied."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RenderError
from .sweep import Sweep
from .sweep_table import is_known, value_columns
from .vary import Vary

_MAX_ROWS, _MAX_COLUMNS = 8, 5
_HELD, _FAILED = "#2a7f62", "#c8553d"


def plot_sweep(sweep: Sweep, rows: Mapping[int, Mapping[str, Any]], path: Path) -> None:
    """Draws points, green where what is expected held, red where not.

    Crosses at the lower edge are variants without a value: they could not begin, or nothing was
    found. Numbers of robots are green where all of the variant held. Bounds that are expected are
    dashed lines. Up to eight outcomes over up to five keys, those of expectations first.

    Args:
        sweep: what was varied.
        rows: of its table, by number.
        path: a picture's, .png, .pdf or .svg.

    Raises:
        RenderError: it cannot be written.
    """
    from matplotlib.figure import Figure  # no window, no state: it may run beside others

    names = value_columns(sweep.columns)
    expected = [name for name in names if names[name].startswith("expect.")]
    others = [
        name
        for name in names
        if name not in expected and any(row.get(names[name]) for row in rows.values())
    ]
    shown = (expected + others)[:_MAX_ROWS]
    varied = sweep.varied[:_MAX_COLUMNS]
    figure = Figure(figsize=(1.2 + 3.3 * len(varied), 1.0 + 1.6 * len(shown)), layout="constrained")
    axes = figure.subplots(len(shown), len(varied), squeeze=False, sharex="col", sharey="row")
    for line, name in zip(axes, shown, strict=True):
        for axis, vary in zip(line, varied, strict=True):
            _draw(axis, vary, rows, names[name])
            _draw_bounds(axis, sweep, name)
        line[0].set_ylabel(name.replace("_", " "), fontsize=8)
    for axis, vary in zip(axes[-1], varied, strict=True):
        axis.set_xlabel(vary.key, fontsize=8)
    held = sum(row["held"] is True for row in rows.values())
    figure.suptitle(f"{sweep.base.name}: {held} of {len(rows)} held", fontsize=11)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        raise RenderError(f"{path}: cannot be written: {error}") from error


def _draw(axis: Any, vary: Vary, rows: Mapping[int, Mapping[str, Any]], column: str) -> None:
    known = [row for _, row in sorted(rows.items()) if is_known(row, column)]
    places = _places(vary, known)
    heights = np.array([float(row[column]) for row in known])
    own = column.removesuffix(".value") if column.startswith("expect.") else "held"
    held = np.array([row[own] is True for row in known], bool)
    for chosen, colour in ((held, _HELD), (~held, _FAILED)):
        axis.scatter(places[chosen], heights[chosen], s=14, c=colour, alpha=0.8)
    # Where there is no value, a cross at the lower edge says so.
    lost = _places(vary, [row for row in rows.values() if not is_known(row, column)])
    low = np.full(len(lost), 0.03)
    axis.scatter(lost, low, s=18, c=_FAILED, marker="x", transform=axis.get_xaxis_transform())
    if vary.scale == "log":
        axis.set_xscale("log")
    if vary.values and not _are_numbers(vary.values):
        axis.set_xticks(range(len(vary.values)), [str(value) for value in vary.values], fontsize=7)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.25)


def _places(vary: Vary, rows: list[Mapping[str, Any]]) -> Any:
    """Where on the axis variants are: at their value, or at its number in the list."""
    values = [row[vary.key] for row in rows]
    if vary.values and not _are_numbers(vary.values):
        values = [vary.values.index(value) for value in values]
    return np.array(values, np.float64)


def _are_numbers(values: tuple[Any, ...]) -> bool:
    return all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)


def _draw_bounds(axis: Any, sweep: Sweep, name: str) -> None:
    expect = sweep.base.expect.get(name)
    if expect is None:
        return
    for bound in (expect.below, expect.above, expect.within):
        if bound is not None:
            axis.axhline(bound, color="#777777", lw=0.9, ls="--")
