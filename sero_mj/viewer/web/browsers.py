"""`Browsers`: everybody who looks at a page. One of them has control, the others look on."""

from __future__ import annotations

import asyncio
import collections
import json
import threading
from collections.abc import Iterator
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from .sections import Sections, message_of

Said = dict[str, Any]  # what a browser says; "t" is its kind

# Messages on the way to a browser: with more, a slow one would lag behind.
_MOST_AHEAD = 3
_MOST_SAID = 2000  # messages that wait to be taken


class Browsers:
    """The browsers of a page; the server's thread and the page's use it.

    Args:
        sections: the state that they are sent.

    Attributes:
        sent: number of states that were sent to any of them.
        refused: number of messages that were none of a page's, or of one without control.
    """

    def __init__(self, sections: Sections) -> None:
        self._sections = sections
        self._lock = threading.Lock()
        self._browsers: dict[int, _Browser] = {}  # in the order in which they came
        self._last_id = 0
        self._holder: int | None = None
        self._said: collections.deque[Said] = collections.deque(maxlen=_MOST_SAID)
        self.sent = self.refused = 0
        self._put_control()

    @property
    def are_there(self) -> bool:
        """Whether there are any."""
        return bool(self._browsers)

    @property
    def holder(self) -> int | None:
        """Id of the one in control; None without browsers."""
        return self._holder

    def take(self) -> Iterator[Said]:
        """Yields what the one in control has said since the last time, the oldest first."""
        while self._said:
            yield self._said.popleft()

    def tell(self, event: Said) -> None:
        """Sends an event to the one in control; call `wake` on the server's thread after it."""
        with self._lock:
            browser = self._browsers.get(self._holder or 0)
        if browser is not None:
            browser.events.append(json.dumps(event))

    def wake(self) -> None:
        """Sends what has changed; on the server's thread."""
        for browser in [*self._browsers.values()]:
            browser.wake.set()

    # ---- on the server's thread

    async def talk(self, connection: ServerConnection) -> None:
        """Sends a browser the state of the page, and hears what it says, until it goes."""
        browser = self._join(connection)
        sending = asyncio.create_task(self._send_all(browser))
        try:
            async for message in connection:
                self._hear(browser, message)
        except ConnectionClosed:
            pass
        finally:
            sending.cancel()
            self._leave(browser)

    async def _send_all(self, browser: _Browser) -> None:
        """Sends what changes, as fast as a browser answers."""
        send, seen = browser.connection.send, 0
        try:
            await send(message_of({"you": json.dumps({"id": browser.id})}))
            browser.ahead += 1
            while True:
                await browser.wake.wait()
                browser.wake.clear()
                while browser.events:
                    await send(browser.events.popleft())
                if browser.ahead >= _MOST_AHEAD:
                    continue
                message, seen = self._sections.since(seen)
                if message is not None:
                    browser.ahead += 1
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
                self._said.append({"t": "left"})
        self._put_control()

    def _put_control(self) -> None:
        self._sections.put("control", {"holder": self._holder, "count": len(self._browsers)})
        self.wake()

    def _hear(self, browser: _Browser, message: str | bytes) -> None:
        try:
            said = json.loads(message)
            kind = said["t"]
        except (ValueError, KeyError, TypeError, RecursionError):
            self.refused += 1
            return
        if kind == "got":
            browser.ahead = max(browser.ahead - 1, 0)
            browser.wake.set()
        elif kind == "control":
            if self._holder != browser.id:
                self._holder = browser.id
                self._said.append({"t": "left"})  # whoever had it holds no button any more
                self._put_control()
        elif browser.id == self._holder and isinstance(kind, str):
            self._said.append(said)
        elif kind != "size":
            self.refused += 1


class _Browser:
    """A connection, and what is on its way to it."""

    def __init__(self, id_: int, connection: ServerConnection) -> None:
        self.id, self.connection = id_, connection
        self.wake = asyncio.Event()
        self.wake.set()
        self.ahead = 0  # messages that were not answered yet
        self.events: collections.deque[str] = collections.deque(maxlen=100)
