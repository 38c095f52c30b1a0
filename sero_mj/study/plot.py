"""A run as a figure: commanded and measured torques, limits, their error, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError, did_you_mean
from ..runs.run_log import RunLog, compared_signal, torque_error
from .figure import (
    BLUE,
    FAULT,
    GREY,
    INK,
    MIN_SHARE,
    ORANGE,
    Figure,
    Span,
    check_suffix,
    save_figures,
    styled,
)
from .reduction import peak, rms

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..runs.monitor import Finding
    from ..simulate.scenario import Scenario

Array = NDArray[np.float64]

_IN_VIEW = 0.6  # share of its limit from which on a torque is shown together with it
_MIN_TORQUE = 0.2  # Nm that a panel shows at least, where there is no limit
_MARKERS = {
    "torque_error": "v",
    "external_torque": "D",
    "position_error": "s",
    "frozen_torque": "*",
    "saturated": "^",
    "velocity_limit": ">",
    "position_limit": "<",
}
_CLOSE, _LEVELS = 0.1, 5  # share of the time within which marks stand beneath each other
_OF_ERROR = ("torque_error", "frozen_torque")  # findings that stand beside the error


def plot_run(
    log: RunLog,
    path: Path | str,
    *,
    robots: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    findings: Sequence[Finding] = (),
    spans: Sequence[Span] = (),
    size_mm: tuple[float, float] | None = None,
) -> None:
    """Draws a run: a row for each joint, torques on the left, commanded less measured beside them.

    Lines are envelopes: of a million rows every peak is still there, and only what was logged.

    Args:
        log: the run, with `torques`, `commanded_torques`, or both.
        path: where to: .png (300 dpi), .pdf or .svg.
        robots: which; all when None.
        joints: their names, of any of the robots; all when None.
        findings: what the monitor found; marked at the joints.
        spans: what happened; `spans_of` makes them of a scenario.
        size_mm: width and height; the width of A4 when None.

    Raises:
        RenderError: the file cannot be written.
        UsageError: no such robot or joint, no torque, another suffix.
    """
    plot_runs(
        [log],
        path,
        robots=robots,
        joints=joints,
        findings=findings,
        spans=spans,
        size_mm=size_mm,
    )


def plot_runs(logs: Sequence[RunLog], path: Path | str, **options: Any) -> None:
    """Draws several runs, each on a page of a .pdf.

    Args:
        logs: the runs; one of them may go to a .png or .svg as well.
        path: where to.
        **options: see `plot_run`.

    Raises:
        RenderError: the file cannot be written.
        UsageError: see `plot_run`, or several runs are to go into a picture.
    """
    path = check_suffix(path)
    with styled():
        save_figures([_draw_run(log, **options) for log in logs], path)


def _draw_run(
    log: RunLog,
    *,
    robots: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    findings: Sequence[Finding] = (),
    spans: Sequence[Span] = (),
    size_mm: tuple[float, float] | None = None,
) -> Figure:
    chosen = _choose(log, robots, joints)
    has_both = all(log.has(robot, signal) for robot, _ in chosen
                   for signal in ("torques", "commanded_torques"))  # fmt: skip
    several = len({robot for robot, _ in chosen}) > 1
    rows = [(log.robots[robot].names[k], _beneath(log, robot, k, named=several))
            for robot, k in chosen]  # fmt: skip
    units = {_unit(log, robot, k) for robot, k in chosen}
    unit = units.pop() if len(units) == 1 else "Nm or N"
    columns = [(f"torque, {unit}", 1.25)]
    if has_both:
        columns.append((f"torque error, {unit}", 1.0))
    figure = Figure(
        rows,
        columns,
        title=log.name,
        subtitle=_about(log, has_both=has_both),
        times=(float(log.times[0]), float(log.times[-1])),
        size_mm=size_mm,
    )
    for (robot, k), panels in zip(chosen, figure.axes, strict=True):
        _draw_torques(figure, panels[0], log, robot, k)
        if has_both:
            _draw_error(figure, panels[1], log, robot, k)
    figure.spans(spans)
    marked = _mark(figure, log, chosen, findings)
    has_limit = any(line.get_label() == "limit" for panels in figure.axes
                    for line in panels[0].lines)  # fmt: skip
    figure.legend(_legend(log, chosen, spans, marked, has_limit=has_limit))
    return figure


def spans_of(scenario: Scenario) -> list[Span]:
    """The disturbances and faults of a scenario as bands."""
    spans = [Span(name, each.begin, each.end) for name, each in scenario.disturbances.items()]
    spans += [Span(name, each.begin, each.end, True) for name, each in scenario.faults.items()]
    return spans


def _choose(
    log: RunLog, robots: Sequence[str] | None, joints: Sequence[str] | None
) -> list[tuple[str, int]]:
    """Robot and index of every joint to show."""
    for name in robots or ():
        if name not in log.robots:
            raise UsageError(f"no robot '{name}' in {log.name}{did_you_mean(name, log.robots)}")
    if robots is None:  # those that have any torque
        signals = ("torques", "commanded_torques")
        robots = [robot for robot in log.robots if any(log.has(robot, each) for each in signals)]
    wanted = list(robots) or list(log.robots)
    names = [joint for robot in wanted for joint in log.robots[robot].names]
    for joint in joints or ():
        if joint not in names:
            raise UsageError(f"no joint '{joint}' in {log.name}{did_you_mean(joint, names)}")
    for robot in wanted:
        if not (log.has(robot, "torques") or log.has(robot, "commanded_torques")):
            found = f"run {log.name} has no torques of robot '{robot}'"
            raise UsageError(f"{found}; expected torques or commanded_torques")
    chosen = [(robot, k) for robot in wanted for k, joint in enumerate(log.robots[robot].names)
              if joints is None or joint in joints]  # fmt: skip
    if not chosen or len(log.times) == 0:
        raise UsageError(f"run {log.name} has nothing to plot")
    return chosen


def _unit(log: RunLog, robot: str, k: int) -> str:
    return "Nm" if log.robots[robot].types[k] == "revolute" else "N"


def _beneath(log: RunLog, robot: str, k: int, *, named: bool) -> str:
    """What stands beneath a joint's name: its robot, its limit, and how close it came."""
    limit = float(log.torque_limits(robot)[k])
    lines = [robot] if named else []
    if np.isfinite(limit):
        lines.append(f"limit {limit:.4g} {_unit(log, robot, k)}")
    signal = "torques" if log.has(robot, "torques") else "commanded_torques"
    values = log.of(robot, signal)[:, k]
    row = peak(values)
    if np.isfinite(limit) and row is not None:
        lines.append(f"peak {100.0 * abs(values[row]) / limit:.0f} %")
    return "\n".join(lines)


