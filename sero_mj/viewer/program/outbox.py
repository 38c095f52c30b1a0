"""`Outbox`: sends the viewer's process what has changed, on a thread of its own.

So a loop never waits for the viewer, not even for one that hangs: what changes while something is
being sent waits at its topic, which keeps the latest of it only, or a limited number of samples.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

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
