"""`Undo`: takes back what a user has changed, and does it again."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Generic, TypeVar

State = TypeVar("State")

_RESTS = 0.3  # s without a change after which what was changed is one step
_MOST = 200


class Undo(Generic[State]):
    """Watches a state from frame to frame; what changes without a rest is one step.

    Args:
        read: returns the state; equal ones are one.
        write: sets it.
    """

    def __init__(self, read: Callable[[], State], write: Callable[[State], None]) -> None:
        self._read, self._write = read, write
        self._past: list[State] = []
        self._future: list[State] = []
        self._kept = self._seen = read()  # that a step leads back to, and that of the last frame
        self._changed = float("-inf")

    def watch(self, now: float | None = None) -> None:
        """Looks at the state; call it in every frame.

        Args:
            now: s on the clock of `time.monotonic`; the time when None.
        """
        now = time.monotonic() if now is None else now
        state = self._read()
        if state != self._seen:
            self._seen, self._changed = state, now
        elif state != self._kept and now - self._changed > _RESTS:
            self._settle()

    def overlook(self) -> None:
        """Takes the state as it is now for that of the last frame: the user did not change it."""
        is_settled = self._seen == self._kept
        self._seen = self._read()
        if is_settled:
            self._kept = self._seen

    def _settle(self) -> None:
        """Makes a step of what has changed since the last one."""
        if self._seen != self._kept:
            self._past = [*self._past, self._kept][-_MOST:]
            self._future.clear()
            self._kept = self._seen

    def undo(self) -> str:
        """Takes the last step back; returns what to tell the user."""
        self._seen = self._read()
        self._settle()
        if not self._past:
            return "nothing to undo"
        self._future.append(self._kept)
        self._go(self._past.pop())
        return "undone; Ctrl+Y does it again"

    def redo(self) -> str:
        """Does again what was undone; returns what to tell the user."""
        self._seen = self._read()
        self._settle()
        if not self._future:
            return "nothing to do again"
        self._past.append(self._kept)
        self._go(self._future.pop())
        return "done again"

    def _go(self, state: State) -> None:
        self._write(state)
        self._kept = self._seen = self._read()
