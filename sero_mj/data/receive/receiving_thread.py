"""Thread in which a source receives packets. It restarts reception after every exception."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

MIN_PAUSE, MAX_PAUSE = 0.1, 5.0  # s between a failure and the next attempt


class Closing(Exception):
    """Raised in the receiving thread when its source is being closed."""


class Disconnected(Exception):
    """Raised if there is no connection to the sender, or if the connection has ended.

    Args:
        trouble: reason, which the source displays.
        detail: additional text for the log.
    """

    def __init__(self, trouble: str, detail: str = "") -> None:
        super().__init__(trouble)
        self.trouble, self.detail = trouble, detail


class Receives(Protocol):
    """The part of `Reception` that `ReceivingThread` uses."""

    @property
    def closing(self) -> threading.Event: ...

    @property
    def receive_trigger(self) -> int: ...

    def note_failure(self, error: BaseException) -> None: ...


class ReceivingThread:
    """Runs the reception of a source until the source is closed.

    If `receive` returns or raises an exception, it is called again after a pause of 0.1 s. The
    pause doubles up to 5 s with each attempt that receives no packets. `Disconnected` sets the
    source's `trouble`, and any other exception its `error`.

    Args:
        name: name of the thread.
        receive: function that receives packets until `source.closing` is set. Its argument is a
            socket that becomes readable at that time.
        interrupt: function that `end` calls to wake a `receive` that does not wait for the socket.
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
        """Waits until the thread has ended. Set `closing` of the source before."""
        self._waker.send(b"x")
        if self._interrupt is not None:
            self._interrupt()
        self._thread.join()
        self._wake.close()
        self._waker.close()

    def _run(self) -> None:
        source, pause = self._source, MIN_PAUSE
        while not source.closing.is_set():
            before = source.receive_trigger
            try:
                self._receive(self._wake)
            except Closing:
                return
            # Includes SystemExit, which would end the thread without a message.
            except BaseException as error:
                if source.closing.is_set():
                    return
                # Log handlers of the user may raise exceptions, too.
                with suppress(Exception):
                    source.note_failure(error)
            if source.receive_trigger > before:
                pause = MIN_PAUSE
            source.closing.wait(pause)
            pause = min(2.0 * pause, MAX_PAUSE)
