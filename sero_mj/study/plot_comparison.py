"""Two runs as a figure: both torques, and how torques and angles differ, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError, did_you_mean
from ..runs.run_log import RunLog
from .align import Pair, align
from .compare import unit_of
from .figure import BLUE, MIN_SHARE, ORANGE, Figure, check_suffix, styled
from .reduction import peak, rms

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

_MIN_TORQUE = 0.2  # Nm that a panel shows at least, where there is no limit
_MIN_ANGLE = 0.02  # deg or mm


def plot_comparison(
    a: RunLog,
    b: RunLog,
    path: Path | str,
    *,
    robot: str | None = None,
    offset: float | Literal["auto"] = 0.0,
    joints: Sequence[str] | None = None,
    size_mm: tuple[float, float] | None = None,
) -> None:
    """Aligns two runs of a robot and draws them.

    Args:
        a: a run.
        b: another one.
        path: where to: .png (300 dpi), .pdf or .svg.
        robot: see `align`.
        offset: s, added to the times of `b`, or `auto`; see `align`.
        joints: their names; all when None.
        size_mm: width and height; the width of A4 when None.

    Raises:
        RenderError: the file cannot be written.
        UsageError: see `align` and `plot_pair`.
    """
    check_suffix(path)
    plot_pair(align(a, b, robot, offset), path, joints=joints, size_mm=size_mm)


def plot_pair(
    pair: Pair,
    path: Path | str,
    *,
    joints: Sequence[str] | None = None,
    size_mm: tuple[float, float] | None = None,
) -> None:
    """Draws two runs: a row for each joint, with both torques and the differences, A less B.

    Without torques in both, angles stand in their place.

    Args:
        pair: the runs on one clock.
        path: where to: .png (300 dpi), .pdf or .svg.
        joints: their names; all when None.
        size_mm: width and height; the width of A4 when None.

    Raises:
        RenderError: the file cannot be written.
        UsageError: no such joint, another suffix.
    """
    path = check_suffix(path)
    names = pair.robot.names
    for joint in joints or ():
        if joint not in names:
            near = did_you_mean(joint, names)
            raise UsageError(f"no joint '{joint}' of {pair.robot.name}{near}")
    chosen = [k for k, joint in enumerate(names) if joints is None or joint in joints]
    main = "torques" if "torques" in pair.signals else "joint_angles"
    units = dict.fromkeys(_shown(main, pair.robot.types[k])[1] for k in chosen)
    angles = dict.fromkeys(_shown("joint_angles", pair.robot.types[k])[1] for k in chosen)
    what, unit, unit_of_angle = (
        main.removesuffix("s").removeprefix("joint_"),
        " or ".join(units),
        " or ".join(angles),
    )
    columns = [(f"{what}, {unit}", 1.35), (f"{what}, A − B, {unit}", 1.0)]
    if main == "torques" and "joint_angles" in pair.signals:
        columns.append((f"angle, A − B, {unit_of_angle}", 1.0))
    with styled():
        figure = Figure(
            [(names[k], _beneath(pair, k)) for k in chosen],
            columns,
            title=f"{pair.names[0]} − {pair.names[1]}",
            subtitle=_about(pair),
            times=(float(pair.times[0]), float(pair.times[-1])),
            size_mm=size_mm,
        )
        for k, panels in zip(chosen, figure.axes, strict=True):
            _draw_both(figure, panels[0], pair, main, k)
            _draw_difference(figure, panels[1], pair, main, k)
            if len(panels) > 2:
                _draw_difference(figure, panels[2], pair, "joint_angles", k)
        figure.legend(_legend(pair))
        figure.save(path)


def _shown(signal: str, joint_type: str) -> tuple[float, str]:
    """Factor and unit on paper: angles in degrees, lengths in mm."""
    unit = unit_of(signal, joint_type)
    return {"rad": (float(np.rad2deg(1.0)), "deg"), "m": (1e3, "mm")}.get(unit, (1.0, unit))


def _beneath(pair: Pair, k: int) -> str:
    limits = pair.robot.torque_limits
    if limits is None or "torques" not in pair.signals:
        return pair.robot.name
    return f"limit {limits[k]:.4g} {unit_of('torques', pair.robot.types[k])}"


def _about(pair: Pair) -> str:
    span = f"{pair.robot.name}, {pair.times[-1] - pair.times[0]:.4g} s"
    return f"{span}; B moved by {pair.offset:+.4g} s" if pair.offset else span


def _least(pair: Pair, signal: str, k: int) -> tuple[float, float]:
    """How much a panel shows at least, and that without limits."""
    if signal == "joint_angles":
        return np.inf, _MIN_ANGLE
    limits = pair.robot.torque_limits
    return (np.inf if limits is None else MIN_SHARE * float(limits[k])), _MIN_TORQUE


def _draw_both(figure: Figure, panel: Axes, pair: Pair, signal: str, k: int) -> None:
    factor, _ = _shown(signal, pair.robot.types[k])
    a, b = factor * pair.a[signal][:, k], factor * pair.b[signal][:, k]
    figure.line(panel, pair.times, b, "b", color=BLUE, linewidth=1.5, zorder=2.0)
    figure.line(panel, pair.times, a, "a", color=ORANGE, linewidth=0.7, zorder=2.1)
    least, floor = _least(pair, signal, k)
    figure.fit(panel, [a, b], least=least, floor=floor)


def _draw_difference(figure: Figure, panel: Axes, pair: Pair, signal: str, k: int) -> None:
    factor, _ = _shown(signal, pair.robot.types[k])
    values = factor * pair.difference(signal)[:, k]
    figure.signed_area(panel, pair.times, values, "difference")
    least, floor = _least(pair, signal, k)
    if figure.fit(panel, [values], least=0.5 * least, floor=floor, also=[0.0]):
        row = peak(values)
        assert row is not None  # `fit` has found something
        text = f"peak {values[row]:+.3g}".replace("-", "−")
        figure.note(panel, f"{text}, rms {rms(values):.3g}")


def _legend(pair: Pair) -> list[Any]:
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], color=ORANGE, linewidth=1.0, label=f"A: {pair.names[0]}"),
        Line2D([], [], color=BLUE, linewidth=1.5, label=f"B: {pair.names[1]}"),
    ]
