"""Screenshots and films of live hosts, written on a thread so that frames do not wait for it."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import datetime
from pathlib import Path

from ...base.errors import SeroError
from ..image.image_files import Pixels, VideoWriter, save_image

FPS = 30.0
# Maximum number of queued frames; further ones are replaced by a longer following frame.
_MAX_WAITING = 8
_given: set[Path] = set()  # names of files that may not be there yet


def unused_name(folder: Path, scene: str, ending: str, now: datetime) -> Path:
    """Returns an unused file name: `lwr_2026-05-04_17-03-12.png`; no name is returned twice.

    The file may be written later, by another thread.

    Args:
        ending: extension with its dot.
    """
    safe = "".join(c if c.isalnum() or c in "-_" else "_" for c in scene) or "scene"
    stem = f"{safe}_{now:%Y-%m-%d_%H-%M-%S}"
    path = folder / f"{stem}{ending}"
    count = 2
    while path.exists() or path.absolute() in _given:
        path = folder / f"{stem}_{count}{ending}"
        count += 1
    _given.add(path.absolute())
    return path


def due_frames(seconds: float, sent: int) -> int:
    """Returns how often to add the current picture, so that the film shows real time."""
    return max(int(seconds * FPS) + 1 - sent, 0)


class PictureWriter:
    """Writes screenshots and films."""

    def __init__(self, scene: str, folder: Path | None = None) -> None:
        self.seconds = 0.0
        self._scene = scene
        self._folder = folder or Path()
        self._pool = ThreadPoolExecutor(1, "pictures")
        self._pending: list[tuple[Future[None], str, Path]] = []
        self._waiting = threading.Semaphore(_MAX_WAITING)
        self._film: VideoWriter | None = None
        self._film_path = Path()
        self._size = (0, 0)
        self._begin = 0.0
        self._sent = 0

    @property
    def is_filming(self) -> bool:
        return self._film is not None

    def picture(self, pixels: Pixels) -> None:
        path = unused_name(self._folder, self._scene, ".png", datetime.now())
        future = self._pool.submit(save_image, path, pixels)
        self._pending.append((future, "screenshot", path))

    def start(self, size: tuple[int, int], time: float) -> str:
        """Starts a film and returns a message for the user."""
        path = unused_name(self._folder, self._scene, ".mp4", datetime.now())
        self._film, self._film_path = VideoWriter(path, *size, FPS), path
        self._size, self._begin, self._sent = size, time, 0
        self.seconds = 0.0
        return f"filming to {path}"

    def wants(self, time: float) -> bool:
        return self.is_filming and due_frames(time - self._begin, self._sent) > 0

    def add(self, pixels: Pixels, time: float) -> None:
        """Adds the current picture; stops the film when the window has another size."""
        film = self._film
        if film is None:
            return
        if pixels.shape[1::-1] != self._size:
            self.stop()
            return
        self.seconds = time - self._begin
        if not self._waiting.acquire(blocking=False):
            return  # the encoder is too slow; the next picture replaces this one
        count = due_frames(self.seconds, self._sent)
        self._sent += count

        def write() -> None:
            try:
                for _ in range(count):
                    film.add(pixels)
            finally:
                self._waiting.release()

        self._pool.submit(write)

    def stop(self) -> None:
        """Stops the film; `next_message` reports when it is written."""
        film, self._film = self._film, None
        if film is not None:
            future = self._pool.submit(film.__exit__, None, None, None)
            self._pending.append((future, f"film of {self.seconds:.1f} s", self._film_path))

    def next_message(self) -> tuple[str, bool] | None:
        """Returns a message about the next completed file and whether it is an error, or None."""
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
