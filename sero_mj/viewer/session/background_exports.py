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

log = logging.getLogger(__name__)

# A process of its own, which ends when the viewer does, however that ends: the viewer's
# end of the pipe is closed then.
_PROGRAM = """
import os, signal, threading

def end_with_the_viewer():
    os.read(0, 1)
    os.kill(os.getpid(), signal.SIGTERM)

threading.Thread(target=end_with_the_viewer, daemon=True).start()
from sero_mj.__main__ import main
main()
"""
_KINDS = {".mp4": "film", ".html": "page"}


class BackgroundExports:
    """Makes pages and films, one after the other, each in a process of its own."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[list[str], Path]] = deque()
        self._made: tuple[subprocess.Popen[str], list[str], Path] | None = None

    def add(self, words: Sequence[str], path: Path) -> int:
        """Adds a file; returns how many are made before it. Any thread may call it.

        Args:
            words: command and arguments of `sero-mj`, but for the output.
            path: of the file.
        """
        self._waiting.append(([*words, "-o", str(path)], path))
        return len(self._waiting) - 1 + (self._made is not None)

    def add_page(self, recording: Path) -> int:
        """Adds the page of a recording, beside it; see `add`."""
        return self.add(["export", str(recording)], recording.with_suffix(".html"))

    def advance(self) -> tuple[str, bool] | None:
        """Begins the next file when one is finished; returns what to tell, see `Tool`."""
        said = None
        if self._made is not None and self._made[0].poll() is not None:
            said = self._end()
        if self._made is None and self._waiting:
            words, path = self._waiting.popleft()
            process = subprocess.Popen(
                [sys.executable, "-c", _PROGRAM, *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
            self._made = process, words, path
        return said

    def _end(self) -> tuple[str, bool]:
        """Waits for the file that is made; returns what to tell of it."""
        assert self._made is not None
        process, _, path = self._made
        with process:  # its input is closed at the end, which would have ended it before
            assert process.stderr is not None
            errors = process.stderr.read().strip()
            process.wait()
        self._made = None
        kind = _KINDS[path.suffix]
        if process.returncode == 0:
            return f"{kind} of what was kept: {path.name}", False
        return f"no {kind} {path.name}: {errors.splitlines()[-1] if errors else 'it ended'}", True

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
            process, words, path = self._made
            process.terminate()
            self._end()
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
