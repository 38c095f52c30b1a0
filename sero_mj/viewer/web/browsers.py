"""What the browsers of a page tell its server, and which of several states each of them is sent.

The page's own script sends texts over the websocket of the states, which Studio's server does not
hear of: the size of the page, when a button was pressed, and that a finger is held still.
"""

from __future__ import annotations

import asyncio
import collections
import re
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from websockets.asyncio.server import ServerConnection

Size = tuple[int, int]  # width and height of a page without Studio's bar, pixels

_REQUEST_TIMEOUT = 10.0  # timeout of a connection's request, s
_SIZE = re.compile(r"sero-mj size ([1-9][0-9]{0,4}) ([1-9][0-9]{0,4})")
_PRESS = re.compile(r"sero-mj press ([0-2])")
_HOLD = "sero-mj hold"
_VIEW = "sero-mj view "
_OLDEST_PRESS = 1.0  # s since the last frame without one; it was no click on the picture
_MOST_PRESSES = 50


class Browsers:
    """The browsers that are connected; the server's thread and the page's use it.

    Attributes:
        states: payload for browsers of other sizes than that of the one in control.
    """

    def __init__(self) -> None:
        self.states: Mapping[Size, bytes] = {}
        self._connections: set[Any] = set()
        self._sizes: dict[Any, Size] = {}  # by connection
        # Buttons and times, the oldest first.
        self._presses = collections.deque[tuple[int, float]](maxlen=_MOST_PRESSES)
        self._is_held = False
        self._presser: Any = None  # the connection of the last press: of who has control
        self._has_left = False
        self._copied: str | None = None  # for its clipboard
        self._view: str | None = None  # that a link leads to
        self._dropped: Path | None = None  # that is to be opened
        self._lock = threading.Lock()

    @property
    def are_there(self) -> bool:
        """Whether anything is connected, if only for a file."""
        return bool(self._connections)

    def greet(self, connection: Any) -> None:
        """Remembers a connection that has been made."""
        self._connections.add(connection)

    def hear(self, connection: Any, message: str) -> bool:
        """Takes a message of a browser; returns False for one of Studio's."""
        if size := _SIZE.fullmatch(message):
            with self._lock:
                self._sizes[connection] = int(size[1]), int(size[2])
        elif press := _PRESS.fullmatch(message):
            with self._lock:
                self._presses.append((int(press[1]), time.monotonic()))
                self._is_held = False
                self._presser = connection
        elif message == _HOLD:
            self._is_held = True
        elif is_view := message.startswith(_VIEW):
            self._view = message.removeprefix(_VIEW)
            return is_view
        return bool(size or press) or message == _HOLD

    def drop(self, file: Path) -> None:
        """Takes a file that was dropped on the page."""
        self._dropped = file

    def take_dropped(self) -> Path | None:
        """Returns the file that was dropped on the page last, once."""
        dropped, self._dropped = self._dropped, None
        return dropped

    def take_view(self) -> str | None:
        """Returns the view that a browser was opened with a link to, as text, once."""
        view, self._view = self._view, None
        return view

    def copy(self, text: str) -> None:
        """Puts a text onto the clipboard of the browser that pressed last, or asks there to."""
        self._copied = text

    def take_copied(self, connection: Any) -> str | None:
        """Returns what a browser is to copy, once."""
        if connection is not self._presser:
            return None
        copied, self._copied = self._copied, None
        return copied

    def forget(self, connection: Any) -> None:
        """Forgets a browser that has left."""
        self._connections.discard(connection)
        with self._lock:
            self._sizes.pop(connection, None)
            self._has_left |= connection is self._presser

    def sizes_beside(self, own: Size, most: int) -> list[Size]:
        """Returns other sizes than `own`, those of most browsers first, at most `most`."""
        with self._lock:
            counts = collections.Counter(size for size in self._sizes.values() if size != own)
        return [size for size, _ in counts.most_common(most)]

    def state_for(self, connection: Any, payload: bytes) -> bytes:
        """Returns the state for a browser; `payload` is for the one in control."""
        return self.states.get(self._sizes.get(connection, (0, 0)), payload)

    def press_time(self, button: int) -> float:
        """Returns when a button was pressed that is seen to be pressed now, s, `time.monotonic`.

        While a server is busy several presses wait, in order.
        """
        with self._lock:
            while self._presses:
                pressed, at = self._presses.popleft()
                if pressed == button:
                    return at
        return time.monotonic()

    def take_left(self) -> bool:
        """Returns whether the browser that has pressed last has gone since; once."""
        left, self._has_left = self._has_left, False
        return left

    def take_hold(self) -> bool:
        """Returns whether a finger has been held still since the last press; once."""
        held, self._is_held = self._is_held, False
        return held

    def forget_presses(self) -> None:
        """Forgets presses that nothing has been seen of."""
        with self._lock:
            while self._presses and self._presses[0][1] < time.monotonic() - _OLDEST_PRESS:
                self._presses.popleft()


class BrowserConnection(ServerConnection):
    """A connection to a browser.

    It may take any time to receive a response, but not to send its request: `open_timeout` of
    `serve` includes both, so that pages were cut off on links that are too slow for a file.

    Args:
        arguments: see `ServerConnection`.
        browsers: hears what it says.
        options: see `ServerConnection`.
    """

    def __init__(self, *arguments: Any, browsers: Browsers, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._browsers = browsers

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begins to wait for the request."""
        super().connection_made(transport)
        self._browsers.greet(self)
        self.loop.call_later(_REQUEST_TIMEOUT, self._end_without_request)

    def _end_without_request(self) -> None:
        if self.request is None:
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self._browsers.forget(self)
        super().connection_lost(exc)

    async def recv(self, decode: bool | None = None) -> Any:
        """Returns the next message for Studio's server."""
        while True:
            message = await super().recv(decode)
            if not (isinstance(message, str) and self._browsers.hear(self, message)):
                return message

    async def send(self, message: Any, *, text: bool | None = None) -> None:
        """Sends a message of Studio's server; of a state the one for the browser's size."""
        is_state = self.request is not None and self.request.path.startswith("/state")
        if is_state and isinstance(message, bytes):
            if (copied := self._browsers.take_copied(self)) is not None:
                await super().send(f"sero-mj copy {copied}", text=True)
            message = self._browsers.state_for(self, message)
        await super().send(message, text=text)
