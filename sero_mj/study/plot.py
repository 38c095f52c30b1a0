"""Plots torques, limits and errors of each joint, for one run or two runs of a robot."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import Problem, UsageError
from ..base.frames import Array
from ..base.reduction import peak, rms
from ..simulate.runs.run_log import RunLog, compared_signal, torque_error
from .align import Pair
from .compare import differ_most, shown_units
from .evidence_plot import PER_PAGE, draw_evidence, height_of, with_evidence
from .explanation import Explanation
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
    drawn_name,
    save_figures,
    styled,
)  # fmt: skip

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..simulate.runs.monitor import Finding
    from ..simulate.scenario import Scenario


_LIMIT_SHARE = 0.6  # share of the limit above which a panel also shows the limit
_MIN_TORQUE = 0.2  # minimum range of a panel without a limit, Nm or the torque unit of the robot
_MIN_ANGLE = 0.02  # minimum range of a panel, deg or mm
_MARKERS = {
    "torque_error": "v",
    "external_torque": "D",
    "position_error": "s",
    "frozen_torque": "*",
    "saturated": "^",
    "velocity_limit": ">",
    "position_limit": "<",
}
_MAX_ROWS = 12  # maximum number of joints per page, unless joints or a size are requested
# Marks closer than this share of the time are stacked in up to this number of levels.
_CLOSE, _LEVELS = 0.1, 5
_Joint = tuple[str, int]  # robot, index of the joint
_ERROR_FINDINGS = ("torque_error", "frozen_torque")  # findings marked in the panel of the error


def plot_run(
    logs: RunLog | Sequence[RunLog],
    path: Path | str,
    *,
    robots: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    findings: Sequence[Finding] = (),
    spans: Sequence[Span] = (),
    size_mm: tuple[float, float] | None = None,
) -> None:
    """Draws runs with one row per joint: torques on the left, torque errors on the right.

    Lines are envelopes, so every peak is visible even with a million rows.

    Args:
        logs: a run with `torques`, `commanded_torques` or both, or several runs, which become pages
            of a .pdf. A .pdf shows 12 joints per page. Other formats show the 12 joints with the
            largest torques relative to their limits.
        path: output file: .png (300 dpi), .pdf or .svg.
        robots: names of the robots; None for all robots.
        joints: names of the joints of these robots; None for all joints.
        findings: findings of the monitor, which are marked at the joints.
        spans: events to draw as bands, such as those from `spans_of`.
        size_mm: width and height of the figure, mm; None for the width of A4.

    Raises:
        RenderError: the file cannot be written.
        UsageError: a robot, joint or signal does not exist, the suffix is wrong, or there are
            several runs and the file is not a .pdf.
    """
    path = check_suffix(path)
    with styled():
        figures = []
        for log in [logs] if isinstance(logs, RunLog) else logs:
            chosen = _choose(log, robots, joints)
            pages = [chosen]
            if len(chosen) > _MAX_ROWS and joints is None and size_mm is None:
                is_pdf = path.suffix.lower() == ".pdf"
                pages = _by_robots(chosen) if is_pdf else [_most_loaded(log, chosen)]
            figures += [
                _draw_run(log, page, findings, spans, size_mm, len(chosen)) for page in pages
            ]
        save_figures(figures, path)


def _by_robots(chosen: Sequence[_Joint]) -> list[list[_Joint]]:
    # Joints of a robot stay on one page if they fit.
    pages: list[list[_Joint]] = [[]]
    for _, group in groupby(chosen, key=lambda each: each[0]):
        joints = list(group)
        if len(pages[-1]) + len(joints) > _MAX_ROWS and pages[-1]:
            pages.append([])
        for joint in joints:
            if len(pages[-1]) == _MAX_ROWS:
                pages.append([])
            pages[-1].append(joint)
    return pages


def _most_loaded(log: RunLog, chosen: Sequence[_Joint]) -> list[_Joint]:
    peaks, limits = np.zeros((2, len(chosen)))
    for i, (robot, k) in enumerate(chosen):
        limits[i] = log.torque_limits(robot)[k]
        for signal in ("torques", "commanded_torques"):
            if log.has(robot, signal):
                values = np.abs(log.of(robot, signal)[:, k])
                peaks[i] = max(peaks[i], np.nanmax(values, initial=0.0))
    shares = peaks / np.where(np.isfinite(limits), limits, max(peaks.max(), 1e-9))
    return [chosen[i] for i in np.sort(np.argsort(-shares, kind="stable")[:_MAX_ROWS])]


def _draw_run(
    log: RunLog,
    chosen: Sequence[_Joint],
    findings: Sequence[Finding],
    spans: Sequence[Span],
    size_mm: tuple[float, float] | None,
    count: int,
) -> Figure:
    has_both = all(log.has(robot, signal) for robot, _ in chosen
                   for signal in ("torques", "commanded_torques"))  # fmt: skip
    several = len({robot for robot, _ in chosen}) > 1
    rows = [(drawn_name(log.robots[robot].names[k], k), _beneath(log, robot, k, named=several))
            for robot, k in chosen]  # fmt: skip
    units = list(dict.fromkeys(log.robots[robot].torque_units[k].name for robot, k in chosen))
    unit = " or ".join(units)
    columns = [(f"torque, {unit}", 1.25)]
    if has_both:
        columns.append((f"torque error, {unit}", 1.0))
    figure = Figure(
        rows,
        columns,
        title=log.name,
        subtitle=_about(log, has_both=has_both) + _left_out(len(chosen), count),
        times=(float(log.times[0]), float(log.times[-1])),
        size_mm=size_mm,
    )
    for (robot, k), panels in zip(chosen, figure.axes, strict=True):
        _draw_torques(figure, panels[0], log, robot, k)
        if has_both:
            factor, own = log.robots[robot].torque_units[k]
            own = f" {own}" if len(units) > 1 else ""
            error = factor * torque_error(log, robot)[:, k]
            least = MIN_SHARE * factor * log.torque_limits(robot)[k]
            row = _draw_difference(figure, panels[1], log.times, error, 0.5 * least)
            if row is not None:
                at = f"at {log.times[row]:.3f} s, rms {rms(error):.3g}{own}"
                figure.note(panels[1], f"{_signed(error[row])}{own} {at}")
    figure.spans(spans)
    marked = _mark(figure, log, chosen, findings)
    has_limit = any(line.get_label() == "limit" for panels in figure.axes
                    for line in panels[0].lines)  # fmt: skip
    figure.legend(_legend(log, chosen, spans, marked, has_limit=has_limit))
    return figure


def spans_of(scenario: Scenario) -> list[Span]:
    """Returns the disturbances and faults of a scenario as bands for figures."""
    spans = [Span(name, each.begin, each.end) for name, each in scenario.disturbances.items()]
    spans += [Span(name, each.begin, each.end, True) for name, each in scenario.faults.items()]
    return spans


def _choose(
    log: RunLog, robots: Sequence[str] | None, joints: Sequence[str] | None
) -> list[tuple[str, int]]:
    for name in robots or ():
        if name not in log.robots:
            where, known = f"in {log.name}", log.robots
            raise UsageError(Problem("", "no robot", found=name, of=where, available=known))
    if robots is None:  # all robots with torques
        signals = ("torques", "commanded_torques")
        robots = [robot for robot in log.robots if any(log.has(robot, each) for each in signals)]
    wanted = list(robots) or list(log.robots)
    names = [joint for robot in wanted for joint in log.robots[robot].names]
    for joint in joints or ():
        if joint not in names:
            where = f"in {log.name}"
            raise UsageError(Problem("", "no joint", found=joint, of=where, available=names))
    for robot in wanted:
        if not (log.has(robot, "torques") or log.has(robot, "commanded_torques")):
            found = f"has no torques of robot '{robot}'"
            expected = "torques or commanded_torques"
            raise UsageError(Problem(f"run {log.name}", found, expected=expected))
    chosen = [(robot, k) for robot in wanted for k, joint in enumerate(log.robots[robot].names)
              if joints is None or joint in joints]  # fmt: skip
    if not chosen or len(log.times) == 0:
        raise UsageError(f"run {log.name} has nothing to plot")
    return chosen


def _beneath(log: RunLog, robot: str, k: int, *, named: bool) -> str:
    limit = float(log.torque_limits(robot)[k])
    lines = [robot] if named else []
    if np.isfinite(limit):
        factor, unit = log.robots[robot].torque_units[k]
        lines.append(f"limit {factor * limit:.4g} {unit}")
    signal = "torques" if log.has(robot, "torques") else "commanded_torques"
    values = log.of(robot, signal)[:, k]
    row = peak(values)
    if np.isfinite(limit) and row is not None:
        lines.append(f"peak {100.0 * abs(values[row]) / limit:.0f} %")
    return "\n".join(lines)


def _left_out(shown: int, count: int) -> str:
    return f"; {shown} of {count} joints" if shown < count else ""


def _about(log: RunLog, *, has_both: bool) -> str:
    rows = f"{len(log.times):,} rows".replace(",", " ")
    span = f"{log.times[-1] - log.times[0]:.4g} s, {rows}"
    return f"{span}; error is commanded minus measured" if has_both else span


def _draw_torques(figure: Figure, panel: Axes, log: RunLog, robot: str, k: int) -> None:
    factor, _ = log.robots[robot].torque_units[k]
    limit = factor * float(log.torque_limits(robot)[k])
    curves = []
    for signal, look in (
        ("torques", {"color": BLUE, "linewidth": 1.5, "zorder": 2.0}),
        ("commanded_torques", {"color": ORANGE, "linewidth": 0.7, "zorder": 2.1}),
    ):
        if log.has(robot, signal):
            values = factor * compared_signal(log, robot, signal)[:, k]
            figure.line(panel, log.times, values, signal, **look)
            curves.append(values)
    shown: list[float] = []
    known = np.concatenate(curves)
    known = known[np.isfinite(known)]
    if np.isfinite(limit):  # shown if torques come near to it
        shown = [side * limit for side in (-1.0, 1.0) if len(known)
                 and (side * known).max() >= _LIMIT_SHARE * limit]  # fmt: skip
        for bound in shown:
            panel.axhline(bound, color=INK, linewidth=0.8, linestyle=(0, (4, 2)), label="limit")
    figure.fit(panel, curves, least=MIN_SHARE * limit, floor=_MIN_TORQUE, also=shown)


def _draw_difference(
    figure: Figure,
    panel: Axes,
    times: Array,
    values: Array,
    least: float,
    floor: float = _MIN_TORQUE,
) -> int | None:
    figure.signed_area(panel, times, values)
    is_known = figure.fit(panel, [values], least=least, floor=floor, also=[0.0])
    return peak(values) if is_known else None


def _signed(value: float) -> str:
    return f"peak {value:+.3g}".replace("-", "−")


def _mark(
    figure: Figure, log: RunLog, chosen: Sequence[tuple[str, int]], findings: Sequence[Finding]
) -> list[str]:
    rows = {(robot, log.robots[robot].names[k]): i for i, (robot, k) in enumerate(chosen)}
    kinds: list[str] = []
    marked: dict[Axes, list[float]] = {}
    close = _CLOSE * float(log.times[-1] - log.times[0])
    for finding in findings:
        row = rows.get((finding.robot, finding.joint))
        if row is None:
            continue
        panels = figure.axes[row]
        panel = panels[-1] if finding.kind in _ERROR_FINDINGS else panels[0]
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
        "label": f"{kind.replace('_', ' ')} detected",
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


def plot_pair(
    pair: Pair,
    path: Path | str,
    *,
    joints: Sequence[str] | None = None,
    explanations: Sequence[Explanation] = (),
    size_mm: tuple[float, float] | None = None,
) -> None:
    """Draws two runs with one row per joint: the torques, and the differences A minus B.

    If torques are not in both runs, angles are shown instead.

    Args:
        pair: the aligned runs.
        path: output file: .png (300 dpi), .pdf or .svg.
        joints: names of the joints; None for all joints, or for the joints that differ most if the
            robot has many joints.
        explanations: explanations of the differences, which are marked at the start times. Their
            evidence follows on further pages of a .pdf, or below the joints in other formats, which
            show the six most confident explanations.
        size_mm: width and height of the figure, mm; None for the width of A4.

    Raises:
        RenderError: the file cannot be written.
        UsageError: a joint does not exist, or the suffix is wrong.
    """
    path = check_suffix(path)
    names = pair.robot.names
    for joint in joints or ():
        if joint not in names:
            where = f"of {pair.robot.name}"
            raise UsageError(Problem("", "no joint", found=joint, of=where, available=names))
    shown = differ_most(pair) if joints is None else joints
    chosen = [k for k, joint in enumerate(names) if joint in shown]
    main = "torques" if "torques" in pair.signals else "joint_angles"
    units = dict.fromkeys(shown_units(pair.robot, main)[k][1] for k in chosen)
    angles = dict.fromkeys(shown_units(pair.robot, "joint_angles")[k][1] for k in chosen)
    what, unit, unit_of_angle = (
        main.removesuffix("s").removeprefix("joint_"),
        " or ".join(units),
        " or ".join(angles),
    )
    columns = [(f"{what}, {unit}", 1.35), (f"{what}, A − B, {unit}", 1.0)]
    if main == "torques" and "joint_angles" in pair.signals and not pair.has_one_motion:
        columns.append((f"angle, A − B, {unit_of_angle}", 1.0))
    shown_evidence = with_evidence(explanations)
    pages = [shown_evidence[k : k + PER_PAGE] for k in range(0, len(shown_evidence), PER_PAGE)]
    # Only .pdf files have several pages.
    below = [] if path.suffix.lower() == ".pdf" else (pages[0] if pages else [])
    with styled():
        figure = Figure(
            [(drawn_name(names[k], k), _beneath_pair(pair, k)) for k in chosen],
            columns,
            title=f"{pair.names[0]} − {pair.names[1]}",
            subtitle=_about_pair(pair) + _left_out(len(chosen), len(names)),
            times=(float(pair.times[0]), float(pair.times[-1])),
            size_mm=size_mm,
            below=height_of(below),
        )
        for k, panels in zip(chosen, figure.axes, strict=True):
            _draw_both(figure, panels[0], pair, main, k)
            _draw_difference_of_pair(figure, panels[1], pair, main, k)
            if len(panels) > 2:
                _draw_difference_of_pair(figure, panels[2], pair, "joint_angles", k)
            _explain(figure, panels[1], [each for each in explanations if names[k] in each.joints])
        figure.legend(_legend_of_pair(pair))
        if below:
            draw_evidence(figure, below)
        figures = [figure, *(_evidence_page(pair, page) for page in pages if not below)]
        save_figures(figures, path)


def _evidence_page(pair: Pair, explanations: Sequence[Explanation]) -> Figure:
    times = float(pair.times[0]), float(pair.times[-1])
    figure = Figure([], [], title=f"{pair.names[0]} − {pair.names[1]}: evidence", times=times,
                    subtitle=_about_pair(pair), below=height_of(explanations))  # fmt: skip
    draw_evidence(figure, explanations)
    return figure


def _explain(figure: Figure, panel: Axes, explanations: Sequence[Explanation]) -> None:
    begin, end = panel.get_xlim()
    for level, each in enumerate(explanations[:3]):
        left = begin if each.from_start else each.begin
        panel.axvspan(left, end if each.end is None else each.end, color=FAULT, alpha=0.10,
                      linewidth=0.0, zorder=0.5)  # fmt: skip
        panel.axvline(left, color=FAULT, linewidth=0.7, zorder=0.6)
        on_the_left = left < begin + 0.5 * (end - begin)
        panel.annotate(
            each.short, (left, 0.0), (2.0 if on_the_left else -2.0, 2.0 + 6.5 * level),
            xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=5.5,
            color=FAULT, ha="left" if on_the_left else "right", va="bottom", zorder=5.0,
            bbox={"facecolor": "white", "alpha": 0.75, "linewidth": 0.0, "pad": 0.6},
        )  # fmt: skip


def _beneath_pair(pair: Pair, k: int) -> str:
    limits = pair.robot.torque_limits
    if limits is None or "torques" not in pair.signals:
        return pair.robot.name
    factor, unit = pair.robot.torque_units[k]
    return f"limit {factor * limits[k]:.4g} {unit}"


def _about_pair(pair: Pair) -> str:
    span = f"{pair.robot.name}, {pair.times[-1] - pair.times[0]:.4g} s"
    return f"{span}; B shifted by {pair.offset:+.4g} s" if pair.offset else span


def _least(pair: Pair, signal: str, k: int) -> tuple[float, float]:
    if signal == "joint_angles":
        return np.inf, _MIN_ANGLE
    factor, _ = pair.robot.torque_units[k]
    return MIN_SHARE * factor * float(pair.robot.torque_bounds[k]), _MIN_TORQUE


def _draw_both(figure: Figure, panel: Axes, pair: Pair, signal: str, k: int) -> None:
    factor, _ = shown_units(pair.robot, signal)[k]
    a, b = factor * pair.a[signal][:, k], factor * pair.b[signal][:, k]
    figure.line(panel, pair.times, b, "b", color=BLUE, linewidth=1.5, zorder=2.0)
    figure.line(panel, pair.times, a, "a", color=ORANGE, linewidth=0.7, zorder=2.1)
    least, floor = _least(pair, signal, k)
    figure.fit(panel, [a, b], least=least, floor=floor)


def _draw_difference_of_pair(figure: Figure, panel: Axes, pair: Pair, signal: str, k: int) -> None:
    factor, _ = shown_units(pair.robot, signal)[k]
    values = factor * pair.difference(signal)[:, k]
    least, floor = _least(pair, signal, k)
    row = _draw_difference(figure, panel, pair.times, values, 0.5 * least, floor)
    if row is not None:
        figure.note(panel, f"{_signed(values[row])}, rms {rms(values):.3g}")


def _legend_of_pair(pair: Pair) -> list[Any]:
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], color=ORANGE, linewidth=1.0, label=f"A: {pair.names[0]}"),
        Line2D([], [], color=BLUE, linewidth=1.5, label=f"B: {pair.names[1]}"),
    ]
