"""A client that communicates with a page of this process like a browser."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self

from websockets.sync.client import connect

from sero_mj.viewer.web.host import WebHost
from sero_mj.viewer.web.server import socket_url

PATIENCE = 400  # frames


def read_sections(message: bytes) -> dict[str, Any]:
    """Returns the sections of a message, values or bytes, as read by the script of the page."""
    (length,) = struct.unpack_from("<I", message)
    head = json.loads(message[4 : 4 + length])
    assert (4 + length) % 4 == 0
    found: dict[str, Any] = dict(head["json"])
    at = 4 + length
    for name, size in head["bytes"]:
        assert at % 4 == 0
        found[name] = message[at : at + size]
        at += -(-size // 4) * 4
    assert at == len(message)
    return found


class PageClient:
    """A connection to a page, whose frames are shown by the test.

    Args:
        page: page of this process.
        answers: whether to confirm messages like a browser.
        **options: options of `websockets.sync.client.connect`.

    Attributes:
        state: received sections.
        events: received events.
        messages: number and total size in bytes of received messages.
    """

    def __init__(self, page: WebHost, *, answers: bool = True, **options: Any) -> None:
        self._page, self._answers = page, answers
        url = socket_url(page.url, "/live")
        self._stack = ExitStack()
        self.line = self._stack.enter_context(
            connect(url, max_size=None, close_timeout=0.2, **options)
        )
        self.state: dict[str, Any] = {}
        self.events: list[dict[str, Any]] = []
        self.messages: list[int] = []
        self.until(lambda: "you" in self.state)
        self.id: int = self.state["you"]["id"]

    def say(self, what: str, **words: Any) -> None:
        """Sends a message to the page."""
        self.line.send(json.dumps({"t": what, **words}))

    def take(self) -> None:
        """Receives pending messages."""
        while True:
            try:
                message = self.line.recv(timeout=0)
            except TimeoutError:
                return
            if isinstance(message, str):
                self.events.append(json.loads(message))
                continue
            self.messages.append(len(message))
            self.state.update(read_sections(message))
            if self._answers:
                self.say("got")

    def until(self, found: Callable[[], Any]) -> Any:
        """Shows frames until a condition holds, and returns its value."""
        for _ in range(PATIENCE):
            self.take()
            result = found()
            if result:
                return result
            self._page.frame()
        raise AssertionError(f"never so: {found}; {sorted(self.state)}")

    def point(self, kind: str, x: float, y: float, **how: Any) -> None:
        """Moves or presses the pointer at a pixel from the upper left corner."""
        self.say("pointer", kind=kind, x=x, y=y, **how)

    def click(self, x: float, y: float, **how: Any) -> None:
        """Clicks at a pixel from the upper left corner."""
        for kind in ("move", "press", "release"):
            self.point(kind, x, y, **how)

    def widget(self, tree: str, label: str) -> dict[str, Any]:
        """Returns a node of a tree by its text or its id."""
        found: list[dict[str, Any]] = []

        def look(nodes: list[dict[str, Any]]) -> None:
            for node in nodes:
                if label in (node.get("s"), node.get("id"), node.get("aria")):
                    found.append(node)
                look(node.get("nodes", []))
                for row in node.get("rows", []):
                    for cell in row:
                        look(cell)

        look(self.state[tree] or [])
        assert found, f"no {label} in {tree}"
        return found[0]

    def close(self) -> None:
        """Closes the connection to the page."""
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
