"""Reads photos and videos of real robots from files."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from ...base.errors import RenderError, reason_of
from ...base.paths import open_file

Pixels = NDArray[np.uint8]
PHOTOS = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")
_MAX_PIXELS = 16384**2
_TIME_TOLERANCE = 1e-4  # s
_FPS = 30.0  # frame rate of videos that do not state it, 1/s


def is_photo(path: Path) -> bool:
    """Returns whether a file has the extension of a photo."""
    return path.suffix.lower() in PHOTOS


def read_photo(path: Path) -> Pixels:
    """Reads a photo as an array, shape (height, width, 3), and rotates it upright as OpenCV does.

    Raises:
        RenderError: the photo cannot be read.
    """
    try:
        with open_file(path) as file, Image.open(file) as picture:
            if picture.width * picture.height > _MAX_PIXELS:
                raise RenderError(
                    f"{path}: the photo is too large, {picture.width}x{picture.height}"
                )
            return np.array(ImageOps.exif_transpose(picture).convert("RGB"))
    except FileNotFoundError:
        raise RenderError(f"{path}: no such file") from None
    except UnidentifiedImageError:
        raise RenderError(f"{path} is not a readable photo; expected {', '.join(PHOTOS)}") from None
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise RenderError(f"{path} cannot be read: {reason_of(error)}") from error


class Video:
    """Context manager that reads the frames of a video file.

    Attributes:
        size: width and height of the upright frames, pixels.
        fps: average number of frames per second.
        duration: duration of the video, s; 0 if the file does not state it.

    Raises:
        RenderError: the video cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            open_file(path).close()
            self._container = av.open(str(path))
        except FileNotFoundError:
            raise RenderError(f"{path}: no such file") from None
        except (av.FFmpegError, OSError, ValueError) as error:
            reason = reason_of(error)
            raise RenderError(f"{path} is not a readable video: {reason}") from error
        if not self._container.streams.video:
            self._container.close()
            raise RenderError(f"{path} has no video stream")
        self._stream = self._container.streams.video[0]
        self._stream.thread_type = "AUTO"
        self.fps = float(self._stream.average_rate or self._stream.guessed_rate or _FPS)
        length = self._container.duration
        self.duration = 0.0 if length is None else length / 1e6
        self._first: float | None = None  # time stamp of the first frame, s
        try:
            first = next(self.frames())[1]
        except (StopIteration, RenderError):
            self._container.close()
            raise RenderError(f"{path}: no frame can be read") from None
        self.size = (first.shape[1], first.shape[0])

    def frames(self, begin: float = 0.0) -> Iterator[tuple[float, Pixels]]:
        """Yields the time since the first frame in seconds, and the pixels of each frame.

        Frames before the time `begin` in seconds may be skipped. Damaged data after the first frame
        ends the iteration.

        Raises:
            RenderError: no frame can be read.
        """
        stream = self._stream
        step = 1.0 / self.fps
        time, is_any = -step, False
        try:
            if begin > 0.0 and self._first is not None:
                self._container.seek(round((self._first + begin) * 1e6))
            else:
                self._container.seek(0)
            for frame in self._container.decode(stream):
                found = float(Fraction(frame.pts or 0) * (stream.time_base or 0))
                self._first = found if self._first is None else self._first
                # If time stamps are invalid, the time is computed from the number of frames.
                since = found - self._first
                time = since if since > time else time + step
                is_any = True
                yield time, upright(frame)
        except (av.FFmpegError, OSError, ValueError) as error:
            if not is_any:
                raise RenderError(f"{self.path} cannot be read: {reason_of(error)}") from error

    def close(self) -> None:
        self._container.close()

    def __enter__(self) -> Video:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def read_frame(path: Path, time: float) -> Pixels:
    """Reads the frame of a video that is displayed at a time in seconds since the first frame.

    Raises:
        RenderError: the video cannot be read, or has no frame at this time.
    """
    with Video(path) as video:
        found, last = None, 0.0
        for at, pixels in video.frames(time):
            if at > time + _TIME_TOLERANCE:
                break
            found, last = pixels, at
        if found is None or time > last + 1.5 / video.fps:
            end = f"; the video ends at {video.duration:.2f} s" if video.duration else ""
            raise RenderError(f"{path} has no frame at {time:.2f} s{end}")
        return found


def at_rate(video: Video, fps: float, duration: float | None) -> Iterator[tuple[float, Pixels]]:
    """Yields times and frames of a video at a constant rate, which videos of phones do not have."""
    shown = 0
    last: tuple[float, Pixels] | None = None
    for frame in video.frames():
        if last is not None:
            while shown / fps < frame[0] - 0.5 / fps and (
                duration is None or shown / fps < duration
            ):
                yield last
                shown += 1
        last = frame
        if duration is not None and shown / fps >= duration:
            return
    if last is not None and (duration is None or shown / fps < duration):
        yield last


def upright(frame: av.VideoFrame) -> Pixels:
    """Returns the pixels of a video frame, rotated as its metadata requires."""
    pixels = frame.to_ndarray(format="rgb24")
    turns = round(getattr(frame, "rotation", 0) / 90) % 4
    return np.ascontiguousarray(np.rot90(pixels, turns))
