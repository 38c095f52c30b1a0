"""`Font`: widths of a host's characters; and those of MuJoCo's built-in label font."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...robots.assemble.world_view import WorldView
from .value_columns import value_columns

Widths = NDArray[np.intp] | NDArray[np.float64]

# MjrContext.charWidth[32:127] at font scale 150 %, from MuJoCo 4.0.0; verified by a test.
_WIDTHS_150 = (
    6, 6, 9, 14, 12, 18, 15, 6, 7, 7, 12, 12, 6, 7, 6, 8, 12, 12, 12, 12, 12, 12, 12, 12, 12,
    12, 6, 6, 12, 12, 12, 10, 18, 15, 14, 16, 15, 14, 13, 16, 15, 6, 12, 15, 12, 18, 15, 17, 14,
    17, 14, 15, 14, 15, 15, 21, 15, 14, 13, 7, 7, 7, 8, 12, 8, 12, 12, 11, 12, 12, 6, 12, 12, 5,
    5, 11, 5, 17, 12, 12, 12, 12, 7, 11, 6, 12, 11, 15, 11, 11, 11, 8, 12, 8, 12,
)  # fmt: skip

# Line heights of MuJoCo's font sizes: font scale in percent to pixels.
FONT_HEIGHTS = {100: 18, 150: 28, 200: 37, 250: 45, 300: 54}


@dataclass(frozen=True, eq=False)
class Font:
    """A proportional font.

    Attributes:
        height: of a line, pixels.
        widths: of the characters 0 to 127, pixels.
        has_columns: whether the host aligns the numbers of a panel, see `value_columns`.
    """

    height: int
    widths: Widths
    has_columns: bool = False

    @classmethod
    def of_context(cls, context: Any) -> Font:
        """Returns the font of an `MjrContext`."""
        widths = np.zeros(128, np.intp)
        widths[:127] = context.charWidth
        return cls(int(context.charHeight), widths)

    def width(self, text: str | bytes) -> int:
        """Returns the width of a text of printable ASCII, pixels."""
        codes = np.frombuffer(text if isinstance(text, bytes) else text.encode("ascii"), np.uint8)
        return int(np.ceil(self.widths[codes & 127].sum()))

    def block_width(self, lines: list[bytes]) -> int:
        """Returns the width of a panel's lines with values, pixels."""
        if not self.has_columns:
            return max(self.width(line) for line in lines)
        return int(np.ceil(value_columns(lines, self.width).width))

    def line_widths(self, lines: list[bytes]) -> NDArray[np.float64]:
        """Returns the widths of lines of printable ASCII (k,), pixels."""
        codes = np.frombuffer(b"".join(lines), np.uint8)
        until = np.concatenate([[0.0], np.cumsum(self.widths[codes & 127])])
        ends = np.cumsum([len(line) for line in lines])
        return np.asarray(until[ends] - until[ends - [len(line) for line in lines]])


def _default() -> Font:
    widths = np.zeros(128, np.intp)
    widths[32:127] = _WIDTHS_150
    return Font(FONT_HEIGHTS[150], widths)


DEFAULT_FONT = _default()


_TEXT_OF_SCALE = 0.7  # text height over the picture's shorter side per unit of billboard_scale
_MIN_LINE = FONT_HEIGHTS[100]  # pixels; smaller text is hard to read
_LARGEST_LINE = 0.0675  # of that side


def line_height(world: WorldView, width: int, height: int) -> int:
    """Returns the height of a line of text in a picture of that size, pixels.

    It goes with the picture's shorter side.
    """
    scales = [part.robot.billboard_scale for part in world.robots.values()] or [0.05]
    wanted = min(_TEXT_OF_SCALE * max(scales), _LARGEST_LINE) * min(width, height)
    return max(round(wanted), _MIN_LINE)
