"""A page in a cell of a notebook, by the kernel's own channel: browsers need no port and no proxy.

The cell has two outputs: the page in a frame, and beside it, hidden, the run of what was shown in
the last minute. Once saved, the notebook holds both; without a kernel the page plays the run.
A page's messages go through an anywidget, `player/js/src/bridge.js`, to a connection with the
viewer's server, one for every browser that shows the cell.
"""

from __future__ import annotations

import functools
import html
import secrets
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.resources import files
from importlib.util import find_spec
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from ..player.page import cell_page
from .server import socket_url

_HEIGHT = 600  # pixels
_FIRST = "first"  # the connection that waits for the first page, see `bridge.js`
_ALIVE = 5.0  # s between two messages that say that this kernel is there
_GONE = 15.0  # s that a page may say nothing; it says something every 4 s
_TICK = 0.05  # s to wait for a page's answer; a busy kernel does not hear it
_GOT = '{"t":"got"}'  # the answer of a page to a message
_LAST_RUN = 3.0  # s to wait for the run, before a viewer is closed

Send = Callable[[Mapping[str, Any], Sequence[bytes]], None]


def in_notebook() -> bool:
    """Whether this program is the kernel of a notebook."""
    return getattr(_shell(), "kernel", None) is not None


def has_channel() -> bool:
    """Whether anywidget, which carries the messages of pages, is installed."""
    return find_spec("anywidget") is not None


def show_address(title: str, url: str) -> None:
    """Shows in the cell the address of a page, and what to install to show the page itself."""
    _display(
        f'<p>{html.escape(title)} is at <a href="{url}" target="_blank">{url}</a>; '
        "<code>pip install 'sero-mj[notebook]'</code> shows it here.</p>",
        text=f"{title} is at {url}",
    )


def _shell() -> Any:
    return sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None


class _Kernel:
    def __init__(self) -> None:
        self.is_busy, self.freed = True, time.monotonic()
        events = _shell().events
        events.register("pre_run_cell", self._begin)
        events.register("post_run_cell", self._end)

    def _begin(self, *_: object) -> None:
        self.is_busy = True

    def _end(self, *_: object) -> None:
        self.is_busy, self.freed = False, time.monotonic()


_kernel = functools.cache(_Kernel)


class Cells:
    """The cells of a notebook that show a viewer.

    Args:
        title: title of the page.
        look: see `look_asked_for`.
        url: address of the page on this machine.
        tell: sends a message to the tool `shown_run` of the viewer.
    """

    def __init__(self, title: str, look: str, url: str, tell: Callable[[str], object]) -> None:
        self._title, self._look, self._url, self._tell = title, look, url, tell
        self._cells: list[_Cell] = []
        self._is_last = threading.Event()

    def show(self) -> None:
        self._cells.append(_Cell(self._title, self._look, self._url))
        self._tell("begin")

    def keep(self, run: str) -> None:
        for cell in self._cells:
            cell.keep(run)
        self._is_last.set()

    def keep_last(self) -> None:
        """Saves the run up to now. Call this before closing the viewer."""
        self._is_last.clear()
        self._tell("now")
        self._is_last.wait(_LAST_RUN)

    def close(self, *, tells: bool = True) -> None:
        for cell in self._cells:
            cell.close(tells=tells)


