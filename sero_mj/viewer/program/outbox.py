"""`Outbox`: sends the viewer's process what has changed, on a thread of its own.

So a loop never waits for the viewer, not even for one that hangs: what changes while something is
being sent waits at its topic, which keeps the latest of it only, or a limited number of samples.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from ...base.errors import UsageError, shown
from ...base.frames import Array
from ..panels.user_widgets import check_label

_INTERVAL = 1 / 30  # s between two messages, at least


class Outbox:
    """Sends the messages of several topics.

    Args:
        send: sends a message to a tool of the view; returns whether it was there to receive it.
    """

    def __init__(self, send: Callable[[str, Any], bool]) -> None:
        self._send = send
        self._topics: dict[str, Callable[[], Any]] = {}
        self._has_news = threading.Event()
        self._is_closed = False

    def add(self, tool: str, take: Callable[[], Any]) -> None:
        """Adds a topic.

        Args:
            take: returns what has changed since the last call, None for nothing; called by another
                thread.
        """
        is_first = not self._topics
        self._topics[tool] = take
        if is_first:
            threading.Thread(target=self._run, daemon=True, name="sero-mj outbox").start()

    def wake(self) -> None:
        if not self._has_news.is_set():  # which is quicker than to set it again
            self._has_news.set()

    def close(self) -> None:
        self._is_closed = True
        self._has_news.set()

    def _run(self) -> None:
        while True:
            self._has_news.wait()
            self._has_news.clear()
            for tool, take in [*self._topics.items()]:
                message = take()
                if self._is_closed or (message is not None and not self._send(tool, message)):
                    return
            time.sleep(_INTERVAL)


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
