"""Motion blur: the mean of what is seen while a shutter is open, in linear light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array
from ..decor.picture_view import PictureView
from .film import Pixels

SUBFRAMES = 8
SHUTTER = 0.5  # open, of the time between two frames
_LEAST_SHIFT = 0.5  # pixels; what moves less is not drawn again
_LEVELS = 1 << 16  # of linear light, fine enough to distinguish the darkest two of 256 levels
# Source: IEC 61966-2-1 (sRGB).
_CODES = np.arange(256) / 255
_LINEAR = np.where(
    _CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4
).astype(np.float32)  # fmt: skip
_LIGHT = np.arange(_LEVELS) / (_LEVELS - 1)
_CODE_OF = np.where(_LIGHT <= 0.0031308, 12.92 * _LIGHT, 1.055 * _LIGHT ** (1 / 2.4) - 0.055)
_SRGB = np.round(255 * _CODE_OF).astype(np.uint8)


class Exposure:
    """Collects the pictures of a frame, of moments at equal intervals.

    A moment in which nothing has moved since the last one needs no picture: that one counts again.
    """

    def __init__(self) -> None:
        self._seen: tuple[Array, Array] | None = None  # pixels and depths of points, when drawn
        self._last: NDArray[np.float32] | None = None
        self._sum: NDArray[np.float32] | None = None
        self._count = 0

    def moves(self, view: PictureView, points: Array) -> bool:
        """Whether a moment needs a picture of its own, for `add`.

        Args:
            view: of the camera at that moment.
            points: of all that may move, (..., 3), m.
        """
        pixels, depth = view.project(points)
        if self._seen is not None:
            before, depth_before = self._seen
            seen = view.sees(pixels, depth) | view.sees(before, depth_before)
            shift = np.abs(pixels - before)[seen]
            if not len(shift) or shift.max() < _LEAST_SHIFT:
                return False
        self._seen = pixels, depth
        return True

    def add(self, picture: Pixels | None = None) -> None:
        if picture is not None:
            self._last = _LINEAR[picture]
        assert self._last is not None
        if self._sum is None:
            self._sum = self._last.copy()
        else:
            self._sum += self._last
        self._count += 1

    def picture(self) -> Pixels:
        assert self._sum is not None
        mean = self._sum * ((_LEVELS - 1) / self._count) + 0.5
        return np.asarray(_SRGB[mean.astype(np.int32).clip(0, _LEVELS - 1)])
