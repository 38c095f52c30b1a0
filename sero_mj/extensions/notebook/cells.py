"""`Cells`: displays the page of a viewer in notebook cells, connected by the kernel's channel.

Browsers need no port and no proxy. A cell has two outputs: a frame with the page, and a hidden
element with the run of the last minute. A saved notebook contains both outputs. If there is no
kernel, the page plays the run. An anywidget, `player/js/src/bridge.js`, forwards the messages of
each browser that displays the cell. Each browser has its own connection to the viewer's server.
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

from ...robots.declared.scene import Scene
from ...viewer.player.page import cell_page, requested_look
from ...viewer.program.process import ViewerProcess
from ...viewer.web.server import socket_url

_RUN = "shown_run"  # name of the tool that captures the run
_HEIGHT = 600  # height of the frame with the page, pixels
_FIRST = "first"  # name of the connection of the first page, see `bridge.js`
_ALIVE = 5.0  # time between messages by which the kernel reports that it is running, s
_GONE = 15.0  # time without a message after which a page counts as closed, s; pages send every 4 s
_TICK = 0.05  # maximum time to wait for a message, s
_GOT = '{"t":"got"}'  # message by which a page acknowledges a message
_LAST_RUN = 3.0  # maximum time to wait for the last run when a viewer is closed, s

Send = Callable[[Mapping[str, Any], Sequence[bytes]], None]


def _in_notebook() -> bool:
    return getattr(_shell(), "kernel", None) is not None


def _has_channel() -> bool:
    return find_spec("anywidget") is not None


def _show_address(title: str, url: str) -> None:
    _display(
        f'<p>{html.escape(title)} is at <a href="{url}" target="_blank">{url}</a>; '
        "run <code>pip install 'sero-mj[notebook]'</code> to display it here.</p>",
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
    """The notebook cells that display a viewer.

    Args:
        scene: scene of the viewer.
        url: address of the viewer's page on this machine.
        process: process of the viewer.
    """

    def __init__(self, scene: Scene, url: str, process: ViewerProcess) -> None:
        self._title, self._look, self._url = scene.name, requested_look(scene), url
        self._process = process
        self._cells: list[_Cell] = []
        self._has_run = threading.Event()

    def show(self) -> None:
        if not _in_notebook():
            print(f"{self._title} is at {self._url}")
        elif not _has_channel():
            _show_address(self._title, self._url)
        else:
            self._process.answers[_RUN] = self._store
            self._cells.append(_Cell(self._title, self._look, self._url))
            self._process.send(_RUN, "begin")

    def _store(self, run: str) -> None:
        for cell in self._cells:
            cell.store(run)
        self._has_run.set()

    def store_last(self) -> None:
        if self._cells:
            self._has_run.clear()
            self._process.send(_RUN, "now")
            self._has_run.wait(_LAST_RUN)

    def close(self, *, is_exit: bool = False) -> None:
        for cell in self._cells:
            cell.close(is_exit=is_exit)


class _Cell:
    def __init__(self, title: str, look: str, url: str) -> None:
        self._id = secrets.token_hex(8)
        self._url = url
        self._visitors: dict[str, _Visitor] = {}
        self._bridge = _bridge(self._id)
        self._bridge.on_msg(self._hear)
        self.store("", is_update=False)
        page = html.escape(cell_page(self._id, title, look))
        _display(
            f'<iframe srcdoc="{page}" width="100%" height="{_HEIGHT}" style="border:0" '
            f'title="{html.escape(title)}"></iframe>',
            text=f"{title}: displayed live in notebooks that support HTML",
        )
        self._open(_FIRST)

    def store(self, run: str, *, is_update: bool = True) -> None:
        stored = f'<div hidden data-sero-mj-run="{self._id}">{run}</div>'
        _display(stored, display_id=f"sero-mj {self._id}", update=is_update)

    def close(self, *, is_exit: bool) -> None:
        for visitor in [*self._visitors.values()]:
            visitor.close(is_exit=is_exit)
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
        self._unanswered = 0  # number of messages without an acknowledgment
        # A busy kernel receives no acknowledgments from a page, so it sends them in its place.
        self._answered_early = 0  # number of acknowledgments in place of the page
        self._socket: ClientConnection | None = None
        self.is_gone = False
        threading.Thread(target=self._run, name="sero-mj cell", daemon=True).start()

    def hear(self, kind: str, text: Any) -> None:
        self._heard = time.monotonic()
        if kind == "close":
            self.close()
        elif kind == "say" and isinstance(text, str):
            with self._lock:
                is_late = text == _GOT and self._answered_early > 0
                self._answered_early -= is_late
                self._unanswered -= text == _GOT and not is_late
            if not is_late:
                self._say(text)

    def _say(self, text: str) -> None:
        if self._socket is not None:
            with suppress(WebSocketException):
                self._socket.send(text)

    def close(self, *, is_exit: bool = False) -> None:
        if is_exit:  # The kernel can no longer send messages.
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
        reported, kernel = time.monotonic(), self._kernel
        while kernel.is_busy or time.monotonic() - max(self._heard, kernel.freed) < _GONE:
            try:
                message = socket.recv(timeout=_TICK)
            except TimeoutError:
                self._answer()
                if time.monotonic() - reported > _ALIVE:
                    reported = time.monotonic()
                    self._send({"kind": "alive"}, [])
                continue
            with self._lock:
                self._unanswered += isinstance(message, bytes)
            if isinstance(message, bytes):
                self._send({"kind": "message"}, [message])
            else:
                self._send({"kind": "message", "message": message}, [])

    def _answer(self) -> None:
        with self._lock:
            is_answered = self._unanswered > 0
            self._unanswered -= is_answered
            self._answered_early += is_answered
        if is_answered:
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
