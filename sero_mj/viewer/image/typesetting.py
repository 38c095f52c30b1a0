"""`Typesetter`: renders panels with text in the font Inter, which are drawn over frames.

`compose` draws the panels over images, and OpenGL draws them in windows. Names, labels and units of
a panel are rendered once. Only the numbers are updated in each frame, from digits of equal width.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..decor.font import FONTS, Font, ValueLine, drawable, font_with, open_face, value_columns
from ..decor.panels import BAR_RGBA, PADDING, Panels

Bytes = NDArray[np.uint8]
Rgb = tuple[float, float, float]
Rgba = tuple[float, float, float, float]
Size = tuple[int, int]

_EM = 0.74  # font size, fraction of the line height
_RADIUS = 0.28  # radius of the corners of panels, fraction of the line height
_EDGE = 0.10  # fraction of white in the outline of panels
_FIGURES = "0123456789.-+e"
_MINUS = "\N{MINUS SIGN}"
_NUMBER: Rgb = (1.0, 1.0, 1.0)
_NAME: Rgb = (0.90, 0.93, 0.96)
_QUIET: Rgb = (0.68, 0.73, 0.79)  # color of labels and units
# Sizes of the caches. An image has about ten panels and a hundred texts.
_CACHED_PANELS, _CACHED_TEXTS = 128, 512


@dataclass(frozen=True)
class PlacedText:
    """A text with its position in a panel, pixels. Question marks replace unknown characters."""

    x: float
    y: float
    text: str
    rgb: Rgb = _NAME
    is_strong: bool = False


@dataclass(frozen=True, eq=False)
class PlacedPanel:
    """A rendered panel with its position in an image, pixels.

    Attributes:
        pixels: premultiplied RGBA values, shape (height, width, 4), top row first.
    """

    left: int
    bottom: int
    pixels: Bytes


class Typesetter:
    """A renderer of panels with text, for lines with a height of `line` pixels."""

    def __init__(self, line: int) -> None:
        size = _EM * line
        self._line = line
        self._size = size
        self._faces = [_face("Medium", size), _face("SemiBold", size)]
        ascent, descent = size * 0.96875, size * 0.2412  # metrics of Inter
        self._baseline = round((line + ascent - descent) / 2)
        widths = np.zeros(128)
        widths[32:127] = [self._faces[0].getlength(chr(code)) for code in range(32, 127)]
        figure = self._faces[1].getlength("0")
        cells = {c: round(widths[ord(c)] if c in ".e" else figure) for c in _FIGURES}
        for c, cell in cells.items():
            widths[ord(c)] = max(widths[ord(c)], cell)
        self._coverage = lru_cache(_CACHED_TEXTS)(self._draw)
        self.panel = lru_cache(_CACHED_PANELS)(self._set)
        self._figures = {c: self._figure(c, cell) for c, cell in cells.items()}
        self.font = Font(line, widths, has_columns=True, other=self._width)
        self._last: dict[Hashable, Bytes] = {}  # rendered panels of the last frame

    def _figure(self, character: str, cell: int) -> Bytes:
        glyph = self._coverage(_MINUS if character == "-" else character, True)
        out = np.zeros((self._line, cell), np.uint8)
        skip = max((cell - glyph.shape[1]) // 2, 0)
        out[:, skip : skip + glyph.shape[1]] = glyph[:, : cell - skip]
        return out

    def _draw(self, text: str, is_strong: bool) -> Bytes:
        runs = [
            (face, "".join(characters))
            for face, characters in groupby(text, lambda c: self._face_of(c, is_strong))
        ]
        widths = [face.getlength(part) for face, part in runs]
        image = Image.new("L", (int(np.ceil(sum(widths))) + 1, self._line))
        left = 0.0
        for (face, part), width in zip(runs, widths, strict=True):
            at = (left, self._baseline)
            ImageDraw.Draw(image).text(at, part, 255, face, anchor="ls")
            left += width
        return np.asarray(image)

    def _face_of(self, character: str, is_strong: bool) -> ImageFont.FreeTypeFont:
        file = None if character.isascii() or character == _MINUS else font_with(character)
        return self._faces[is_strong] if file is None else _more_face(file, self._size)

    def _width(self, character: str) -> float:
        return float(self._face_of(character, False).getlength(character))

    def place(self, groups: Sequence[Panels]) -> list[PlacedPanel]:
        placed, last = [], self._last
        self._last = {}
        for group in groups:
            colours = np.broadcast_to(np.asarray(group.rgba), (len(group.texts), 4)).tolist()
            edges = np.concatenate([group.centres - group.sizes / 2, group.sizes], axis=1)
            for (left, bottom, *size), lines, rgba in zip(
                np.rint(edges).astype(int).tolist(), group.texts, colours, strict=True
            ):
                key = (*size, *rgba, *lines)
                pixels = last.get(key)
                if pixels is None:
                    set_lines = self._values if group.has_values else self._lines
                    pixels = set_lines((size[0], size[1]), tuple(rgba), lines)
                self._last[key] = pixels
                placed.append(PlacedPanel(left, bottom, pixels))
            for left, bottom, *size in [] if group.bars is None else np.rint(group.bars).tolist():
                bar = self.panel((int(size[0]), int(size[1])), BAR_RGBA, (), False)
                placed.append(PlacedPanel(int(left), int(bottom), bar))
        return placed

    def _lines(self, size: Size, rgba: Rgba, lines: list[bytes]) -> Bytes:
        pad = PADDING * self._line
        first = size[1] - pad / 2 - self._line
        return self.panel(
            size,
            rgba,
            tuple(
                PlacedText(pad, first - k * self._line, text.decode("utf-8", "replace"))
                for k, text in enumerate(lines)
            ),
        )

    def _values(self, size: Size, rgba: Rgba, lines: list[bytes]) -> Bytes:
        line, pad = self._line, PADDING * self._line
        found = value_columns(lines, self.font.width)
        right = size[0] - pad
        point = round(right - found.tail)
        texts: list[PlacedText] = []
        numbers: list[tuple[int, float, Bytes]] = []
        for k, row in enumerate(found.rows):
            y = size[1] - pad / 2 - (k + 1) * line
            if not isinstance(row, ValueLine):
                texts.append(PlacedText(pad, y, row, _NAME if k == 0 else _QUIET))
                continue
            texts += (
                PlacedText(pad, y, row.name),
                PlacedText(pad + found.label, y, row.label, _QUIET),
            )
            if row.is_missing:
                x = right - self.font.width(row.whole)
                texts.append(PlacedText(x, y, row.whole, _QUIET))
                continue
            cells = [self._figures[c] for c in row.whole + row.rest]
            start = point - sum(cell.shape[1] for cell in cells[: len(row.whole)])
            strip = np.concatenate(cells, axis=1)
            texts.append(PlacedText(start + strip.shape[1], y, row.unit, _QUIET))
            numbers.append((start, y, strip))
        out = self.panel(size, rgba, tuple(texts)).copy()
        for start, y, strip in numbers:
            _blend(out, strip, start, round(size[1] - y - line), _NUMBER)
        return out

    def _set(
        self, size: Size, rgba: Rgba, texts: tuple[PlacedText, ...], is_round: bool = True
    ) -> Bytes:
        out = _background(size, rgba, _RADIUS * self._line if is_round else 0.0).copy()
        for item in texts:
            text = "".join(c if drawable(c) else "?" for c in item.text)
            if text.strip():
                top = round(size[1] - item.y - self._line)
                _blend(out, self._coverage(text, item.is_strong), round(item.x), top, item.rgb)
        return out


def _face(weight: str, size: float) -> ImageFont.FreeTypeFont:
    return open_face(FONTS / f"Inter-{weight}.ttf", size)


@lru_cache(maxsize=64)
def _more_face(file: str, size: float) -> ImageFont.FreeTypeFont:
    return open_face(file, size)


@lru_cache(maxsize=64)
def _background(size: tuple[int, int], rgba: Rgba, radius: float) -> Bytes:
    width, height = size
    x = np.abs(np.arange(width) + 0.5 - width / 2) - width / 2
    y = np.abs(np.arange(height) + 0.5 - height / 2)[:, None] - height / 2
    # Distance from the edge of the panel, negative inside.
    outside = np.hypot(np.maximum(x + radius, 0), np.maximum(y + radius, 0))
    distance = outside + np.minimum(np.maximum(x + radius, y + radius), 0) - radius
    alpha = rgba[3] * np.clip(0.5 - distance, 0, 1)[..., None]
    edge = np.clip(1.5 + distance, 0, 1)[..., None] * (_EDGE if radius else 0.0)
    rgb = np.array(rgba[:3])
    colour = (rgb + (1.0 - rgb) * edge) * alpha
    return np.asarray(np.rint(255 * np.concatenate([colour, alpha], axis=2)), np.uint8)


def _blend(out: Bytes, coverage: Bytes, left: int, top: int, rgb: Rgb) -> None:
    x, y = max(left, 0), max(top, 0)
    letters = coverage[y - top :, x - left :]
    letters = letters[: max(out.shape[0] - y, 0), : max(out.shape[1] - x, 0)]
    below = out[y : y + letters.shape[0], x : x + letters.shape[1]]
    cover = letters[..., None].astype(np.uint16)
    ink = np.array([*rgb, 1.0]) * 255
    below[:] = (below * (255 - cover) + ink.astype(np.uint16) * cover + 127) // 255


def compose(image: Bytes, panels: Sequence[PlacedPanel]) -> None:
    """Draws panels over an image, shape (height, width, 3), top row first, in place."""
    height, width = image.shape[:2]
    for placed in panels:
        top, left = height - placed.bottom - placed.pixels.shape[0], placed.left
        y, x = max(top, 0), max(left, 0)
        over = placed.pixels[y - top :, x - left :][: max(height - y, 0), : max(width - x, 0)]
        below = image[y : y + over.shape[0], x : x + over.shape[1]]
        # These steps take half the time of a single NumPy expression that broadcasts alpha.
        through = np.repeat(256 - over[..., 3].astype(np.uint16), 3, axis=1)
        mixed = below.astype(np.uint16)
        mixed *= through.reshape(mixed.shape)
        mixed >>= 8
        mixed += over[..., :3]
        below[:] = mixed
