"""`RollingRecorder`: keeps what live sources sent in the last minute, as a recording and a film."""

from __future__ import annotations

import contextlib
import logging
import math
import queue
import shlex
import subprocess
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path
from typing import ClassVar

from ...base.errors import SeroError
from ...data.drive.record_sources import record_last
from ...data.record.triggered_recorder import RecordedEvent
from ..session.capture import unused_name
from ..session.live_history import SPAN
from ..session.tool import Action, Shown, Tool

log = logging.getLogger(__name__)

# Renders in a process of its own, which ends when the viewer does, however that ends: the viewer's
# end of the pipe is closed then.
_RENDER = """
import os, signal, threading

def end_with_the_viewer():
    os.read(0, 1)
    os.kill(os.getpid(), signal.SIGTERM)

threading.Thread(target=end_with_the_viewer, daemon=True).start()
from sero_mj.__main__ import main
main()
"""
_SIGNALS_RATE = 100.0  # Hz of decoded values: of a minute they would take seconds at more


class RollingRecorder(Tool):
    """Remembers the packets of a mirror's live sources, and writes those of the last minute.

    Args:
        shown: where it works.

    Attributes:
        is_on: whether there are live sources.
        finishes_films: whether `close` waits for the films that are not finished.
    """

    order: ClassVar[int] = 25  # before what is pulled is kept
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {
        "k": ("keep", "keep the last minute of what is live, or what was pushed")
    }
    finishes_films = False

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        mirror = self._mirror = shown.mirror
        self._stack = ExitStack()
        self._said: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        self._films = Films()
        self._path = Path()
        self._view: Sequence[str] = ()
        live = {name: each for name, each in mirror.sources.items() if each.is_live}
        self.is_on = bool(live)
        if not self.is_on:
            return
        self._recorder = self._stack.enter_context(
            record_last(live, lambda *_: self._path, mirror.world.scene, SPAN, _SIGNALS_RATE)
        )
        self._recorder.on_event = self._on_event

    def actions(self) -> Mapping[str, Action]:
        """See `Tool`."""
        return {"keep": self._keep} if self.is_on else {}

    def _keep(self) -> str:
        """Writes what came in the last minute; returns what to tell the user.

        Raises:
            SeroError: an earlier one could not be written; nothing is remembered since.
        """
        if self._recorder.error is not None:
            raise SeroError(f"nothing is kept any more: {self._recorder.error}")
        if not self._recorder.statistics.packets:
            return "nothing has come yet that could be kept"
        name, folder = self._mirror.world.scene.name, self.shown.folder or Path()
        self._path = unused_name(folder, name, ".mcap", datetime.now())
        self._view = self.shown.render_words()
        self._recorder.record_now("kept by hand")
        return f"keeps the last minute: {self._path.name}"

    def _on_event(self, event: RecordedEvent) -> None:
        """Called on the recorder's thread, when an event begins, and when it is complete."""
        if math.isnan(event.ended):
            return
        text = f"kept {event.ended - event.began:.1f} s: {event.path.name}"
        if self._mirror.world.scene.file is not None:
            seconds = max(event.ended - event.began, 0.1)
            words = [*self._view, "--replay", str(event.path), "--duration", f"{seconds:.2f}"]
            before = self._films.add(words, event.path.with_suffix(".mp4"))
            text += f"; film after {before} more" if before else "; its film is made"
        self._said.put((text, False))

    def next_message(self) -> tuple[str, bool] | None:
        """What to tell the user, and whether it is an error; None for nothing."""
        return self._films.advance() or (None if self._said.empty() else self._said.get())

    def close(self) -> None:
        """Ends it, after recordings are complete, and with it the films, see `finishes_films`."""
        self._stack.close()
        if self.is_on:
            self._films.close(finish=self.finishes_films)


class Films:
    """Renders films of what was kept, one after the other, each in a process of its own."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[list[str], Path]] = deque()
        self._made: tuple[subprocess.Popen[str], list[str], Path] | None = None

    def add(self, words: Sequence[str], path: Path) -> int:
        """Adds a film; returns how many are made before it. Any thread may call it.

        Args:
            words: arguments of `sero-mj render` but for the output.
            path: of the film.
        """
        self._waiting.append(([*words, "-o", str(path)], path))
        return len(self._waiting) - 1 + (self._made is not None)

    def advance(self) -> tuple[str, bool] | None:
        """Begins the next film when one is finished; returns what to tell, as `next_message`."""
        said = None
        if self._made is not None and self._made[0].poll() is not None:
            said = self._end()
        if self._made is None and self._waiting:
            words, path = self._waiting.popleft()
            process = subprocess.Popen(
                [sys.executable, "-c", _RENDER, "render", *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            self._made = process, words, path
        return said

    def _end(self) -> tuple[str, bool]:
        """Waits for the film that is made; returns what to tell of it."""
        assert self._made is not None
        process, _, path = self._made
        with process:  # its input is closed at the end, which would have ended it before
            assert process.stderr is not None
            errors = process.stderr.read().strip()
            process.wait()
        self._made = None
        if process.returncode == 0:
            return f"film of what was kept: {path.name}", False
        return f"no film {path.name}: {errors.splitlines()[-1] if errors else 'it ended'}", True

    def close(self, *, finish: bool) -> None:
        """Finishes all films, until Ctrl+C, or ends them and logs how they can be made."""
        if finish:
            with contextlib.suppress(KeyboardInterrupt):
                self.advance()
                while self._made is not None:
                    log.warning("films to be finished: %d; Ctrl+C ends them", self.count)
                    self._end()
                    self.advance()
        left = [words for words, _ in self._waiting]
        self._waiting.clear()
        if self._made is not None:
            process, words, path = self._made
            process.terminate()
            self._end()
            path.unlink(missing_ok=True)  # as far as it was made
            left.insert(0, words)
        for words in left:
            log.warning(
                "a film was not finished; this makes it: %s",
                shlex.join(["sero-mj", "render", *words]),
            )

    @property
    def count(self) -> int:
        """Number of films that are not finished."""
        return len(self._waiting) + (self._made is not None)
