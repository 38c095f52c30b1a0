"""`Keeping`: keeps what live sources sent in the last minute, as a recording and a film."""

from __future__ import annotations

import math
import queue
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path

from ..drive.mirror import LiveWorld
from ..drive.record_sources import record_last
from ..errors import SeroError
from ..record.triggered_recorder import RecordedEvent
from .capture import unused_name
from .live_history import SPAN

_SIGNALS_RATE = 100.0  # Hz of decoded values: of a minute they would take seconds at more


class Keeping:
    """Remembers the packets of a mirror's live sources, and writes those of the last minute.

    Args:
        mirror: whose sources these are.

    Attributes:
        is_on: whether there are such sources.
    """

    def __init__(self, mirror: LiveWorld) -> None:
        self._mirror = mirror
        self._stack = ExitStack()
        self._said: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        self._films: list[tuple[subprocess.Popen[str], Path]] = []
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

    def keep(self, folder: Path, view: Sequence[str]) -> str:
        """Writes what came in the last minute; returns what to tell the user.

        Args:
            folder: of the recording and the film.
            view: the film's scene, camera and switches, as arguments of `sero-mj render`.

        Raises:
            SeroError: an earlier one could not be written; nothing is remembered since.
        """
        if self._recorder.error is not None:
            raise SeroError(f"nothing is kept any more: {self._recorder.error}")
        if not self._recorder.statistics.packets:
            return "nothing has come yet that could be kept"
        name = self._mirror.world.scene.name
        self._path, self._view = unused_name(folder, name, ".mcap", datetime.now()), view
        self._recorder.record_now("kept by hand")
        return f"keeps the last minute: {self._path.name}"

    def _on_event(self, event: RecordedEvent) -> None:
        """Called on the recorder's thread, when an event begins, and when it is complete."""
        if math.isnan(event.ended):
            return
        text = f"kept {event.ended - event.began:.1f} s, {event.packets} packets: {event.path.name}"
        film = self._make_film(event)
        self._said.put((f"{text}; its film is being made" if film else text, False))

    def _make_film(self, event: RecordedEvent) -> bool:
        """Begins to render what was kept in another process, if its scene is in a file."""
        if self._mirror.world.scene.file is None:
            return False
        path, seconds = event.path.with_suffix(".mp4"), max(event.ended - event.began, 0.1)
        command = [sys.executable, "-m", "sero_mj", "render", *self._view,
                   "--replay", str(event.path), "--duration", f"{seconds:.2f}",
                   "-o", str(path)]  # fmt: skip
        self._films.append((
            subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True),
            path,
        ))  # fmt: skip
        return True

    def next_message(self) -> tuple[str, bool] | None:
        """What to tell the user, and whether it is an error; None for nothing."""
        for each in self._films:
            process, path = each
            if process.poll() is not None:
                self._films.remove(each)
                said = process.stderr.read().strip() if process.stderr is not None else ""
                if process.returncode == 0:
                    return f"film of what was kept: {path.name}", False
                return f"no film {path.name}: {said.splitlines()[-1] if said else 'it ended'}", True
        return None if self._said.empty() else self._said.get()

    def close(self) -> None:
        """Ends it, after recordings are complete; a film that is being made goes on."""
        self._stack.close()
