"""`UserSignals`: what a program plots in its viewer, from the side of the program."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

from ...base.errors import UsageError, shown
from ...base.frames import Array
from ..panels.user_widgets import check_label
from .outbox import Outbox

TOOL = "plot"  # that shows them

_MOST = 100  # signals
_UNSENT = 20_000  # samples of a signal that wait to be sent; the oldest are dropped


class UserSignals:
    """Samples that were not sent yet."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox
        self._unsent: dict[str, deque[tuple[float, float]]] = {}

    def add(self, name: str, value: float) -> None:
        """Adds a sample at the current time; takes about a microsecond.

        Raises:
            UsageError: no name, no number, or more than 100 signals.
        """
        unsent = self._unsent.get(name)
        if unsent is None:
            unsent = self._begin(name)
        try:
            unsent.append((time.monotonic(), float(value)))
        except (TypeError, ValueError):
            raise UsageError(f"plot '{name}': found {shown(value)}; expected a number") from None
        self._outbox.wake()

    def _begin(self, name: str) -> deque[tuple[float, float]]:
        check_label("plot", name)
        if len(self._unsent) == _MOST:
            raise UsageError(f"plot '{name}': found {_MOST + 1} signals; expected at most {_MOST}")
        unsent: deque[tuple[float, float]] = deque(maxlen=_UNSENT)
        self._unsent[name] = unsent
        if len(self._unsent) == 1:
            self._outbox.add(TOOL, self._take)
        return unsent

    def _take(self) -> dict[str, Array] | None:
        taken = {}
        for name, unsent in [*self._unsent.items()]:
            count = len(unsent)  # what is added meanwhile is for the next time
            if count:
                taken[name] = np.array([unsent.popleft() for _ in range(count)])
        return taken or None
