"""`StartHost`: the start page as a web page."""

from __future__ import annotations

import asyncio
import json
import threading
import time
import urllib.parse
from pathlib import Path
from typing import Any, Self

from mujoco.studio.web import web_server
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from ...base.errors import RenderError
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
from .guard import Guard, is_loopback, make_token
from .host import check_address, page_urls
from .uploads import SCRIPT, is_for_files, take_files

_PAGE = Path(__file__).with_name("start_page.html").read_text("utf-8")
_LIVE, _TILES, _PICTURES = "/sero-mj/start", "/sero-mj/tiles", "/sero-mj/pictures/"
_EVERY = 0.4  # s between two reports of what is awaited
_LOOKS = 0.2  # s after which it is looked whether the server still runs
_LONGEST_MESSAGE = 2**20  # bytes


class StartHost:
    """Shows on a web page what can be opened, until something is.

    Args:
        opener: returns what shows what was chosen.
        listening: hears the data that is awaited.
        host: address to listen on.
        port: 0 for the first free one from 8080 on.
        token: see `WebHost`.

    Attributes:
        port: of the page.
        token: in its address; None without.

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
        self._is_private = is_loopback(check_address(host))
        self.token: str | None = None
        if token or not self._is_private:
            self.token = token if isinstance(token, str) else make_token()
        try:
            self._socket = web_server.bind_public_socket(host, port)
            self._socket.listen()
        except (RuntimeError, OSError) as error:
            why = f"{error}".partition(" Pass a different")[0]  # Studio's hint is not for --port
            raise RenderError(f"no page at {host}:{port}: {why}") from error
        self._host = host
        bound, self.port = self._socket.getsockname()[:2]
        page = _PAGE.replace("<!-- uploads -->", SCRIPT)
        self._guard = Guard(page.encode(), bound, host, self.token)
        self._stop: asyncio.Event | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._serve, name="start page", daemon=True)
        self._thread.start()

    @property
    def urls(self) -> list[str]:
        """See `WebHost`."""
        return page_urls(self._host, self.port, self.token)

    @property
    def is_private(self) -> bool:
        """Whether only browsers on this machine can reach it."""
        return self._is_private

    def run(self) -> Mirror | None:
        """Returns what shows the scene that was chosen; None when the server has ended."""
        while self._thread.is_alive():
            if self._page.open_next(_LOOKS):
                return self._page.chosen
        return None

    def _serve(self) -> None:
        asyncio.run(self._answer())

    async def _answer(self) -> None:
        self._stop, self._loop = asyncio.Event(), asyncio.get_running_loop()
        async with serve(
            self._talk,
            sock=self._socket,
            max_size=_LONGEST_MESSAGE,
            process_request=self._request,
            process_response=self._response,
        ):
            await self._stop.wait()

    def _request(self, connection: ServerConnection, request: Request) -> Response | None:
        answer = self._guard.answer(request)
        path, _, query = request.path.partition("?")
        if answer is not None or path == _LIVE or is_for_files(request):
            return answer
        if path == _TILES:
            words = urllib.parse.parse_qs(query).get("search", [""])[0]
            return _found("application/json", json.dumps(self._described(words)).encode())
        tiles, number = self._page.tiles, path.removeprefix(_PICTURES)
        if path.startswith(_PICTURES) and number.isdecimal() and int(number) < len(tiles):
            picture = tiles[int(number)].picture
            try:
                return _found("image/jpeg", picture.read_bytes() if picture else b"")
            except OSError:
                pass
        return connection.respond(404, "no such page\n")

    def _response(
        self, connection: ServerConnection, request: Request, response: Response
    ) -> Response | None:
        self._guard.set_security_headers(request, response)
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
        if connection.request is not None and is_for_files(connection.request):
            await take_files(connection, self._page.choose)
            return
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
        if self._loop is not None and self._stop is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()
        self._socket.close()

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


def _found(kind: str, body: bytes) -> Response:
    headers = Headers()
    headers["Content-Type"] = kind
    headers["Content-Length"] = str(len(body))
    headers["Cache-Control"] = "no-store"
    return Response(200, "OK", headers, body)
