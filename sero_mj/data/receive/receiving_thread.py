"""`ReceivingThread`: the guarded thread on which every source receives.

No exception ends it: the source shows what failed, and reception restarts.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

SHORTEST, LONGEST = 0.1, 5.0  # s from a failure to the next attempt


class ClosedHere(Exception):
    """The source is being closed."""


class Disconnected(Exception):
    """There is no connection to the sender, or it has ended."""

    def __init__(self, trouble: str, detail: str = "") -> None:
        super().__init__(trouble)
        self.trouble, self.detail = trouble, detail


class Receives(Protocol):
    """What a source has for its thread."""

    @property
    def closing(self) -> threading.Event:
        """Set while the source is being closed."""

    @property
    def receive_trigger(self) -> int:
        """Number of good packets."""

    def note_failure(self, error: BaseException) -> None:
        """Shows that reception has failed."""


class ReceivingThread:
    """Runs the reception of a source until the source is closed.

    When `receive` returns or raises, it is called again after a pause. The pause is 0.1 s after an
    attempt that received packets, and doubles up to 5 s after others. `Disconnected` becomes the
    source's `trouble`, any other exception its `error`.

    Args:
        receive: receives packets until `source.closing` is set; its argument becomes readable then.
        interrupt: called by `end`, for a `receive` that waits for something else than the socket.
    """

    def __init__(
        self,
        source: Receives,
        name: str,
        receive: Callable[[socket.socket], object],
        interrupt: Callable[[], object] | None = None,
    ) -> None:
        self._source, self._receive, self._interrupt = source, receive, interrupt
        self._wake, self._waker = socket.socketpair()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    @property
    def is_current(self) -> bool:
        return threading.current_thread() is self._thread

    def end(self) -> None:
        """Ends the thread and waits for it; the source's `closing` must be set."""
        self._waker.send(b"x")
        if self._interrupt is not None:
            self._interrupt()
        self._thread.join()
        self._wake.close()
        self._waker.close()

    def _run(self) -> None:
        source, pause = self._source, SHORTEST
        while not source.closing.is_set():
            before = source.receive_trigger
            try:
                self._receive(self._wake)
            except ClosedHere:
                return
            # SystemExit as well, which would end the thread without a message.
            except BaseException as error:
                if source.closing.is_set():
                    return
                # Not even a handler of log messages that fails ends the thread.
                with suppress(Exception):
                    source.note_failure(error)
            if source.receive_trigger > before:
                pause = SHORTEST
            source.closing.wait(pause)
            pause = min(2.0 * pause, LONGEST)
