"""Reads images of a live camera (`CameraFeed`), or of a video at the displayed time (`VideoFeed`).

Both feeds read images on a separate thread.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import RenderError, UsageError
from ...viewer.session.status_line import Piece
from .camera_file import read_camera
from .footage import Pixels, Video
from .photo_camera import PhotoCamera, opencv

_FIRST_TIMEOUT = 10.0  # maximum time until the first image of a camera, s
_RETRY_INTERVAL = 1.0  # time between attempts to reopen a lost camera, s
_LOST_AFTER = 0.7  # time without an image after which a camera is lost, s
_TIME_TOLERANCE = 1e-4  # s
_MAX_SEQUENTIAL = 2.0  # maximum time in s by which a video advances without seeking
_RATE_WEIGHT = 0.1  # weight of the last interval in the mean interval of images


class CameraFeed:
    """Context manager that reads images of a camera until it is closed.

    If the connection is lost, `piece` reports this, the last image stays visible, and the camera is
    reopened.

    Args:
        what: number of a camera, such as `0`, an address for OpenCV, such as `rtsp://...` or
            `/dev/video0`, or a video file, which is played repeatedly at its frame rate.
        camera_file: file with the intrinsics and the pose of the camera.

    Raises:
        RenderError: the camera sends no image.
        DeclarationError: the camera file is invalid, or is for images of another size.
    """

    def __init__(self, what: str, camera_file: Path) -> None:
        self.what = what
        self.is_file = not what.isdecimal() and Path(what).is_file()
        self.name = f"camera {what}" if what.isdecimal() else what
        if not self.is_file and Path(what).suffix and "://" not in what and "/dev/" not in what:
            raise RenderError(
                f"{what}: no such file; expected a video, or a camera number such as 0"
            )
        self._changed = threading.Condition()
        self._pixels: Pixels | None = None
        self._number = 0
        self._arrival, self._interval = -np.inf, 0.0
        self._wrong_size: tuple[int, int] | None = None
        self._error = ""
        self._closing = threading.Event()
        self._size: tuple[int, int] | None = None
        self._wanted = None if self.is_file else _size_in(camera_file)
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()
        try:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._pixels is not None or bool(self._error), _FIRST_TIMEOUT
                )
                first = self._pixels
            if first is None:
                why = self._error or f"no image within {_FIRST_TIMEOUT:.0f} s"
                raise RenderError(f"{self.name}: {why}")
            self.camera: PhotoCamera = read_camera(camera_file, (first.shape[1], first.shape[0]))
        except BaseException:
            self.close()
            raise

    def latest(self, time: float = 0.0) -> tuple[int, Pixels]:
        """Returns the number of the newest image, from 1 on, and its pixels (height, width, 3)."""
        with self._changed:
            assert self._pixels is not None  # the constructor waits for the first image
            return self._number, self._pixels

    @property
    def piece(self) -> Piece:
        with self._changed:
            age, interval = time.monotonic() - self._arrival, self._interval
            wrong, error = self._wrong_size, self._error
        if age > max(_LOST_AFTER, 3.0 * interval):
            return f"{self.name}: lost for {age:.0f} s{error and ', '}{error}", "bad"
        if wrong is not None:
            expected = f"{self.camera.width}x{self.camera.height}"
            what = f"sends images of {wrong[0]}x{wrong[1]} pixels; expected {expected} pixels"
            return f"{self.name}: {what}", "bad"
        rate = 1.0 / interval if interval > 0 else 0.0
        return f"{self.name}: {rate:.0f}/s", "good"

    def close(self) -> None:
        self._closing.set()
        self._thread.join(2.0)

    def __enter__(self) -> CameraFeed:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _run(self) -> None:
        read: Callable[[], None] = self._play if self.is_file else self._capture
        while not self._closing.is_set():
            try:
                read()
                continue
            except (RenderError, UsageError) as error:
                self._report(str(error).removeprefix(f"{self.what}: "))
            except Exception as error:  # OpenCV and FFmpeg raise any exception
                self._report(str(error) or type(error).__name__)
            self._closing.wait(_RETRY_INTERVAL)

    def _report(self, error: str) -> None:
        with self._changed:
            self._error = error
            self._changed.notify_all()

    def _take(self, pixels: Pixels) -> None:
        now = time.monotonic()
        size = (pixels.shape[1], pixels.shape[0])
        with self._changed:
            self._size = self._size or size
            # A reconnected camera may send images of another size.
            self._wrong_size = None if size == self._size else size
            elapsed = now - self._arrival
            if np.isfinite(elapsed):
                weight = _RATE_WEIGHT if self._interval else 1.0
                self._interval += weight * (elapsed - self._interval)
            self._arrival, self._error = now, ""
            if self._wrong_size is None:
                self._pixels = pixels
                self._number += 1
            self._changed.notify_all()

    def _play(self) -> None:
        with Video(Path(self.what)) as video:
            begin = time.monotonic()
            for at, pixels in video.frames():
                if self._closing.wait(max(begin + at - time.monotonic(), 0.0)):
                    return
                self._take(pixels)
            self._closing.wait(1.0 / video.fps)

    def _capture(self) -> None:
        cv2: Any = opencv()
        logging = cv2.utils.logging  # the status line shows the messages instead
        logging.setLogLevel(logging.LOG_LEVEL_SILENT)
        capture = cv2.VideoCapture(int(self.what) if self.what.isdecimal() else self.what)
        try:
            if not capture.isOpened():
                raise RenderError(
                    "there is no such camera, or it is in use; expected a camera number such as 0, "
                    "or a video"
                )
            if self._wanted is not None:
                capture.set(cv2.CAP_PROP_FRAME_WIDTH, self._wanted[0])
                capture.set(cv2.CAP_PROP_FRAME_HEIGHT, self._wanted[1])
            while not self._closing.is_set():
                is_read, image = capture.read()
                if not is_read:
                    raise RenderError("the camera stopped sending images")
                self._take(np.ascontiguousarray(image[..., ::-1]))
        finally:
            capture.release()


class VideoFeed:
    """Context manager that reads the frame of a video at the displayed time, also backward.

    The video starts at the displayed time `offset` in seconds. Frames are decoded on a separate
    thread. The last frame stays visible until the next one is decoded.

    Attributes:
        camera: camera that the camera file describes.

    Raises:
        RenderError: the video cannot be read.
        DeclarationError: the camera file is invalid, or is for images of another size.
    """

    def __init__(self, path: Path, camera_file: Path, offset: float) -> None:
        self.name = path.name
        self._video = Video(path)
        try:
            self.camera: PhotoCamera = read_camera(camera_file, self._video.size)
        except BaseException:
            self._video.close()
            raise
        self._offset = offset
        self._wanted = 0.0  # displayed time since the first frame, s
        self._number = 0
        self._end = self._video.duration
        self._pixels: Pixels | None = None
        self._error = ""
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="video", daemon=True)
        self._thread.start()
        with self._changed:
            self._changed.wait_for(
                lambda: self._pixels is not None or bool(self._error), _FIRST_TIMEOUT
            )

    def latest(self, time: float = 0.0) -> tuple[int, Pixels]:
        """Requests the frame at a displayed time in s, and returns the newest decoded frame.

        Frames have a number, from 1 on, and pixels, shape (height, width, 3). The number is 0, and
        the pixels are black, until a frame has been decoded.
        """
        with self._changed:
            self._wanted = time - self._offset
            self._changed.notify_all()
            if self._pixels is None:
                return 0, np.zeros((self.camera.height, self.camera.width, 3), np.uint8)
            return self._number, self._pixels

    @property
    def piece(self) -> Piece:
        with self._changed:
            wanted, error = self._wanted, self._error
        if error:
            return f"{self.name}: {error}", "bad"
        if wanted < 0:
            return f"{self.name}: starts in {-wanted:.1f} s", "quiet"
        if self._end and wanted > self._end:
            return f"{self.name}: ended {wanted - self._end:.1f} s ago", "quiet"
        return f"{self.name}: {wanted:.1f} s", "good"

    def close(self) -> None:
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(2.0)
        self._video.close()

    def __enter__(self) -> VideoFeed:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _run(self) -> None:
        try:
            while not self._closing:
                self._read_on()
        except Exception as error:  # damaged data; the last frame remains
            with self._changed:
                self._error = str(error) or type(error).__name__
                self._changed.notify_all()

    @property
    def _sought(self) -> float:
        return max(self._wanted, 0.0)

    def _read_on(self) -> None:
        last: tuple[float, Pixels] | None = None
        for frame in self._video.frames(self._sought):
            if last is not None and frame[0] > self._sought:
                self._show(last[1])
                if not self._wait_for_next(last[0], frame[0]):
                    return
            last = frame
        if last is not None:
            self._show(last[1])
            self._wait_for_next(last[0], np.inf)

    def _show(self, pixels: Pixels) -> None:
        with self._changed:
            self._number += 1
            self._pixels = pixels
            self._changed.notify_all()

    def _wait_for_next(self, at: float, end: float) -> bool:
        # Waits while the frame from `at` to `end` is displayed. Returns whether to decode the next
        # frame, instead of seeking.
        with self._changed:
            self._changed.wait_for(
                lambda: self._closing or not at - _TIME_TOLERANCE <= self._sought < end
            )
            return not self._closing and end <= self._sought < end + _MAX_SEQUENTIAL


def _size_in(camera_file: Path) -> tuple[int, int] | None:
    from .camera_file import read_intrinsics

    camera = read_intrinsics(camera_file)
    return camera.width, camera.height
