"""Writes images and videos to files."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...base.errors import Problem, RenderError, reason_of
from .image_options import VIDEO_FORMATS

if TYPE_CHECKING:  # importing it takes 0.1 s, and only videos need it
    import av

Pixels = NDArray[np.uint8]


def check_writable(path: Path) -> None:
    """Checks before rendering that a file can be written, and creates its folder.

    Raises:
        RenderError: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RenderError(f"cannot write {path}: {error.strerror}") from error
    if os.path.isdir(path) or not os.access(path.parent, os.W_OK):
        raise RenderError(f"cannot write {path}: it is a folder, or its folder is read-only")


def save_image(path: Path, pixels: Pixels, dpi: float | None = None) -> None:
    """Writes an image to a file in the format of the file name extension."""
    check_writable(path)
    resolution: dict[str, Any] = {} if dpi is None else {"dpi": (dpi, dpi)}
    with writing_to(path):
        Image.fromarray(pixels).save(path, **resolution)


@contextlib.contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Converts errors in the `with` block to a RenderError that names the file to be written."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise RenderError(f"cannot write {path}: {reason_of(error)}") from error


def check_video(path: Path | str) -> Path:
    """Returns the path of a video file. Raises RenderError if its extension is unknown."""
    path = Path(path)
    if path.suffix.lower() not in VIDEO_FORMATS:
        expected = f"a name that ends in {', '.join(VIDEO_FORMATS)}"
        raise RenderError(Problem(file=str(path), found=path.suffix, expected=expected))
    return path


def default_fps(path: Path | str) -> float:
    """Returns the default number of frames per second of a video file."""
    return VIDEO_FORMATS[check_video(path).suffix.lower()].fps


class VideoWriter:
    """Context manager that writes frames to an H.264, VP9 or GIF video.

    The video is written to a temporary file, which is renamed when the video is complete. After a
    KeyboardInterrupt, the video contains the frames that were added before.

    Raises:
        RenderError: the file cannot be written, its extension is unknown, the size is too small,
            or there are too many frames per second.
    """

    def __init__(self, path: Path, width: int, height: int, fps: float) -> None:
        kind = VIDEO_FORMATS[check_video(path).suffix.lower()]
        self._path = path
        self._part = path.with_name(f".{path.name}.part{path.suffix}")
        odd = 1 if kind.has_palette else 2
        self._width, self._height = width - width % odd, height - height % odd
        if min(self._width, self._height) < 2:
            expected = "at least 2 pixels per side"
            raise RenderError(Problem("video size", found=(width, height), expected=expected))
        if fps > kind.max_fps:
            problem = Problem(
                file=str(path),
                found=fps,
                of="frames per second",
                expected=f"at most {kind.max_fps:g}, because programs play faster GIFs slowly",
            )
            raise RenderError(problem)
        import av

        check_writable(path)
        with writing_to(path):
            self._container = av.open(str(self._part), "w")
        self.frames = 0
        rate = Fraction(fps).limit_denominator(1001)
        stream = self._container.add_stream(kind.codec, rate=rate, options=dict(kind.options))
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = self._width, self._height
        stream.pix_fmt = "pal8" if kind.has_palette else "yuv420p"
        self._stream = stream
        self._palettes = _Palettes(self._width, self._height, rate) if kind.has_palette else None

    def add(self, pixels: Pixels) -> None:
        import av

        frame = av.VideoFrame.from_ndarray(
            np.ascontiguousarray(pixels[: self._height, : self._width]), format="rgb24"
        )
        self._encode(frame)
        self.frames += 1

    def _encode(self, frame: av.VideoFrame | None) -> None:
        frames = [frame] if self._palettes is None else self._palettes.follow(frame)
        with writing_to(self._path):
            for each in frames:
                self._container.mux(self._stream.encode(each))
            if frame is None and self._palettes is not None:
                self._container.mux(self._stream.encode(None))

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        tb: TracebackType | None,
    ) -> None:
        is_valid = kind is None or (issubclass(kind, KeyboardInterrupt) and self.frames > 0)
        if is_valid:
            self._encode(None)
        self._container.close()
        if is_valid:
            self._part.replace(self._path)
        else:
            with contextlib.suppress(OSError):  # it may not exist
                self._part.unlink()


# Each frame of a GIF has its own palette of 256 colors. To compute a common palette, all frames
# would be needed before the first one is written.
class _Palettes:
    def __init__(self, width: int, height: int, rate: Fraction) -> None:
        import av

        self._graph = graph = av.filter.Graph()
        self._step = 1 / rate
        self._count = 0
        rgb = av.VideoFormat("rgb24", width, height)
        begin = graph.add_buffer(width=width, height=height, format=rgb, time_base=self._step)
        both = graph.add("split")
        choose = graph.add("palettegen", "stats_mode=single")
        use = graph.add("paletteuse", "new=1:dither=bayer:bayer_scale=5")
        end = graph.add("buffersink")
        begin.link_to(both)
        both.link_to(choose, 0, 0)
        both.link_to(use, 1, 0)
        choose.link_to(use, 0, 1)
        use.link_to(end)
        graph.configure()

    def follow(self, frame: av.VideoFrame | None) -> Iterator[av.VideoFrame]:
        import av

        if frame is not None:
            frame.pts, frame.time_base = self._count, self._step
            self._count += 1
        self._graph.push(frame)
        with contextlib.suppress(av.error.BlockingIOError, av.error.EOFError):
            while True:
                found = self._graph.pull()
                assert isinstance(found, av.VideoFrame)
                yield found


class ImageArray(np.ndarray):
    """An image as an array, shape (height, width, 3), uint8, top row first.

    Notebooks display the array as an image. A slice that is not an image is displayed as numbers.
    """

    def save(self, path: Path | str) -> None:
        """Writes the image in the format of the file name extension, such as .png, .jpg or .webp.

        Raises:
            RenderError: the file cannot be written, the format is unknown, or this slice is not
                an image.
        """
        if not self._is_image:
            found = f"{' x '.join(map(str, self.shape))} numbers of type {self.dtype}"
            raise RenderError(
                f"cannot write {path}: found {found}; expected an image of height x width x 3"
            )
        save_image(Path(path), np.ascontiguousarray(self))

    @property
    def _is_image(self) -> bool:
        return (
            self.ndim == 3 and self.shape[2] in (3, 4) and self.dtype == np.uint8 and self.size > 0
        )

    def _repr_png_(self) -> bytes | None:
        if not self._is_image:
            return None
        file = io.BytesIO()
        Image.fromarray(np.ascontiguousarray(self)).save(file, "png")
        return file.getvalue()
