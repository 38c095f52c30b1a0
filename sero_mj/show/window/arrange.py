"""Who gets which part of a window: picture, plots, bar and time line do not cover each other."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco

_PLOT_SHARE = 0.34  # of the width, for plots beside the picture
_STRIP_SHARE = 0.36  # of the height, for a plot below it, where the window is narrow
_NARROW = 46.0  # lines of text; a window less wide has its plot below the picture
_LEAST_STRIP = 10.0  # lines of text, high
_LEAST_PLOT = 20.0  # lines of text, wide


@dataclass(frozen=True)
class Layout:
    """The parts of a window.

    Attributes:
        picture: of the scene.
        plots: one below the other; none, one or two.
        line_bottom: lower edge of the strip with the time line, pixels.
        bar: height of the status line, pixels; 0 where there is none.
    """

    picture: mujoco.MjrRect
    plots: list[mujoco.MjrRect] = field(default_factory=list)
    line_bottom: int = 0
    bar: int = 0


def arrange(
    size: tuple[int, int], text: int, *, bar: int = 0, line: int = 0, has_plot: bool = False
) -> Layout:
    """Divides a window.

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
