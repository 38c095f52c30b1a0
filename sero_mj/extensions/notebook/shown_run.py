"""`ShownRun`: captures the last minute of displayed frames as a run for a notebook."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Any, ClassVar

import numpy as np

from ...viewer.decor.feature import Frame
from ...viewer.player.capture import FrameCapturer
from ...viewer.player.encode import encode
from ...viewer.player.frame import CapturedFrame
from ...viewer.player.page import packed
from ...viewer.session.tool import Shown, Tool

SPAN = 60.0  # duration of the stored run, s
_FPS = 20.0
_MAX_REST = 0.5  # maximum time between two different frames in the run, s
_INTERVAL = 10.0  # minimum time between two stored runs, s


class ShownRun(Tool):
    """Tool that captures displayed frames after the notebook has sent the message `begin`."""

    order: ClassVar[int] = 80

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        self._capturer: FrameCapturer | None = None
        self._frames: deque[tuple[float, CapturedFrame]] = deque()
        self._taken = 0.0  # time of the last frame on the clock of `time.monotonic`, s
        self._time = 0.0  # time of the last frame in the run, s
        self._sent = 0.0  # time of the last run on the clock of `time.monotonic`, s
        self._is_new = False
        self._thread: threading.Thread | None = None
        self._run: str | None = None  # finished run that was not sent yet

    def receive(self, message: str) -> None:
        """Starts capturing for `begin`. For `now`, the next `reply` creates a run at once."""
        if message == "now":
            self._sent, self._is_new = 0.0, bool(self._frames)
        elif self._capturer is None:
            self._capturer = FrameCapturer(self.shown.world, self.shown.view_camera)

    def draw(self, frame: Frame) -> None:
        """Captures a frame if it differs from the last captured one."""
        now = time.monotonic()
        passed = now - self._taken
        if self._capturer is None or passed < 1.0 / _FPS - 1e-3:
            return
        found = self._capturer.take(self.shown.data)
        if self._frames and _are_equal(found, self._frames[-1][1]):
            return
        self._taken, self._is_new = now, True
        self._time += min(passed, _MAX_REST) if self._frames else 0.0
        self._frames.append((self._time, found))
        while self._time - self._frames[0][0] > SPAN:
            self._frames.popleft()

    def reply(self) -> str | None:
        """Returns a new run in the format of `packed`, or None if none is finished."""
        run, self._run = self._run, None
        is_making = self._thread is not None and self._thread.is_alive()
        if run is None and self._is_new and not is_making:
            now = time.monotonic()
            if now - self._sent > _INTERVAL:
                self._sent, self._is_new = now, False
                self._thread = threading.Thread(target=self._make, args=([*self._frames],))
                self._thread.start()
        return run

    def _make(self, frames: list[tuple[float, CapturedFrame]]) -> None:
        capturer = self._capturer
        assert capturer is not None
        times = np.array([time for time, _ in frames])
        grid = np.arange(times[0], times[-1] + 0.5 / _FPS, 1.0 / _FPS)
        rows = np.searchsorted(times, grid + 0.25 / _FPS, side="right") - 1
        chosen = [frames[row][1] for row in rows.tolist()]
        captured = capturer.result(chosen, fps=_FPS, toggles=self.shown.toggles)
        self._run = packed(encode(captured, self.shown.world.scene.name))


def _are_equal(one: CapturedFrame, other: CapturedFrame) -> bool:
    def same(a: Any, b: Any) -> bool:
        return bool(np.array_equal(a, b, equal_nan=True))

    return (
        same(one.poses, other.poses)
        and same(one.opacity, other.opacity)
        and same(one.stale, other.stale)
        and all(same(each, other.values[key]) for key, each in one.values.items())
        and same(one.soft.vertices, other.soft.vertices)
        and one.arrow_texts == other.arrow_texts
        and one.note == other.note
        and one.legend == other.legend
    )
