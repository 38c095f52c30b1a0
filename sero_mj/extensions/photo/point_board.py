"""`PointBoard`: a photo in which the user clicks points of the robot, and a list of these points.

The board does not depend on a window. It handles clicks and keys, and renders itself to an image.
Pixels in this file are counted from the upper left corner of the board, x to the right, y down.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from ...base.errors import UsageError
from ...base.frames import Array
from ...viewer.image.typesetting import PlacedPanel, PlacedText, Rgb, Typesetter, compose
from .calibration import Calibration, calibrate
from .photo_camera import PhotoCamera

Pixels = NDArray[np.uint8]
_PANEL = (0.07, 0.09, 0.12, 1.0)
_BESIDE = (18, 20, 23)
_NAME: Rgb = (0.90, 0.92, 0.94)
_DIM: Rgb = (0.60, 0.65, 0.71)
_CHOSEN: Rgb = (1.0, 0.72, 0.30)
_GOOD: Rgb = (0.55, 0.85, 0.62)
_BAD: Rgb = (1.0, 0.52, 0.40)
_ORANGE, _GREEN, _RED = (255, 160, 40), (70, 230, 120), (255, 70, 60)
_WIDTH = 17.0  # width of the list, line heights
_LINE = 1.25  # height of the rows of the list, line heights
_STEP = 1.25  # zoom factor for a step of the mouse wheel
_MAX_ZOOM = 40.0
_MIN_ROWS = 5  # minimum number of rows of the list
_GOOD_CLICK = 5.0  # maximum error of a good click, pixels
_MARK = 9  # half width of the crosses at clicked pixels, pixels
_KEYS = ("click: set pixel of the point", "wheel: zoom, drag: move", "up, down: select point",
         "backspace: delete pixel", "enter: finish, escape: cancel")  # fmt: skip


@dataclass
class _View:  # the visible part of the photo, given by its central pixel and its pixel size
    centre: Array
    zoom: float


class PointBoard:
    """A photo beside a list of points, whose pixels the user clicks in the photo.

    Args:
        points: world positions of the points, shape (k, 3), m.
        lens: camera with the known intrinsics.
        find_focal: whether the focal length is computed, too.
        clicked: mapping from indices of points to known pixels, shape (2,).

    Attributes:
        chosen: index of the point whose pixel the next click sets.
        clicked: mapping from indices of points to their pixels.
        found: result of the calibration; None if there are too few points.
        message: error message, or the error of the fit.
    """

    def __init__(
        self,
        photo: Pixels,
        names: Sequence[str],
        points: Array,
        lens: PhotoCamera,
        *,
        find_focal: bool,
        clicked: Mapping[int, Array] | None = None,
    ) -> None:
        self._photo = Image.fromarray(photo)
        self._names, self._points = list(names), points
        self._lens, self._find_focal = lens, find_focal
        self.clicked: dict[int, Array] = dict(clicked or {})
        self.found: Calibration | None = None
        self.message = ""
        self.chosen = 0
        self._view: _View | None = None  # None for the whole photo
        self._typesetter = Typesetter(18)
        self._size = (1, 1)
        self._choose_next()
        self._solve()

    @property
    def panel_width(self) -> int:
        return round(_WIDTH * self._typesetter.font.height)

    def resize(self, width: int, height: int, line: int) -> None:
        self._size = (width, height)
        if line != self._typesetter.font.height:
            self._typesetter = Typesetter(line)

    def click(self, x: float, y: float) -> None:
        """Handles a click: selects a point in the list, or sets the pixel of the selected point."""
        if x < self.panel_width:
            row = self._row_at(y)
            if row is not None:
                self.chosen = row
            return
        pixel = self._to_photo(np.array([x, y]))
        width, height = self._photo.size
        if (pixel < -0.5).any() or (pixel > np.array([width, height]) - 0.5).any():
            return
        self.clicked[self.chosen] = pixel
        self._choose_next()
        self._solve()

    def press(self, key: str) -> None:
        if key in ("up", "down"):
            self.chosen = (self.chosen + (1 if key == "down" else -1)) % len(self._names)
        elif key in ("backspace", "delete") and self.clicked:
            if self.chosen not in self.clicked:
                self.chosen = list(self.clicked)[-1]  # the last clicked point
            del self.clicked[self.chosen]
            self._solve()

    def zoom(self, steps: float, x: float, y: float) -> None:
        view, at = self._now(), np.array([x, y])
        if x < self.panel_width:
            return
        fixed = self._to_photo(at)
        smallest = self._whole().zoom
        zoom = float(np.clip(view.zoom * _STEP**steps, smallest, _MAX_ZOOM * smallest))
        centre = fixed - (at + 0.5 - self._middle) / zoom
        self._view = None if zoom <= smallest else _View(centre, zoom)

    def pan(self, right: float, down: float) -> None:
        view = self._now()
        if self._view is not None:
            self._view = _View(view.centre - np.array([right, down]) / view.zoom, view.zoom)

    def _whole(self) -> _View:
        width, height = self._photo.size
        room = max(self._size[0] - self.panel_width, 1), self._size[1]
        zoom = min(room[0] / width, room[1] / height)
        return _View(np.array([width - 1, height - 1]) / 2, zoom)

    def _now(self) -> _View:
        return self._view or self._whole()

    def _to_photo(self, at: Array) -> Array:
        view = self._now()
        return np.asarray(view.centre + (at + 0.5 - self._middle) / view.zoom)

    def _to_board(self, pixels: Array) -> Array:
        view = self._now()
        return np.asarray((pixels - view.centre) * view.zoom + self._middle - 0.5)

    @property
    def _middle(self) -> Array:
        return np.array([(self.panel_width + self._size[0]) / 2, self._size[1] / 2])

    def _choose_next(self) -> None:
        count = len(self._names)
        for k in range(count):
            if (self.chosen + k) % count not in self.clicked:
                self.chosen = (self.chosen + k) % count
                return

    def _solve(self) -> None:
        index = sorted(self.clicked)
        self.found = None
        try:
            self.found = calibrate(
                [self._names[k] for k in index],
                self._points[index].reshape(-1, 3),
                np.array([self.clicked[k] for k in index]).reshape(-1, 2),
                self._lens,
                find_focal=self._find_focal,
            )
            self.message = f"root mean square error {self.found.rms:.1f} pixels"
            wrong = [self._names[k] for k, u in zip(index, self.found.used, strict=True) if not u]
            self.message += f", without {', '.join(wrong)}" if wrong else ""
        except UsageError as error:
            self.message = str(error)

    def _row_height(self) -> float:
        return _LINE * self._typesetter.font.height

    def _first(self) -> float:
        return 2.4 * self._row_height()

    def _shown(self) -> range:
        room = self._size[1] - self._first() - (len(_KEYS) + 4) * self._row_height()
        count = max(int((room - self.panel_width) / self._row_height()), _MIN_ROWS)
        first = min(max(self.chosen - count // 2, 0), max(len(self._names) - count, 0))
        return range(first, min(first + count, len(self._names)))

    def _row_at(self, y: float) -> int | None:
        shown = self._shown()
        row = int((y - self._first()) // self._row_height())
        return shown[row] if 0 <= row < len(shown) else None

    def sketch(self) -> tuple[int, int, int, int]:
        """Returns left, top, width and height in pixels of the area for a sketch of the robot."""
        top = self._first() + (len(self._shown()) + 0.5) * self._row_height()
        bottom = self._size[1] - (len(_KEYS) + 3.6) * self._row_height()
        return 0, round(top), self.panel_width, max(round(bottom - top), 1)

    def image(self) -> Pixels:
        board = Image.new("RGB", self._size, _BESIDE)
        self._draw_photo(board)
        self._draw_marks(ImageDraw.Draw(board))
        pixels = np.array(board)
        compose(pixels, [self._panel()])
        return pixels

    def _draw_photo(self, board: Image.Image) -> None:
        corners = self._to_photo(
            np.array([[self.panel_width - 0.5, -0.5], self._size]) - [[0], [0.5]]
        )
        width, height = self._photo.size
        low = np.clip(corners[0] + 0.5, 0, [width, height])
        high = np.clip(corners[1] + 0.5, 0, [width, height])
        if (high - low < 1e-3).any():
            return
        first, last = self._to_board(np.array([low, high]) - 0.5) + 0.5
        size = tuple(np.maximum(np.rint(last) - np.rint(first), 1).astype(int).tolist())
        how = Image.Resampling.NEAREST if self._now().zoom > 3 else Image.Resampling.BILINEAR
        part = self._photo.resize(size, how, box=(*low.tolist(), *high.tolist()))
        board.paste(part, tuple(np.rint(first).astype(int).tolist()))

    def _draw_marks(self, draw: ImageDraw.ImageDraw) -> None:
        index = sorted(self.clicked)
        used = dict.fromkeys(index, True)
        if self.found is not None:
            used = dict(zip(index, self.found.used.tolist(), strict=True))
            pixels, depth = self.found.camera.project(self._points)
            for k, (at, distance) in enumerate(zip(self._to_board(pixels), depth, strict=True)):
                if distance > 0 and np.isfinite(at).all() and (np.abs(at) < 1e5).all():
                    if k in self.clicked:
                        clicked = self._to_board(self.clicked[k])
                        draw.line([*clicked.tolist(), *at.tolist()], _GREEN, 1)
                    radius = 5 if k in self.clicked else 3
                    box = [*(at - radius).tolist(), *(at + radius).tolist()]
                    draw.ellipse(box, outline=(0, 0, 0), width=3)
                    draw.ellipse(box, outline=_GREEN, width=1)
        for k in index:
            x, y = self._to_board(self.clicked[k]).tolist()
            colour = _ORANGE if used[k] else _RED
            for wide, ink in ((3, (0, 0, 0)), (1, colour)):
                draw.line([x - _MARK, y, x + _MARK, y], ink, wide)
                draw.line([x, y - _MARK, x, y + _MARK], ink, wide)
            draw.text((x + 7, y + 5), str(k + 1), colour, stroke_width=2, stroke_fill=(0, 0, 0))

    def _panel(self) -> PlacedPanel:
        line, height = self._row_height(), self._size[1]
        pad = 0.6 * self._typesetter.font.height
        right = 0.70 * self.panel_width
        texts: list[PlacedText] = []

        def add(
            row: float, text: str, rgb: Rgb = _NAME, x: float = pad, *, strong: bool = False
        ) -> None:
            lower = height - row * line - self._typesetter.font.height
            texts.append(PlacedText(x, lower, text, rgb, is_strong=strong))

        add(0.4, "click this point in the photo", _DIM)
        add(1.3, self._names[self.chosen], _CHOSEN, strong=True)
        errors = {}
        if self.found is not None:
            off = np.linalg.norm(self.found.errors, axis=1)
            errors = dict(
                zip(sorted(self.clicked), zip(off, self.found.used, strict=True), strict=True)
            )
        for place, k in enumerate(self._shown()):
            row = self._first() / line + place
            add(row, f"{k + 1}", _DIM)
            is_chosen = k == self.chosen
            add(
                row,
                self._names[k],
                _CHOSEN if is_chosen else _NAME,
                pad + 1.6 * line,
                strong=is_chosen,
            )
            if k in errors:
                distance, is_used = errors[k]
                is_good = is_used and distance < _GOOD_CLICK
                add(row, f"{distance:.1f} px", _GOOD if is_good else _BAD, right)
            elif k in self.clicked:
                add(row, "clicked", _DIM, right)
        last = height / line - len(_KEYS) - 0.6
        for k, part in enumerate(self._wrapped(self.message, 3)):
            found = self.found
            good = found is not None and bool(found.used.all()) and found.rms < _GOOD_CLICK
            add(last - 3 + k, part, _GOOD if good else _BAD)
        for k, key in enumerate(_KEYS):
            add(last + 0.2 + k, key, _DIM)
        pixels = self._typesetter.panel((self.panel_width, height), _PANEL, tuple(texts), False)
        return PlacedPanel(0, 0, pixels)

    def _wrapped(self, text: str, max_lines: int) -> list[str]:
        lines, room = [""], self.panel_width - 1.2 * self._typesetter.font.height
        for word in text.split():
            longer = f"{lines[-1]} {word}".strip()
            if self._typesetter.font.width(longer.encode()) > room:
                lines.append(word)
            else:
                lines[-1] = longer
        return lines[:max_lines]
