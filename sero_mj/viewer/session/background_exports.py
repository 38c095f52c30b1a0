"""`BackgroundExports`: creates pages and videos of recordings in separate processes."""

from __future__ import annotations

import contextlib
import logging
import shlex
import subprocess
import sys
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from ...base.child_process import ChildProcess

log = logging.getLogger(__name__)

_KINDS = {".mp4": "video", ".html": "page"}
_GRACE = 10.0  # time that a terminated process has to remove its unfinished file, s


class BackgroundExports:
    """Queue of pages and videos, which are created one by one in separate processes."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[list[str], Path]] = deque()
        self._made: tuple[ChildProcess, list[str], Path] | None = None

    def add(self, words: Sequence[str], path: Path) -> int:
        """Queues a file, and returns the number of files before it. Thread-safe.

        Args:
            words: arguments of `sero-mj` that create the file, without `-o`.
        """
        self._waiting.append(([*words, "-o", str(path)], path))
        return len(self._waiting) - 1 + (self._made is not None)

    def add_page(self, recording: Path) -> int:
        return self.add(["export", str(recording)], recording.with_suffix(".html"))

    def advance(self) -> tuple[str, bool] | None:
        """Starts the next file if the current one is finished, and returns a message about it."""
        message = None
        if self._made is not None and self._made[0].status:
            message = self._end()
        if self._made is None and self._waiting:
            words, path = self._waiting.popleft()
            process = ChildProcess(
                [sys.executable, "-m", "sero_mj", *words],
                grace=_GRACE,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
            self._made = process, words, path
        return message

    def _end(self) -> tuple[str, bool]:
        assert self._made is not None
        child, _, path = self._made
        code, errors = child.process.wait(), child.lines()
        child.end()
        self._made = None
        kind = _KINDS[path.suffix]
        if code == 0:
            return f"{kind} saved: {path.name}", False
        reason = errors[-1] if errors else f"the process returned {code}"
        return f"{kind} {path.name} failed: {reason}", True

    def close(self, *, finish: bool) -> None:
        """Cancels all unfinished files, and logs the commands that create them.

        If `finish` is set, first waits until all files are finished or the user presses Ctrl+C.
        """
        if finish:
            with contextlib.suppress(KeyboardInterrupt):
                self.advance()
                while self._made is not None:
                    log.warning("finishing %d pages and videos; Ctrl+C cancels them", self.count)
                    self._end()
                    self.advance()
        left = [words for words, _ in self._waiting]
        self._waiting.clear()
        if self._made is not None:
            child, words, path = self._made
            child.end()
            self._made = None
            path.unlink(missing_ok=True)
            left.insert(0, words)
        for words in left:
            log.warning(
                "%s was not finished; create it with: %s",
                words[-1],
                shlex.join(["sero-mj", *words]),
            )

    @property
    def count(self) -> int:
        return len(self._waiting) + (self._made is not None)
