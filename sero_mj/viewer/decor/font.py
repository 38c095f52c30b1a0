"""`Font`: character widths, and columns that align the numbers of several lines.

Lines of text are encoded in UTF-8. Latin, Greek and Cyrillic characters outside ASCII are set in
additional faces of the font Inter. Other scripts are set in fonts of the system.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import ImageFont

from ...robots.assemble.world_view import WorldView

Widths = NDArray[np.intp] | NDArray[np.float64]

# MjrContext.charWidth[32:127] of MuJoCo 4.0.0 at a font scale of 150 %. A test checks these values.
_WIDTHS_150 = (
    6, 6, 9, 14, 12, 18, 15, 6, 7, 7, 12, 12, 6, 7, 6, 8, 12, 12, 12, 12, 12, 12, 12, 12, 12,
    12, 6, 6, 12, 12, 12, 10, 18, 15, 14, 16, 15, 14, 13, 16, 15, 6, 12, 15, 12, 18, 15, 17, 14,
    17, 14, 15, 14, 15, 15, 21, 15, 14, 13, 7, 7, 7, 8, 12, 8, 12, 12, 11, 12, 12, 6, 12, 12, 5,
    5, 11, 5, 17, 12, 12, 12, 12, 7, 11, 6, 12, 11, 15, 11, 11, 11, 8, 12, 8, 12,
)  # fmt: skip

# Line heights of MuJoCo fonts: mapping from font scale in percent to pixels.
FONT_HEIGHTS = {100: 18, 150: 28, 200: 37, 250: 45, 300: 54}


FONTS = Path(__file__).parents[1] / "fonts"
_MAX_BYTES = 99  # maximum length of MuJoCo labels in bytes
# Files of system fonts for scripts that Inter does not contain.
_SYSTEM_FONTS = (
    "NotoSansCJK-Regular.ttc", "NotoSansCJKsc-Regular.otf", "SourceHanSansSC-Regular.otf",
    "wqy-microhei.ttc", "DroidSansFallbackFull.ttf", "DroidSansFallback.ttf", "PingFang.ttc",
    "Hiragino Sans GB.ttc", "AppleSDGothicNeo.ttc", "msyh.ttc", "YuGothM.ttc", "malgun.ttf",
    "NotoSansDevanagari-Regular.ttf", "NotoSansArabic-Regular.ttf", "NotoSansHebrew-Regular.ttf",
    "NotoSansThai-Regular.ttf", "DejaVuSans.ttf", "Arial Unicode.ttf", "segoeui.ttf",
)  # fmt: skip
_SIZE = 16.0  # font size in pixels at which fonts are searched for characters


def line_of(text: str) -> bytes:
    """Returns a text encoded in UTF-8 and truncated to the maximum label length of MuJoCo."""
    raw = text.encode("utf-8", "replace")
    if len(raw) <= _MAX_BYTES:
        return raw
    return raw[:_MAX_BYTES].decode("utf-8", "ignore").encode("utf-8")


def open_face(file: Path | str, size: float) -> ImageFont.FreeTypeFont:
    """Opens a font file at a size in pixels. Raises OSError if the file cannot be read."""
    # Raqm is not available everywhere and places some characters differently.
    return ImageFont.truetype(file, size, layout_engine=ImageFont.Layout.BASIC)


@lru_cache(maxsize=1)
def more_fonts() -> tuple[str, ...]:
    """Returns the available font files for characters outside ASCII."""
    found = [str(FONTS / "Inter-Medium-more.ttf")]
    for name in _SYSTEM_FONTS:
        with suppress(OSError):
            found.append(str(open_face(name, _SIZE).path))
    return tuple(found)


@lru_cache(maxsize=4096)
def font_with(character: str) -> str | None:
    """Returns the first file of `more_fonts` that contains a character, or None."""
    for file in more_fonts():
        face = open_face(file, _SIZE)
        missing = face.getmask("\uffff")
        mask = face.getmask(character)
        if (mask.size, bytes(mask)) != (missing.size, bytes(missing)):
            return file
    return None


def drawable(text: str) -> bool:
    """Returns whether the available fonts contain all characters of a text."""
    return text.isascii() or all(c.isascii() or font_with(c) is not None for c in text)


@dataclass(frozen=True, eq=False)
class Font:
    """The measures of a proportional font, which determine the sizes of panels.

    Attributes:
        height: line height, pixels.
        widths: widths of the ASCII characters, shape (128,), pixels.
        has_columns: whether the numbers of a panel are aligned in columns (`value_columns`).
        other: function that returns the width of another character in pixels; None to use the
            width of W for all other characters.
    """

    height: int
    widths: Widths
    has_columns: bool = False
    other: Callable[[str], float] | None = None

    @classmethod
    def of_context(cls, context: Any) -> Font:
        widths = np.zeros(128, np.intp)
        widths[:127] = context.charWidth
        return cls(int(context.charHeight), widths)

    def width(self, text: str | bytes) -> int:
        raw = text if isinstance(text, bytes) else text.encode("utf-8", "replace")
        if not raw.isascii():
            return int(np.ceil(sum(map(self._width, raw.decode("utf-8", "replace")))))
        return int(np.ceil(self.widths[np.frombuffer(raw, np.uint8)].sum()))

    def _width(self, character: str) -> float:
        if character.isascii():
            return float(self.widths[ord(character)])
        return float(self.widths[ord("W")]) if self.other is None else self.other(character)

    def block_width(self, lines: list[bytes]) -> int:
        """Returns the width in pixels of the lines of a panel that shows values."""
        if not self.has_columns:
            return max(self.width(line) for line in lines)
        return int(np.ceil(value_columns(lines, self.width).width))

    def line_widths(self, lines: list[bytes]) -> NDArray[np.float64]:
        if not all(line.isascii() for line in lines):
            return np.array([float(self.width(line)) for line in lines])
        codes = np.frombuffer(b"".join(lines), np.uint8)
        until = np.concatenate([[0.0], np.cumsum(self.widths[codes & 127])])
        ends = np.cumsum([len(line) for line in lines])
        return np.asarray(until[ends] - until[ends - [len(line) for line in lines]])


DEFAULT_FONT = Font(FONT_HEIGHTS[150], np.pad(_WIDTHS_150, (32, 1)))
_TEXT_OF_SCALE = 0.7  # text height per unit of billboard_scale, fraction of the shorter image side
_MIN_LINE = FONT_HEIGHTS[100]  # minimum line height in pixels; smaller text is hard to read
_MAX_LINE = 0.0675  # maximum line height, fraction of the shorter image side


def line_height(world: WorldView, width: int, height: int) -> int:
    """Returns the line height in pixels for images of a world, based on the shorter image side."""
    scales = [part.robot.billboard_scale for part in world.robots.values()] or [0.05]
    wanted = min(_TEXT_OF_SCALE * max(scales), _MAX_LINE) * min(width, height)
    return max(round(wanted), _MIN_LINE)


Width = Callable[[str], float]

_VALUE = re.compile(
    r"(?P<head>.*?) +(?:(?P<whole>[-+]?\d+)(?P<rest>\.\d*(?:e[-+]?\d+)?)?(?P<unit> \S+)?"
    r"|(?P<none>no data|none))"
)
_GAP = " "  # space before the numbers


@dataclass(frozen=True)
class ValueLine:
    """A line of a billboard that ends with a number, split into its columns.

    Attributes:
        whole: integer part of the number, or `no data` or `none` if there is no number.
        rest: remaining characters of the number from the decimal point on.
        unit: unit of the number, with a leading space.
    """

    name: str
    label: str
    whole: str
    rest: str
    unit: str

    @property
    def is_missing(self) -> bool:
        return not self.whole[-1].isdigit()

    @property
    def tail(self) -> str:
        return self.rest + self.unit


@dataclass(frozen=True)
class ValueColumns:
    """The columns of a panel: its lines, and the positions in pixels that align them."""

    rows: list[ValueLine | str]
    label: float  # distance of the labels from the left edge
    tail: float  # distance of the decimal points from the right edge
    width: float  # total width of the lines


def value_columns(lines: Sequence[bytes], width: Width) -> ValueColumns:
    """Returns columns that align the numbers in the lines of a panel."""
    rows = [_parsed(line.decode("utf-8", "replace")) for line in lines]
    values = [row for row in rows if isinstance(row, ValueLine)]
    names = max((width(row.name) for row in values), default=0.0)
    label = names + (2 * width(" ") if any(row.label for row in values) else 0.0)
    heads = max((label + width(row.label) for row in values if row.label), default=names)
    wholes = max((width(row.whole) for row in values if not row.is_missing), default=0.0)
    tail = max((width(row.tail) for row in values), default=0.0)
    missing = max((width(row.whole) for row in values if row.is_missing), default=0.0)
    inside = heads + width(_GAP) + max(wholes + tail, missing) if values else 0.0
    plain = max((width(row) for row in rows if isinstance(row, str)), default=0.0)
    return ValueColumns(rows, label, tail, max(inside, plain))


def _parsed(line: str) -> ValueLine | str:
    found = _VALUE.fullmatch(line)
    if found is None:
        return line
    head = found["head"]
    name, _, label = head.rstrip().partition("  ")
    return ValueLine(
        name, label.strip(), found["whole"] or found["none"], found["rest"] or "",
        found["unit"] or "",
    )  # fmt: skip
