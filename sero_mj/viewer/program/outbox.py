"""`Outbox`: sends changes to the viewer's process on a thread. `UserSignals`: plotted samples.

The user's loop never waits for the viewer, even if the viewer hangs. Changes are collected while a
message is being sent.
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

_INTERVAL = 1 / 30  # minimum time between messages, s


class Outbox:
    """Thread that collects changes for tools of the viewer, and sends them as messages.

    Args:
        send: function that sends a message to a tool of the viewer, and returns False if the
            viewer has ended.
    """

    def __init__(self, send: Callable[[str, Any], bool]) -> None:
        self._send = send
        self._topics: dict[str, Callable[[], Any]] = {}
        self._has_news = threading.Event()
        self._is_closed = False

    def add(self, tool: str, take: Callable[[], Any]) -> None:
        """Adds a tool that receives changes.

        Args:
            tool: name of the tool.
            take: function that returns the changes since its last call, or None. The outbox calls
                it on another thread.
        """
        is_first = not self._topics
        self._topics[tool] = take
        if is_first:
            threading.Thread(target=self._run, daemon=True, name="sero-mj outbox").start()

    def wake(self) -> None:
        if not self._has_news.is_set():  # This check is faster than setting the event again.
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


TOOL = "plot"  # name of the tool that shows the signals

_MAX_SIGNALS = 100
_MAX_UNSENT = 20_000  # maximum number of unsent samples of a signal; older ones are dropped


class UserSignals:
    """The samples of plotted signals that have not been sent to the viewer yet."""

    def __init__(self, outbox: Outbox) -> None:
        self._outbox = outbox
        self._unsent: dict[str, deque[tuple[float, float]]] = {}

    def add(self, name: str, value: float) -> None:
        """Adds a sample at the current time. A call takes about 1 us.

        Raises:
            UsageError: the name or the value is invalid, or there are more than 100 signals.
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
        if len(self._unsent) == _MAX_SIGNALS:
            raise UsageError(
                f"plot '{name}': found {_MAX_SIGNALS + 1} signals; expected at most {_MAX_SIGNALS}"
            )
        unsent: deque[tuple[float, float]] = deque(maxlen=_MAX_UNSENT)
        self._unsent[name] = unsent
        if len(self._unsent) == 1:
            self._outbox.add(TOOL, self._take)
        return unsent

    def _take(self) -> dict[str, Array] | None:
        taken = {}
        for name, unsent in [*self._unsent.items()]:
            count = len(unsent)  # Samples that are added meanwhile are sent next time.
            if count:
                taken[name] = np.array([unsent.popleft() for _ in range(count)])
        return taken or None
