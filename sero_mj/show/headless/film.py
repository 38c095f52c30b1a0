"""Pictures and films on disk."""

from __future__ import annotations

import os
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...errors import RenderError

_ENCODER = {"crf": "18", "preset": "veryfast"}  # rendering is what should take the time
Pixels = NDArray[np.uint8]


def check_writable(path: Path) -> None:
    """Makes the file's folder, so that a wrong place shows before anything is rendered.

    Raises:
        RenderError: the file cannot be written there.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RenderError(f"cannot write {path}: {error.strerror}") from error
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        raise RenderError(f"cannot write {path}: it is a folder, or its folder is read-only")


def save_picture(path: Path, pixels: Pixels) -> None:
    """Writes a picture in the format of the file's ending.

    Args:
        path: its folder is made if need be.
        pixels: (height, width, 3).

    Raises:
        RenderError: the file cannot be written, or the format is unknown.
    """
    check_writable(path)
    try:
        Image.fromarray(pixels).save(path)
    except (OSError, ValueError) as error:
        raise RenderError(f"cannot write {path}: {error}") from error


class FilmWriter:
    """Writes an H.264 film. Use it as a context manager.

    The film is written beside its final name and moved there when it is complete, so a film
    that was broken off never looks like a finished one.

    Attributes:
        frames: how many were added.

    Args:
        path: an .mp4 file; its folder is made if need be.
        width: of the frames; H.264 halves colours, so an odd last column is left out.
        height: likewise; at least 2 pixels each.
        fps: frames per second.

    When the user interrupts (KeyboardInterrupt), what was filmed so far is kept.

    Raises:
        RenderError: the file cannot be written, or the size is too small.
    """

    def __init__(self, path: Path, width: int, height: int, fps: float) -> None:
        self._path = path
        self._part = path.with_name(f".{path.name}.part{path.suffix}")
        self._width, self._height = width - width % 2, height - height % 2
        if not (self._width and self._height):
            raise RenderError(f"film size {width}x{height}: expected at least 2x2 pixels")
        check_writable(path)
        try:
            self._container = av.open(str(self._part), "w")
        except (OSError, ValueError) as error:
            raise RenderError(f"cannot write {path}: {error}") from error
        self.frames = 0
        rate = Fraction(fps).limit_denominator(1001)
        self._stream = self._container.add_stream("libx264", rate=rate, options=_ENCODER)
        self._stream.width, self._stream.height = self._width, self._height
        self._stream.pix_fmt = "yuv420p"

    def add(self, pixels: Pixels) -> None:
        """Appends a frame, (height, width, 3)."""
        frame = av.VideoFrame.from_ndarray(
            np.ascontiguousarray(pixels[: self._height, : self._width]), format="rgb24"
        )
        self._container.mux(self._stream.encode(frame))
        self.frames += 1

    def __enter__(self) -> FilmWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        keep = kind is None or (issubclass(kind, KeyboardInterrupt) and self.frames > 0)
        if keep:
            self._container.mux(self._stream.encode(None))
        self._container.close()
        if keep:
            self._part.replace(self._path)
        else:
            self._part.unlink(missing_ok=True)
