"""Pictures and films on disk."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import RenderError

Pixels = NDArray[np.uint8]


def save_picture(path: Path, pixels: Pixels) -> None:
    """Writes a picture in the format of the file's ending.

    Args:
        path: its folder is made if need be.
        pixels: (height, width, 3).

    Raises:
        RenderError: the file cannot be written, or the format is unknown.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels).save(path)
    except (OSError, ValueError) as error:
        raise RenderError(f"cannot write {path}: {error}") from error


class FilmWriter:
    """Writes an H.264 film. Use it as a context manager.

    The film is written beside its final name and moved there when it is complete, so a film
    that was broken off never looks like a finished one.

    Args:
        path: an .mp4 file; its folder is made if need be.
        width: of the frames; H.264 halves colours, so an odd last column is left out.
        height: likewise.
        fps: frames per second.

    Raises:
        RenderError: the file cannot be written.
    """

    def __init__(self, path: Path, width: int, height: int, fps: float) -> None:
        self._path = path
        self._part = path.with_name(f".{path.name}.part{path.suffix}")
        self._width, self._height = width - width % 2, height - height % 2
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._container = av.open(str(self._part), "w")
        except (OSError, ValueError) as error:
            raise RenderError(f"cannot write {path}: {error}") from error
        rate = Fraction(fps).limit_denominator(1001)
        self._stream = self._container.add_stream("libx264", rate=rate, options={"crf": "18"})
        self._stream.width, self._stream.height = self._width, self._height
        self._stream.pix_fmt = "yuv420p"

    def add(self, pixels: Pixels) -> None:
        """Appends a frame, (height, width, 3)."""
        frame = av.VideoFrame.from_ndarray(
            np.ascontiguousarray(pixels[: self._height, : self._width]), format="rgb24"
        )
        self._container.mux(self._stream.encode(frame))

    def __enter__(self) -> FilmWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        if kind is None:
            self._container.mux(self._stream.encode(None))
        self._container.close()
        if kind is None:
            self._part.replace(self._path)
        else:
            self._part.unlink(missing_ok=True)
