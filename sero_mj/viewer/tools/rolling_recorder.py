"""`RollingRecorder`: saves the last minute of live data as a recording, a page and a video."""

from __future__ import annotations

import logging
import math
import queue
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import ClassVar

from ...base.errors import SeroError
from ...data.drive.record_sources import record_last
from ...data.record.triggered_recorder import RecordedEvent
from ..session.background_exports import BackgroundExports
from ..session.capture import unused_name
from ..session.clock import HISTORY_SPAN
from ..session.tool import Action, Shown, Tool

log = logging.getLogger(__name__)

_SIGNALS_RATE = 100.0  # number of decoded values per second, which limits the time for a minute


class RollingRecorder(Tool):
    """Tool that stores packets of live sources in memory, and saves the last minute with the key k.

    Attributes:
        finishes_videos: whether `close` waits for unfinished pages and videos.
    """

    order: ClassVar[int] = 25  # `Pulling` has the same action `keep` and must come later.
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {
        "k": ("keep", "save the last minute of live data, or the pushes of a simulation")
    }
    finishes_videos = False

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        mirror = self._mirror = shown.mirror
        self._stack = ExitStack()
        self._messages: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        self._exports = BackgroundExports()
        self._paths: deque[Path] = deque()  # paths of the next recordings
        self._view: Sequence[str] = ()
        live = {name: each for name, each in mirror.sources.items() if each.is_live}
        self.is_on = bool(live)
        if not self.is_on:
            return
        self._recorder = self._stack.enter_context(
            record_last(
                live,
                lambda *_: self._paths.popleft(),
                mirror.world.scene,
                HISTORY_SPAN,
                _SIGNALS_RATE,
            )
        )
        self._recorder.on_event = self._on_event

    def actions(self) -> Mapping[str, Action]:
        return {"keep": self._save} if self.is_on else {}

    def _save(self) -> str:
        if self._recorder.error is not None:
            raise SeroError(f"the recorder has stopped: {self._recorder.error}")
        if not self._recorder.statistics.packets:
            return "no packets have been received yet"
        name, folder = self._mirror.world.scene.name, self.shown.folder or Path()
        path = unused_name(folder, name, ".mcap", datetime.now())
        self._paths.append(path)
        self._view = self.shown.render_words()
        self._recorder.record_now("saved by the user")
        return f"saving the last minute: {path.name}"

    def _on_event(self, event: RecordedEvent) -> None:
        if math.isnan(event.ended):
            return
        text = f"saved {event.ended - event.began:.1f} s: {event.path.name}"
        before = self._exports.add_page(event.path)
        if self._mirror.world.scene.file is not None:
            seconds = max(event.ended - event.began, 0.1)
            words = [*self._view, "--replay", str(event.path), "--duration", f"{seconds:.2f}"]
            self._exports.add(["render", *words], event.path.with_suffix(".mp4"))
        text += "; creating its page" + f" ({before} in the queue before it)" * bool(before)
        self._messages.put((text, False))

    def next_message(self) -> tuple[str, bool] | None:
        return self._exports.advance() or (None if self._messages.empty() else self._messages.get())

    def close(self) -> None:
        self._stack.close()
        if self.is_on:
            self._exports.close(finish=self.finishes_videos)
