"""Commands that run until somebody ends them, and then say what they have seen."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def until_ended() -> Iterator[None]:
    """Ends the context, and not the command, with Ctrl-C or SIGTERM (`kill`, `timeout`)."""
    if threading.current_thread() is not threading.main_thread():
        with suppress(KeyboardInterrupt):
            yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with suppress(KeyboardInterrupt):
            yield
    finally:
        signal.signal(signal.SIGTERM, before)
