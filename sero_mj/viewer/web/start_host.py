"""`StartHost`: serves the start page to browsers."""

from __future__ import annotations

import json
import time
import urllib.parse
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from ...base.errors import SeroError
from ...data.drive.mirror import Mirror
from ..host.start_page import (
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
from ..session.recent_views import RecentView
from ..session.status_line import Message as Notice
from .browsers import Browsers
from .messages import ForStartPage, Left, MessageSender, OpenShown, OpenTile, PageMessage
from .sections import Sections
from .server import PageAnswer, PageListener, PageServer, static_text
from .uploads import NOT_IN_CONTROL, drops

_LIVE, _TILES, _PICTURES = "/sero-mj/start", "/sero-mj/tiles", "/sero-mj/pictures/"
_REPORT_INTERVAL = 0.4  # time between updates of the expected packets, s
_POLL_INTERVAL = 0.05  # time between checks for messages, s


class StartHost:
    """Serves the start page to browsers until the user opens a scene, robot or recording.

    Several browsers can connect. Only the browser in control can open a view or file.

    Args:
        opener: function that opens the chosen view or file.
        listening: monitor of the ports of sources.
        host: address to listen on.
        port: port to listen on; 0 for the first free port from 8080.
        token: token of the page; True to create a token, False for none.

    Raises:
        RenderError: the page cannot be served at this address and port.
    """

    def __init__(
        self,
        opener: Opener,
        listening: PortMonitor,
        host: str,
        port: int | PageListener = 0,
        *,
        token: bool | str = True,
    ) -> None:
        self._opener = opener
        self._page = StartPage(self._open, listening)
        self._sections = Sections()
        self.browsers = Browsers(self._sections, ForStartPage)
        self.sender = MessageSender(0, is_local=False)
        # `Browsers` handles all other kinds of `ForStartPage`.
        self._acts: dict[type[PageMessage | Left], Callable[[Any], None]] = {
            OpenTile: self._open_tile,
            OpenShown: self._open_shown,
            Left: lambda message: None,
        }
        self._reported = float("-inf")
        self._notice = Notice()
        own = {name: static_text(name).encode() for name in ("start.js", "start.css")}
        self.server = PageServer(
            static_text("start.html"),
            own,
            self.browsers.talk,
            _LIVE,
            self._may_upload,
            self._page.choose,
            find=self._find,
            host=host,
            port=port,
            token=token,
        )

    def run(self) -> Mirror | None:
        """Serves the page, and returns the mirror of the chosen scene, or None without a choice."""
        while self.server.is_running:
            for message, sender in self.browsers.take():
                self.sender = sender
                self._acts[type(message)](message)
            self._report()
            if self._page.open_next(_POLL_INTERVAL):
                return self._page.chosen
        return None

    def _open(self, what: RecentView | Path) -> Mirror:
        try:
            return self._opener(what)
        except SeroError:
            if isinstance(what, Path):
                drops.discard(what)
            raise

    def _may_upload(self, key: str) -> str | None:
        return None if self.browsers.is_in_control(key) else NOT_IN_CONTROL

    def _find(self, path: str, query: str) -> PageAnswer | None:
        if path == _TILES:
            words = urllib.parse.parse_qs(query).get("search", [""])[0]
            return PageAnswer(json.dumps(self._described(words)).encode(), ".json")
        tiles, number = self._page.tiles, path.removeprefix(_PICTURES)
        if path.startswith(_PICTURES) and number.isdecimal() and int(number) < len(tiles):
            image = tiles[int(number)].image
            try:
                return PageAnswer(image.read_bytes() if image else b"", ".jpg")
            except OSError:
                return None
        return None

    def _described(self, words: str) -> dict[str, Any]:
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
                            "has_picture": tile.image is not None,
                        }
                        for tile in section.tiles
                    ],
                }
                for section in self._page.found(words)
            ],
        }

    def _open_tile(self, message: OpenTile) -> None:
        tiles = self._page.tiles
        if message.number < len(tiles):
            self._page.choose(tiles[message.number].view)

    def _open_shown(self, message: OpenShown) -> None:
        shown = {view.scene: view for each in self._page.expected() for view in each.shown}
        if message.scene in shown:
            self._page.choose(shown[message.scene])

    def _report(self) -> None:
        now = time.monotonic()
        notice = self._page.notice
        if notice != self._notice:
            self._notice = notice
            content = {"text": notice.text, "isBad": notice.is_bad, "seconds": notice.until - now}
            self._sections.put("notice", content)
        elif now - self._reported < _REPORT_INTERVAL:
            return
        elif not notice.is_shown:
            self._sections.put("notice", None)  # Browsers that connect later need no old message.
        self._reported = now
        self._sections.put("awaited", [_as_json(each) for each in self._page.expected()])
        self.server.call(self.browsers.wake)

    def close(self) -> None:
        self.server.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _as_json(packets: ExpectedPackets) -> dict[str, Any]:
    return {
        "text": packets.text,
        "expected": packets.packets,
        "command": packets.command,
        "mood": packets.mood,
        "shown": [view.scene for view in packets.shown],
    }
