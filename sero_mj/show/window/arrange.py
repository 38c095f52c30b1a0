"""Divides a window into picture, plots, status line and time line."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco

_PLOT_SHARE = 0.34  # fraction of the width for plots beside the picture
_STRIP_SHARE = 0.36  # fraction of the height for a plot below the picture, in a narrow window
_NARROW = 46.0  # line heights; in a narrower window the plot is below the picture
_LEAST_STRIP = 10.0  # minimum height, line heights
_LEAST_PLOT = 20.0  # minimum width, line heights


@dataclass(frozen=True)
class Layout:
    """The parts of a window.

    Attributes:
        picture: of the scene.
        plots: from top to bottom; none, one or two.
        line_bottom: lower edge of the time line's area, pixels.
        bar: height of the status line, pixels; 0 for none.
    """

    picture: mujoco.MjrRect
    plots: list[mujoco.MjrRect] = field(default_factory=list)
    line_bottom: int = 0
    bar: int = 0


def arrange(
    size: tuple[int, int], text: int, *, bar: int = 0, line: int = 0, has_plot: bool = False
) -> Layout:
    """Returns the layout of a window.

    Args:
        size: of the window, pixels.
        text: height of a line of text, pixels.
        bar: height of the status line, pixels; 0 for none.
        line: height of the time line, pixels; 0 for none.
        has_plot: whether plots are shown.
    """
    width, bottom = size[0], bar + line
    height = max(size[1] - bottom, 1)
    if not has_plot:
        return Layout(mujoco.MjrRect(0, bottom, width, height), [], bar, bar)
    if width < _NARROW * text:
        strip = round(min(max(_STRIP_SHARE * height, _LEAST_STRIP * text), 0.5 * height))
        picture = mujoco.MjrRect(0, bottom + strip, width, max(height - strip, 1))
        return Layout(picture, [mujoco.MjrRect(0, bottom, width, strip)], bar, bar)
    beside = round(max(_PLOT_SHARE * width, _LEAST_PLOT * text))
    left, lower = width - beside, height // 2
    plots = [
        mujoco.MjrRect(left, bottom + lower, beside, height - lower),
        mujoco.MjrRect(left, bottom, beside, lower),
    ]
    return Layout(mujoco.MjrRect(0, bottom, left, height), plots, bar, bar)
