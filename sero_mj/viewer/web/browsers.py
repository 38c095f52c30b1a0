"""`Browsers`: the browsers that show a page. One of them has control."""

from __future__ import annotations

import asyncio
import collections
import json
import secrets
import threading
import time
from collections.abc import Iterator
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.protocol import State

from .guard import is_local, same_text
from .messages import (
    MAX_BYTES,
    Control,
    Got,
    Left,
    MessageReader,
    MessageSender,
    PageSize,
    Received,
)
from .sections import Sections, message_of

# With more unacknowledged messages, the display of a slow browser would be delayed.
_MAX_PENDING = 3
_MAX_QUEUED = 2000  # maximum number of received messages; connections hold further ones
_MAX_BROWSERS = 64
_MAX_PER_SECOND = 1000  # maximum number of messages of a browser; a drag sends about 150
_PAUSE = 0.02  # time between checks for space in the queue, s
_TOO_BIG, _TRY_LATER = 1009, 1013  # status codes of closed websockets


class Browsers:
    """The browsers that show a page. The server's thread and the page's thread use this object.

    Args:
        sections: state of the page.
        kinds: accepted kinds of messages, see `MessageReader`.

    Attributes:
        sent: number of states sent to browsers, summed over all browsers.
        refused: number of messages that were malformed or came from a browser without control.
    """

    def __init__(self, sections: Sections, kinds: Any) -> None:
        self._sections, self._reader = sections, MessageReader(kinds)
        self._lock = threading.Lock()
        self._browsers: dict[int, _Browser] = {}  # in the order of connection
        self._last_id = 0
        self._holder: int | None = None
        self._queue: collections.deque[Received] = collections.deque()
        self.sent = self.refused = 0
        self._put_control()

    @property
    def is_any(self) -> bool:
        return bool(self._browsers)

    @property
    def holder(self) -> int | None:
        return self._holder

    @property
    def holder_is_local(self) -> bool | None:
        browser = self._browsers.get(self._holder or 0)
        return None if browser is None else browser.sender.is_local

    def is_in_control(self, key: str) -> bool:
        """Returns whether a key is the secret key of the browser in control."""
        browser = self._browsers.get(self._holder or 0)
        return browser is not None and same_text(key, browser.key)

    def take(self) -> Iterator[Received]:
        while self._queue:
            yield self._queue.popleft()

    def send_event(self, event: dict[str, Any]) -> None:
        """Queues an event for the browser in control. `wake` on the server's thread sends it."""
        with self._lock:
            browser = self._browsers.get(self._holder or 0)
        if browser is not None:
            browser.events.append(json.dumps(event))

    def wake(self) -> None:
        for browser in [*self._browsers.values()]:
            browser.wake.set()

    # ---- methods for the server's thread

    async def talk(self, connection: ServerConnection) -> None:
        if len(self._browsers) >= _MAX_BROWSERS:
            reason = f"{_MAX_BROWSERS} browsers already show this page"
            await connection.close(_TRY_LATER, reason)
            return
        browser = self._join(connection)
        sending = asyncio.create_task(self._send_all(browser))
        try:
            async for message in connection:
                if len(message) > MAX_BYTES:
                    await connection.close(_TOO_BIG, f"expected at most {MAX_BYTES} bytes")
                    break
                self._handle(browser, message)
                await self._wait_for_room(browser)
        except ConnectionClosed:
            pass
        finally:
            sending.cancel()
            self._leave(browser)

    async def _wait_for_room(self, browser: _Browser) -> None:
        while (
            len(self._queue) >= _MAX_QUEUED
            and browser.id == self._holder
            and browser.connection.state is State.OPEN  # ends the loop when the server closes
        ):
            await asyncio.sleep(_PAUSE)
        now = time.monotonic()
        if now - browser.second >= 1.0:
            browser.second, browser.messages = now, 0
        browser.messages += 1
        if browser.messages >= _MAX_PER_SECOND:
            await asyncio.sleep(browser.second + 1.0 - now)

    async def _send_all(self, browser: _Browser) -> None:
        send, seen = browser.connection.send, 0
        you = {"id": browser.id, "isLocal": browser.sender.is_local, "key": browser.key}
        try:
            await send(message_of({"you": json.dumps(you)}))
            browser.pending += 1
            while True:
                await browser.wake.wait()
                browser.wake.clear()
                while browser.events:
                    await send(browser.events.popleft())
                if browser.pending >= _MAX_PENDING:
                    continue
                message, seen = self._sections.since(seen)
                if message is not None:
                    browser.pending += 1
                    self.sent += 1
                    await send(message)
        except ConnectionClosed:
            return

    def _join(self, connection: ServerConnection) -> _Browser:
        with self._lock:
            self._last_id += 1
            browser = self._browsers[self._last_id] = _Browser(self._last_id, connection)
            if self._holder is None:
                self._holder = browser.id
        self._put_control()
        return browser

    def _leave(self, browser: _Browser) -> None:
        with self._lock:
            self._browsers.pop(browser.id, None)
            if self._holder == browser.id:
                self._holder = next(iter(self._browsers), None)
                self._queue.append(Received(Left(), browser.sender))
        self._put_control()

    def _put_control(self) -> None:
        self._sections.put("control", {"holder": self._holder, "count": len(self._browsers)})
        self.wake()

    def _handle(self, browser: _Browser, text: str | bytes) -> None:
        message = self._reader.read(text)
        match message:
            case None:
                self.refused += 1
            case Got():
                browser.pending = max(browser.pending - 1, 0)
                browser.wake.set()
            case Control():
                if self._holder != browser.id:
                    self._holder = browser.id
                    # The previous browser can no longer release a pressed button.
                    self._queue.append(Received(Left(), browser.sender))
                    self._put_control()
            case _ if browser.id == self._holder:
                self._queue.append(Received(message, browser.sender))
            case PageSize():  # Every browser sends its size when it connects.
                pass
            case _:
                self.refused += 1


class _Browser:
    def __init__(self, id_: int, connection: ServerConnection) -> None:
        self.id, self.connection = id_, connection
        self.sender = MessageSender(id_, is_local(connection))
        self.key = secrets.token_urlsafe(16)
        self.wake = asyncio.Event()
        self.wake.set()
        self.pending = 0  # number of messages that the browser has not acknowledged
        self.events: collections.deque[str] = collections.deque(maxlen=100)
        self.second, self.messages = 0.0, 0  # start of the current second; messages in it
