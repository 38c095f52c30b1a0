"""`Picture`: pixels that a notebook shows by themselves."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from ...errors import RenderError


class Picture(np.ndarray):
    """A picture (height, width, 3), uint8, top row first, with `save`; else an ordinary array.

    In a notebook it is shown where it is the last line of a cell. A part of it that is no
    picture any more is shown as numbers.
    """

    def save(self, path: Path | str) -> None:
        """Writes the picture in the format of the file's ending: .png, .jpg, .webp.

        Args:
            path: its folder is made if need be.

        Raises:
            RenderError: the file cannot be written, the format is unknown, or this part of a
                picture is none.
        """
        from .film import save_picture

        if not self._is_picture:
            found = f"{' x '.join(map(str, self.shape))} numbers of type {self.dtype}"
            raise RenderError(
                f"cannot write {path}: found {found}; expected a picture, height x width x 3"
            )
        save_picture(Path(path), np.ascontiguousarray(self))

    @property
    def _is_picture(self) -> bool:
        return (
            self.ndim == 3 and self.shape[2] in (3, 4) and self.dtype == np.uint8 and self.size > 0
        )

    def _repr_png_(self) -> bytes | None:
        """The picture as PNG, which notebooks ask for; None where it is none."""
        if not self._is_picture:
            return None
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(self)).save(file, "png")
        return file.getvalue()
