"""`Picture`: pixels that a notebook shows by themselves."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image


class Picture(np.ndarray):
    """A picture (height, width, 3), uint8, top row first; else an ordinary array.

    In a notebook it is shown where it is the last line of a cell. A part of it that is no
    picture any more is shown as numbers.
    """

    def _repr_png_(self) -> bytes | None:
        """The picture as PNG, which notebooks ask for; None where it is none."""
        if self.ndim != 3 or self.shape[2] not in (3, 4) or self.dtype != np.uint8 or not self.size:
            return None
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(self)).save(file, "png")
        return file.getvalue()
