"""What is in a window besides its picture: status line, time line, messages, help."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco

from ..decor.font import Font
from ..session.status_line import Mood, Piece
from ..typesetting import Placed, Rgb, Rgba, Text
from .glfw_window import GlWindow

BAR: Rgba = (0.07, 0.09, 0.12, 1.0)
PANEL: Rgba = (0.07, 0.09, 0.12, 0.92)
HELP: Rgba = (0.07, 0.09, 0.12, 0.96)
HANDLE: Rgba = (0.07, 0.09, 0.12, 0.55)
BAD: Rgba = (0.45, 0.07, 0.06, 0.95)
_TRACK: Rgba = (0.22, 0.26, 0.31, 1.0)
_DONE: Rgba = (0.26, 0.56, 0.82, 1.0)
_HANDLE: Rgba = (0.93, 0.95, 0.97, 1.0)
_MARK: Rgba = (1.0, 0.72, 0.30, 1.0)
_FAULT: Rgba = (0.92, 0.32, 0.26, 1.0)
_RED: Rgba = (0.92, 0.22, 0.18, 1.0)
TITLE: Rgb = (1.0, 0.72, 0.30)
DIM = (0.60, 0.65, 0.71)
TEXT = (0.90, 0.92, 0.94)
MOODS: dict[Mood, Rgb] = {
    "good": (0.55, 0.85, 0.62),
    "quiet": (0.95, 0.80, 0.40),
    "bad": (1.00, 0.52, 0.40),
    "plain": (0.80, 0.84, 0.88),
}
_PAD = 0.45  # of a line's height
_HELP_LINE = 1.08  # of a line's height
_HELP_COLUMN = 27.0  # of a line's height, wide
_GAP = 1.6  # gap between parts of the status line, of a line's height
_PLOT_SHARE = 0.34  # fraction of the width for plots beside the picture
_STRIP_SHARE = 0.36  # fraction of the height for a plot below the picture, in a narrow window
_NARROW = 46.0  # line heights; in a narrower window the plot is below the picture
_LEAST_STRIP = 10.0  # minimum height, line heights
_LEAST_PLOT = 20.0  # minimum width, line heights


def arrange(
    size: tuple[int, int], text: int, bottom: int, *, has_plot: bool
) -> tuple[mujoco.MjrRect, list[mujoco.MjrRect]]:
    """Returns the places of the picture and of the plots, from top to bottom: none, one or two.

    Args:
        size: of the window, pixels.
        text: height of a line of text, pixels.
        bottom: height of status line and time line, pixels.
        has_plot: whether plots are shown.
    """
    width, height = size[0], max(size[1] - bottom, 1)
    if not has_plot:
        return mujoco.MjrRect(0, bottom, width, height), []
    if width < _NARROW * text:
        strip = round(min(max(_STRIP_SHARE * height, _LEAST_STRIP * text), 0.5 * height))
        picture = mujoco.MjrRect(0, bottom + strip, width, max(height - strip, 1))
        return picture, [mujoco.MjrRect(0, bottom, width, strip)]
    beside = round(max(_PLOT_SHARE * width, _LEAST_PLOT * text))
    left, lower = width - beside, height // 2
    upper = mujoco.MjrRect(left, bottom + lower, beside, height - lower)
    plots = [upper, mujoco.MjrRect(left, bottom, beside, lower)]
    return mujoco.MjrRect(0, bottom, left, height), plots


@dataclass(frozen=True)
class TimeLine:
    """Geometry of the time line, in pixels from the lower left corner of the window.

    Attributes:
        left: left edge.
        bottom: lower edge.
        width: of the whole bar.
        height: of the bar.
        end: the time at its right end, s.
        begin: the time at its left end, s.
    """

    left: float
    bottom: float
    width: float
    height: float
    end: float
    begin: float = 0.0

    def hits(self, x: float, y: float) -> bool:
        """Whether a press at a pixel is on the bar, with a margin of its height."""
        inside = self.left - self.height <= x <= self.left + self.width + self.height
        return inside and self.bottom - self.height <= y <= self.bottom + 2 * self.height

    def time_at(self, x: float) -> float:
        """Returns the time at a pixel, s, limited to the ends."""
        share = (x - self.left) / max(self.width, 1.0)
        return self.begin + min(max(share, 0.0), 1.0) * (self.end - self.begin)

    def x_of(self, time: float) -> float:
        """Returns the pixel of a time, s."""
        span = self.end - self.begin
        share = min(max((time - self.begin) / span, 0.0), 1.0) if span > 0 else 0.0
        return self.left + share * self.width


class Hud:
    """Draws panels and text in pixels from the lower left corner of the window."""

    def __init__(self, window: GlWindow) -> None:
        self._window = window

    @property
    def font(self) -> Font:
        """Font of all text."""
        return self._window.typesetter.font

    @property
    def bar_height(self) -> int:
        """Height of the status line, pixels."""
        return round(self.font.height * (1 + 2 * 0.3))

    @property
    def line_height(self) -> int:
        """Height of the time line's area, pixels."""
        return round(self.font.height * 1.3)

    def box(self, left: float, bottom: float, width: float, height: float, rgba: Rgba) -> None:
        """Fills a rectangle."""
        rect = mujoco.MjrRect(round(left), round(bottom), round(width), round(height))
        mujoco.mjr_rectangle(rect, *rgba)

    def panel(
        self,
        rect: tuple[float, float, float, float],
        texts: Sequence[Text],
        rgba: Rgba = PANEL,
        *,
        is_round: bool = True,
    ) -> None:
        """Draws a panel with text.

        Args:
            rect: left, bottom, width, height.
            texts: in the panel.
            rgba: of the panel.
            is_round: whether it has round corners.
        """
        left, bottom, width, height = map(round, rect)
        pixels = self._window.typesetter.panel((width, height), rgba, tuple(texts), is_round)
        self._window.blender.draw([Placed(left, bottom, pixels)])

    def status(self, pieces: Sequence[Piece], hint: str, width: int) -> None:
        """Draws the status line, without the parts that do not fit.

        Args:
            pieces: parts, the most important first.
            hint: text at the right end, if it fits.
            width: of the window, pixels.
        """
        h, base = self.font.height, (self.bar_height - self.font.height) / 2
        x, lines = _PAD * h, list[Text]()
        right = width - self.font.width(hint) - _PAD * h
        for text, mood in pieces:
            wide = self.font.width(text.encode("ascii", "replace"))
            if x + wide > width - _PAD * h:
                break
            lines.append(Text(x, base, text, MOODS[mood]))
            x += wide + _GAP * h
        if x < right:
            lines.append(Text(right, base, hint, DIM))
        self.panel((0, 0, width, self.bar_height), lines, BAR, is_round=False)

    def time_line(self, width: int, begin: float, end: float) -> TimeLine:
        """Returns the geometry of the time line in a window of that width; its ends in s."""
        h = self.font.height
        return TimeLine(h, self.bar_height + 0.5 * h, width - 2 * h, round(0.3 * h), end, begin)

    def draw_time_line(
        self, line: TimeLine, time: float, width: int, ticks: Sequence[tuple[float, bool]] = ()
    ) -> None:
        """Draws the time line and its handle.

        Args:
            line: where it is.
            time: of the handle, s.
            width: of the window, pixels.
            ticks: times, s, that are marked, and whether the user did; else they are faults.
        """
        self.box(0, self.bar_height, width, self.line_height, BAR)
        x = line.x_of(time)
        self.box(line.left, line.bottom, line.width, line.height, _TRACK)
        self.box(line.left, line.bottom, x - line.left, line.height, _DONE)
        half, wide = 0.8 * line.height, max(0.35 * line.height, 2.0)
        for when, is_mark in ticks:
            at = line.x_of(when) - wide / 2
            self.box(at, line.bottom - half, wide, line.height + 2 * half,
                     _MARK if is_mark else _FAULT)  # fmt: skip
        self.box(x - half, line.bottom - half, 2 * half, line.height + 2 * half, _HANDLE)

    def message(
        self, text: str, rect: mujoco.MjrRect, *, covered: float = 0.0, is_bad: bool = False
    ) -> None:
        """Shows a message in the upper part of the picture's rectangle; red for an error.

        The legend, and what is said of a robot, are below.

        Args:
            text: the message.
            rect: of the picture.
            covered: width of what covers its left edge, pixels.
            is_bad: whether it is an error.
        """
        h = self.font.height
        text = shortened(text, self.font, rect.width - covered - 4 * h)
        wide = self.font.width(text) + 1.4 * h
        left = covered + (rect.width - covered - wide) / 2
        lines = [Text(0.7 * h, 0.35 * h, text, TEXT)]
        bottom = rect.bottom + rect.height - 4.2 * h  # below that a film is recorded
        self.panel((left, bottom, wide, 1.7 * h), lines, BAD if is_bad else PANEL)

    def panel_handle(self, height: float) -> tuple[float, float, float, float]:
        """Returns left, bottom, width and height of the panel's handle, at the picture's edge.

        Args:
            height: of the window, pixels.
        """
        h = self.font.height
        return 0.0, height - 3.0 * h, 1.2 * h, 2.2 * h

    def draw_panel_handle(self, height: float, *, is_lit: bool) -> None:
        """Draws three bars at the left edge, which open the panel."""
        left, bottom, wide, tall = self.panel_handle(height)
        self.panel((left, bottom, wide, tall), [], BAR if is_lit else HANDLE)
        bar = 0.09 * self.font.height
        for k in (-1, 0, 1):
            y = bottom + tall / 2 + 3.2 * k * bar - bar / 2
            self.box(left + 0.3 * wide, y, 0.4 * wide, max(bar, 1.0), _HANDLE)

    def filming(self, text: str, width: int, top: float) -> None:
        """Shows that a film is being recorded, in a picture of that width and upper edge."""
        h = self.font.height
        wide = self.font.width(text) + 2.2 * h
        left, bottom = (width - wide) / 2, top - 2.0 * h
        self.panel((left, bottom, wide, 1.5 * h), [Text(1.4 * h, 0.25 * h, text, TEXT)])
        self.box(left + 0.55 * h, bottom + 0.5 * h, 0.5 * h, 0.5 * h, _RED)

    def help_room(self, size: tuple[int, int]) -> tuple[int, int]:
        """Returns the maximum number of rows of a column and of columns of the help."""
        h = self.font.height
        return int((size[1] - 2.6 * h) / (_HELP_LINE * h)), int((size[0] - h) / (_HELP_COLUMN * h))

    def help(self, columns: Sequence[Sequence[tuple[str, str]]], width: int, height: int) -> None:
        """Draws a page of the help in a window; see `interaction.help_columns`."""
        font = self.font
        h, line = font.height, _HELP_LINE * font.height
        sizes = []
        for rows in columns:
            keys = max([font.width(key) for key, meaning in rows if meaning] or [0]) + 1.2 * h
            sizes.append((keys, keys + max(font.width(meaning) for _, meaning in rows)))
        wide = sum(total for _, total in sizes) + 2.0 * h * len(sizes) + h
        tall = line * max(len(rows) for rows in columns) + 2.4 * h
        left, bottom = max((width - wide) / 2, 0), max((height - tall) / 2, 0)
        lines = []
        x = 1.5 * h
        for (keys, total), rows in zip(sizes, columns, strict=True):
            y = tall - 1.2 * h - line
            for key, meaning in rows:
                if meaning:
                    lines.append(Text(x, y, key, MOODS["good"]))
                    lines.append(Text(x + keys, y, meaning, TEXT))
                elif key:
                    lines.append(Text(x, y, key, TITLE, is_strong=True))
                y -= line
            x += total + 2.0 * h
        self.panel((left, bottom, wide, tall), lines, HELP)


def shortened(text: str, font: Font, width: float) -> str:
    """Returns a text without its end where it is wider than so many pixels."""
    text = text.encode("ascii", "replace").decode()
    while len(text) > 4 and font.width(text) > width:
        text = text[:-4] + "..."
    return text
