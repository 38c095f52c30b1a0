"""A line that a live host shows its user for a few seconds."""

from __future__ import annotations

import time

_SECONDS = 3.0
_BAD_SECONDS = 9.0


class Notice:
    """The line that was said last.

    Attributes:
        text: what was said.
        is_bad: whether something went wrong.
    """

    def __init__(self) -> None:
        self.text, self.is_bad = "", False
        self._until = float("-inf")

    @property
    def is_shown(self) -> bool:
        """Whether it was said a short while ago."""
        return time.monotonic() < self._until

    def say(self, text: str, *, is_bad: bool = False) -> None:
        """Shows a line; what is bad stays longer."""
        self.text, self.is_bad = text, is_bad
        self._until = time.monotonic() + (_BAD_SECONDS if is_bad else _SECONDS)
