"""`BackgroundExports`: pages and films of what was kept, made while a viewer goes on."""

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

_KINDS = {".mp4": "film", ".html": "page"}
_GRACE = 10.0  # s for a process that is ended to remove its unfinished file


class BackgroundExports:
    """Makes pages and films, one after the other, each in a process of its own."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[list[str], Path]] = deque()
        self._made: tuple[ChildProcess, list[str], Path] | None = None

    def add(self, words: Sequence[str], path: Path) -> int:
        """Adds a file; returns how many are made before it. Any thread may call it.

        Args:
            words: command and arguments of `sero-mj`, but for the output.
            path: of the file.
        """
        self._waiting.append(([*words, "-o", str(path)], path))
        return len(self._waiting) - 1 + (self._made is not None)

    def add_page(self, recording: Path) -> int:
        return self.add(["export", str(recording)], recording.with_suffix(".html"))

    def advance(self) -> tuple[str, bool] | None:
        """Begins the next file when one is finished; returns what to tell, see `Tool`."""
        said = None
        if self._made is not None and self._made[0].status:
            said = self._end()
        if self._made is None and self._waiting:
            words, path = self._waiting.popleft()
            process = ChildProcess(
                [sys.executable, "-m", "sero_mj", *words],
                grace=_GRACE,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
            self._made = process, words, path
        return said

    def _end(self) -> tuple[str, bool]:
        assert self._made is not None
        child, _, path = self._made
        code, errors = child.process.wait(), child.lines()
        child.end()
        self._made = None
        kind = _KINDS[path.suffix]
        if code == 0:
            return f"{kind} of what was kept: {path.name}", False
        return f"no {kind} {path.name}: {errors[-1] if errors else 'it ended'}", True

    def close(self, *, finish: bool) -> None:
        """Finishes all files, until Ctrl+C, or ends them and logs how they can be made."""
        if finish:
            with contextlib.suppress(KeyboardInterrupt):
                self.advance()
                while self._made is not None:
                    log.warning("pages and films to be finished: %d; Ctrl+C ends them", self.count)
                    self._end()
                    self.advance()
        left = [words for words, _ in self._waiting]
        self._waiting.clear()
        if self._made is not None:
            child, words, path = self._made
            child.end()
            self._made = None
            path.unlink(missing_ok=True)  # as far as it was made
            left.insert(0, words)
        for words in left:
            log.warning(
                "%s was not finished; this makes it: %s",
                words[-1],
                shlex.join(["sero-mj", *words]),
            )

    @property
    def count(self) -> int:
        """Number of files that are not finished."""
        return len(self._waiting) + (self._made is not None)
