"""`StartHost`: the start page as a web page."""

from __future__ import annotations

import asyncio
import json
import time
import urllib.parse
from typing import Any, Self

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from ...data.drive.mirror import Mirror
from ..panels.message import Message
from ..session.start_page import (
    DROP_HINT,
    MORE_HINT,
    SEARCH_HINT,
    TAGLINE,
    TITLE,
    ExpectedPackets,
    Opener,
    PortMonitor,
    StartPage,
)
from .server import Answer, PageServer, static_text

_LIVE, _TILES, _PICTURES = "/sero-mj/start", "/sero-mj/tiles", "/sero-mj/pictures/"
_EVERY = 0.4  # s between two reports of what is awaited
_LOOKS = 0.2  # s after which it is looked whether the server still runs


class StartHost:
    """Shows on a web page what can be opened, until something is.

    Args:
        opener: returns what shows what was chosen.
        listening: hears the data that is awaited.
        host: address to listen on.
        port: 0 for the first free one from 8080 on.
        token: see `PageServer`.

    Attributes:
        server: of the page.

    Raises:
        RenderError: the page cannot be served there.
    """

    def __init__(
        self,
        opener: Opener,
        listening: PortMonitor,
        host: str,
        port: int = 0,
        *,
        token: bool | str = False,
    ) -> None:
        self._page = StartPage(opener, listening)
        own = {name: static_text(name).encode() for name in ("start.js", "start.css")}
        self.server = PageServer(
            static_text("start.html"),
            own,
            self._talk,
            _LIVE,
            self._page.choose,
            find=self._find,
            host=host,
            port=port,
            token=token,
        )

    def run(self) -> Mirror | None:
        """Returns what shows the scene that was chosen; None when the server has ended."""
        while self.server.is_running:
            if self._page.open_next(_LOOKS):
                return self._page.chosen
        return None

    def _find(self, path: str, query: str) -> Answer | None:
        if path == _TILES:
            words = urllib.parse.parse_qs(query).get("search", [""])[0]
            return Answer(json.dumps(self._described(words)).encode(), ".json")
        tiles, number = self._page.tiles, path.removeprefix(_PICTURES)
        if path.startswith(_PICTURES) and number.isdecimal() and int(number) < len(tiles):
            picture = tiles[int(number)].picture
            try:
                return Answer(picture.read_bytes() if picture else b"", ".jpg")
            except OSError:
                return None
        return None

    def _described(self, words: str) -> dict[str, Any]:
        """Returns the texts of the page, and its tiles that have these words in them."""
        numbers = {id(tile): number for number, tile in enumerate(self._page.tiles)}
        return {
            "title": TITLE,
            "tagline": TAGLINE,
            "drop": DROP_HINT,
            "more": MORE_HINT,
            "search": SEARCH_HINT,
            "sections": [
                {
                    "title": section.title,
                    "tiles": [
                        {
                            "number": numbers[id(tile)],
                            "title": tile.title,
                            "about": tile.about,
                            "has_picture": tile.picture is not None,
                        }
                        for tile in section.tiles
                    ],
                }
                for section in self._page.found(words)
            ],
        }

    async def _talk(self, connection: ServerConnection) -> None:
        """Tells a browser what is awaited, and hears what it chooses."""
        report = asyncio.create_task(self._report(connection))
        try:
            async for message in connection:
                self._hear(message)
        except ConnectionClosed:
            pass
        finally:
            report.cancel()

    def _hear(self, message: str | bytes) -> None:
        """Opens a tile, or what shows the data of a place; other messages are not ours."""
        try:
            found = json.loads(message)
            if "tile" in found:
                by_number = dict(enumerate(self._page.tiles))
                self._page.choose(by_number[found["tile"]].view)
            else:
                shown = {view.scene: view for each in self._page.awaited() for view in each.shown}
                self._page.choose(shown[found["shown"]])
        except (ValueError, KeyError, TypeError):
            return

    async def _report(self, connection: ServerConnection) -> None:
        told = Message()
        while True:
            if self._page.notice != told:
                told = self._page.notice
                seconds = told.until - time.monotonic()
                notice = {"notice": told.text, "is_bad": told.is_bad, "seconds": seconds}
                await connection.send(json.dumps(notice))
            awaited = [_as_json(each) for each in self._page.awaited()]
            await connection.send(json.dumps({"awaited": awaited}))
            await asyncio.sleep(_EVERY)

    def close(self) -> None:
        """Ends the server."""
        self.server.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _as_json(awaited: ExpectedPackets) -> dict[str, Any]:
    return {
        "text": awaited.text,
        "expected": awaited.expected,
        "command": awaited.command,
        "mood": awaited.mood,
        "shown": [view.scene for view in awaited.shown],
    }
