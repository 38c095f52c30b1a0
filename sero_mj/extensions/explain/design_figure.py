"""Draws a designed motion: angles, velocities and torques of each joint with their limits."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...study.compare import one_unit, unit_of
from ...study.figure import BLUE, FAULT, Figure, check_suffix, drawn_name, save_figures, styled
from .excitation import Excitation

_STEP = 0.005  # s, time between rows


def plot_excitation(found: Excitation, path: Path | str) -> None:
    """Draws one period of a motion.

    Raises:
        RenderError: the file cannot be written.
        UsageError: the suffix is wrong, or matplotlib is missing.
    """
    path = check_suffix(path)
    from matplotlib.lines import Line2D

    robot, limits, free = (
        found.regressor.robot,
        found.limits,
        found.regressor.robot.coupled.independent,
    )
    times = np.arange(0.0, found.series.period + 0.5 * _STEP, _STEP)
    motion, torques, used = found.motion(times), found.torques(times), found.used(times)
    revolute = robot.kinematics.revolute[free]
    factors = np.where(revolute, np.rad2deg(1.0), 1.0)
    angle, speed = ("deg", "deg/s") if revolute.all() else ("deg or m", "deg/s or m/s")
    unit = one_unit(unit_of("torques", robot.types[i]) for i in free) or "Nm or N"
    both = np.array([-1.0, 1.0])
    with styled():
        figure = Figure(
            [(drawn_name(name, k), "") for k, name in enumerate(limits.names)],
            [(f"position, {angle}", 1.0), (f"velocity, {speed}", 1.0), (f"torque, {unit}", 1.0)],
            title=f"{robot.name}: motion for identification",
            subtitle=f"condition number {found.condition()[0]:.3g}; bounds are "
            f"{limits.share:.0%} of the limits",
            times=(0.0, found.series.period),
        )  # fmt: skip
        for k, panels in enumerate(figure.axes):
            curves = {
                "position": (motion.angles[:, free[k]] * factors[k],
                             limits.positions[k] * factors[k]),
                "velocity": (motion.velocities[:, free[k]] * factors[k],
                             both * limits.velocities[k] * factors[k]),
                "torque": (torques @ limits.coupling[:, k], both * limits.torques[k]),
            }  # fmt: skip
            for panel, (kind, (values, bounds)) in zip(panels, curves.items(), strict=True):
                figure.line(panel, times, values, "motion", color=BLUE, linewidth=1.0)
                known = [float(each) for each in bounds if np.isfinite(each)]
                for each in known:
                    panel.axhline(each, color=FAULT, linewidth=0.7, linestyle="--")
                if known:
                    share = limits.share * used[kind][:, k].max()
                    of = "half the range" if kind == "position" else "the limit"
                    figure.note(panel, f"{share:.0%} of {of}")
                figure.fit(panel, [values], least=np.inf, floor=1e-3, also=known)
        figure.legend([
            Line2D([], [], color=BLUE, linewidth=1.0, label="motion"),
            Line2D([], [], color=FAULT, linewidth=0.7, linestyle="--", label="bound"),
        ])  # fmt: skip
        save_figures([figure], path)