def _about(log: RunLog, *, has_both: bool) -> str:
    rows = f"{len(log.times):,} rows".replace(",", " ")
    span = f"{log.times[-1] - log.times[0]:.4g} s, {rows}"
    return f"{span}; error is commanded less measured" if has_both else span


def _draw_torques(figure: Figure, panel: Axes, log: RunLog, robot: str, k: int) -> None:
    limit = float(log.torque_limits(robot)[k])
    curves = []
    for signal, look in (
        ("torques", {"color": BLUE, "linewidth": 1.5, "zorder": 2.0}),
        ("commanded_torques", {"color": ORANGE, "linewidth": 0.7, "zorder": 2.1}),
    ):
        if log.has(robot, signal):
            values = compared_signal(log, robot, signal)[:, k]
            figure.line(panel, log.times, values, signal, **look)
            curves.append(values)
    shown: list[float] = []
    known = np.concatenate(curves)
    known = known[np.isfinite(known)]
    if np.isfinite(limit):  # a limit is shown where it is near, on its side
        shown = [side * limit for side in (-1.0, 1.0) if len(known)
                 and (side * known).max() >= _IN_VIEW * limit]  # fmt: skip
        for bound in shown:
            panel.axhline(bound, color=INK, linewidth=0.8, linestyle=(0, (4, 2)), label="limit")
    figure.fit(panel, curves, least=MIN_SHARE * limit, floor=_MIN_TORQUE, also=shown)


def _draw_error(figure: Figure, panel: Axes, log: RunLog, robot: str, k: int) -> None:
    error = torque_error(log, robot)[:, k]
    figure.signed_area(panel, log.times, error, "torque_error")
    limit = float(log.torque_limits(robot)[k])
    least = 0.5 * MIN_SHARE * limit
    if figure.fit(panel, [error], least=least, floor=_MIN_TORQUE, also=[0.0]):
        row = peak(error)
        assert row is not None  # `fit` has found something
        text = f"peak {error[row]:+.3g}".replace("-", "−")
        figure.note(panel, f"{text} at {log.times[row]:.3f} s, rms {rms(error):.3g}")


def _mark(
    figure: Figure, log: RunLog, chosen: Sequence[tuple[str, int]], findings: Sequence[Finding]
) -> list[str]:
    """Marks findings at the upper edge of their joints' panels; returns their kinds."""
    rows = {(robot, log.robots[robot].names[k]): i for i, (robot, k) in enumerate(chosen)}
    kinds: list[str] = []
    marked: dict[Axes, list[float]] = {}
    close = _CLOSE * float(log.times[-1] - log.times[0])
    for finding in findings:
        row = rows.get((finding.robot, finding.joint))
        if row is None:
            continue
        panels = figure.axes[row]
        panel = panels[-1] if finding.kind in _OF_ERROR else panels[0]
        times = marked.setdefault(panel, [])
        level = sum(abs(finding.time - time) < close for time in times) % _LEVELS
        times.append(finding.time)
        panel.plot([finding.time], [0.93 - 0.17 * level], transform=panel.get_xaxis_transform(),
                   **_marker(finding.kind), clip_on=False, zorder=5.0)  # fmt: skip
        if finding.kind not in kinds:
            kinds.append(finding.kind)
    return kinds


def _marker(kind: str) -> dict[str, Any]:
    return {
        "marker": _MARKERS.get(kind, "o"), "markersize": 4.6, "markeredgewidth": 0.5,
        "markeredgecolor": "white", "color": FAULT, "linestyle": "none",
        "label": f"{kind.replace('_', ' ')} found",
    }  # fmt: skip


def _legend(
    log: RunLog,
    chosen: Sequence[tuple[str, int]],
    spans: Sequence[Span],
    kinds: Sequence[str],
    *,
    has_limit: bool,
) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    robots = {robot for robot, _ in chosen}
    handles: list[Any] = []
    if any(log.has(robot, "commanded_torques") for robot in robots):
        handles.append(Line2D([], [], color=ORANGE, linewidth=1.0, label="commanded"))
    if any(log.has(robot, "torques") for robot in robots):
        handles.append(Line2D([], [], color=BLUE, linewidth=1.5, label="measured"))
    if has_limit:
        handles.append(Line2D([], [], color=INK, linewidth=0.8, linestyle=(0, (4, 2)),
                              label="limit"))  # fmt: skip
    if any(not span.is_fault for span in spans):
        handles.append(Patch(color=GREY, alpha=0.25, linewidth=0.0, label="disturbance"))
    if any(span.is_fault for span in spans):
        handles.append(Patch(color=FAULT, alpha=0.25, linewidth=0.0, label="fault"))
    handles += [Line2D([], [], **_marker(kind)) for kind in kinds]
    return handles
