"""`ImageWriter`: writes screenshots and videos on a background thread."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime
from pathlib import Path

from ...base.errors import SeroError
from ..image.image_files import Pixels, VideoWriter, save_image

FPS = 30.0
# If the queue has this number of frames, new frames are dropped, and the next one is repeated.
_MAX_WAITING = 8
_used: set[Path] = set()  # returned file names, whose files may not exist yet


def unused_name(folder: Path, scene: str, ending: str, now: datetime) -> Path:
    """Returns an unused file name, such as `lwr_2026-05-04_17-03-12.png`.

    No name is returned twice, because the files may be written later.

    Args:
        ending: file extension with a leading dot.
    """
    safe = "".join(c if c.isalnum() or c in "-_" else "_" for c in scene) or "scene"
    stem = f"{safe}_{now:%Y-%m-%d_%H-%M-%S}"
    path = folder / f"{stem}{ending}"
    count = 2
    while path.exists() or path.absolute() in _used:
        path = folder / f"{stem}_{count}{ending}"
        count += 1
    _used.add(path.absolute())
    return path


def due_frames(seconds: float, sent: int) -> int:
    """Returns the number of frames that a video of `seconds` needs in addition to `sent` frames."""
    return max(int(seconds * FPS) + 1 - sent, 0)


class ImageWriter:
    """Writes screenshots and videos of a scene on a background thread.

    Attributes:
        seconds: duration of the current video in seconds.
    """

    def __init__(self, scene: str, folder: Path | None = None) -> None:
        self.seconds = 0.0
        self._scene = scene
        self._folder = folder or Path()
        self._pool = ThreadPoolExecutor(1, "images")
        self._pending: list[tuple[Future[None], str, Path]] = []
        self._waiting = threading.Semaphore(_MAX_WAITING)
        self._video: VideoWriter | None = None
        self._video_path = Path()
        self._size = (0, 0)
        self._begin = 0.0
        self._sent = 0

    @property
    def is_recording(self) -> bool:
        return self._video is not None

    def save_screenshot(self, pixels: Pixels) -> None:
        path = unused_name(self._folder, self._scene, ".png", datetime.now())
        future = self._pool.submit(save_image, path, pixels)
        self._pending.append((future, "screenshot", path))

    def start(self, size: tuple[int, int], time: float) -> str:
        """Starts a video at a time in seconds, and returns a message for the user."""
        path = unused_name(self._folder, self._scene, ".mp4", datetime.now())
        self._video, self._video_path = VideoWriter(path, *size, FPS), path
        self._size, self._begin, self._sent = size, time, 0
        self.seconds = 0.0
        return f"recording a video: {path}"

    def wants(self, time: float) -> bool:
        return self.is_recording and due_frames(time - self._begin, self._sent) > 0

    def add(self, pixels: Pixels, time: float) -> None:
        """Adds the current image to the video, or stops the video if the image size has changed."""
        video = self._video
        if video is None:
            return
        if pixels.shape[1::-1] != self._size:
            self.stop()
            return
        self.seconds = time - self._begin
        if not self._waiting.acquire(blocking=False):
            return  # The encoder is too slow, and the next frame replaces this one.
        count = due_frames(self.seconds, self._sent)
        self._sent += count

        def write() -> None:
            try:
                for _ in range(count):
                    video.add(pixels)
            finally:
                self._waiting.release()

        self._pool.submit(write)

    def stop(self) -> None:
        """Stops the video. After the file is written, `next_message` returns a message."""
        video, self._video = self._video, None
        if video is not None:
            future = self._pool.submit(video.__exit__, None, None, None)
            self._pending.append((future, f"video of {self.seconds:.1f} s", self._video_path))

    def next_message(self) -> tuple[str, bool] | None:
        """Returns a message about a written file and whether it is an error, or None."""
        for each in self._pending:
            future, what, path = each
            if future.done():
                self._pending.remove(each)
                error = future.exception()
                if error is None:
                    return f"{what} saved: {path}", False
                reason = error if isinstance(error, SeroError) else f"cannot write {path}: {error}"
                return str(reason), True
        return None

    def close(self) -> None:
        self.stop()
        self._pool.shutdown()
