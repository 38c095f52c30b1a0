"""`Message`: what hosts tell their user over the picture for a few seconds."""

from __future__ import annotations

import time
from typing import NamedTuple

from ..session.status_line import Piece


class Message(NamedTuple):
    """A message to the user, shown for a few seconds."""

    text: str = ""
    is_bad: bool = False
    until: float = float("-inf")  # on the clock of `time.monotonic`, s

    @property
    def is_shown(self) -> bool:
        return time.monotonic() < self.until

    @property
    def piece(self) -> Piece:
        """Its words and mood: red for an error."""
        return self.text, "bad" if self.is_bad else "plain"