class _Cell:
    def __init__(self, title: str, look: str, url: str) -> None:
        self._id = secrets.token_hex(8)
        self._url = url
        self._visitors: dict[str, _Visitor] = {}
        self._bridge = _bridge(self._id)
        self._bridge.on_msg(self._hear)
        self.keep("", is_update=False)
        page = html.escape(cell_page(self._id, title, look))
        _display(
            f'<iframe srcdoc="{page}" width="100%" height="{_HEIGHT}" style="border:0" '
            f'title="{html.escape(title)}"></iframe>',
            text=f"{title}, live in a notebook that shows HTML",
        )
        self._open(_FIRST)

    def keep(self, run: str, *, is_update: bool = True) -> None:
        kept = f'<div hidden data-sero-mj-run="{self._id}">{run}</div>'
        _display(kept, display_id=f"sero-mj {self._id}", update=is_update)

    def close(self, *, tells: bool) -> None:
        for visitor in [*self._visitors.values()]:
            visitor.close(tells=tells)
        self._visitors.clear()

    def _hear(self, _: Any, message: Any, __: Any) -> None:
        try:
            client, kind, text = message["from"], message["kind"], message.get("message")
        except (KeyError, TypeError, AttributeError):
            return
        visitor = self._visitors.get(client)
        if kind == "open" and (visitor is None or visitor.is_gone):
            self._open(client)
        elif visitor is not None:
            visitor.hear(kind, text)
            if kind == "close":
                self._visitors.pop(client, None)

    def _open(self, client: str) -> None:
        def send(message: Mapping[str, Any], buffers: Sequence[bytes]) -> None:
            self._bridge.send({"to": client, **message}, buffers=list(buffers))

        self._visitors[client] = _Visitor(self._url, send, _kernel())


class _Visitor:
    def __init__(self, url: str, send: Send, kernel: _Kernel) -> None:
        self._url, self._send = url, send
        self._kernel, self._heard = kernel, time.monotonic()
        self._lock = threading.Lock()
        self._ahead = 0  # messages that nobody has answered
        self._owed = 0  # answers of the page that were given before they came
        self._socket: ClientConnection | None = None
        self.is_gone = False
        threading.Thread(target=self._run, name="sero-mj cell", daemon=True).start()

    def hear(self, kind: str, text: Any) -> None:
        self._heard = time.monotonic()
        if kind == "close":
            self.close()
        elif kind == "say" and isinstance(text, str):
            with self._lock:
                is_given = text == _GOT and self._owed > 0
                self._owed -= is_given
                self._ahead -= text == _GOT and not is_given
            if not is_given:
                self._say(text)

    def _say(self, text: str) -> None:
        if self._socket is not None:
            with suppress(WebSocketException):
                self._socket.send(text)

    def close(self, *, tells: bool = True) -> None:
        if not tells:
            self._send = lambda message, buffers: None
        if self._socket is not None:
            self._socket.close()

    def _run(self) -> None:
        address = socket_url(self._url, "/live")
        with (
            suppress(OSError, TimeoutError, WebSocketException),
            connect(address, compression=None, max_size=None, proxy=None) as self._socket,
        ):
            self._send({"kind": "opened"}, [])
            self._carry(self._socket)
        self.is_gone = True
        self._send({"kind": "closed"}, [])

    def _carry(self, socket: ClientConnection) -> None:
        told, kernel = time.monotonic(), self._kernel
        while kernel.is_busy or time.monotonic() - max(self._heard, kernel.freed) < _GONE:
            try:
                message = socket.recv(timeout=_TICK)
            except TimeoutError:
                self._answer()
                if time.monotonic() - told > _ALIVE:
                    told = time.monotonic()
                    self._send({"kind": "alive"}, [])
                continue
            with self._lock:
                self._ahead += isinstance(message, bytes)
            if isinstance(message, bytes):
                self._send({"kind": "message"}, [message])
            else:
                self._send({"kind": "message", "message": message}, [])

    def _answer(self) -> None:
        with self._lock:
            is_owed = self._ahead > 0
            self._ahead -= is_owed
            self._owed += is_owed
        if is_owed:
            self._say(_GOT)


def _display(page: str, text: str = "", **keywords: Any) -> None:
    from IPython.display import display

    display({"text/html": page, "text/plain": text}, raw=True, **keywords)


def _bridge(cell: str) -> Any:
    import anywidget
    import traitlets

    class Bridge(anywidget.AnyWidget):  # type: ignore[misc]
        _esm = (files("sero_mj.viewer.player") / "static" / "bridge.js").read_text("utf-8")
        cell = traitlets.Unicode().tag(sync=True)

    return Bridge(cell=cell)
