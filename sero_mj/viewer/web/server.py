"""`PageServer`: serves the files, images, uploads and websocket of a page on a separate thread.

`guard.py` checks all requests. Messages of browsers are queued until the page handles them.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import functools
import json
import logging
import socket
import threading
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlsplit, urlunsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from ...base.errors import RenderError, UsageError, shown
from .compression import DEFLATE, CompressedResponses
from .guard import Guard, is_loopback, make_token
from .uploads import MayUpload, is_for_files, take_files

log = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
ANY_ADDRESS = ("", "0.0.0.0", "::")
_FIRST_PORT, _MAX_PORTS = 8080, 100
_BACKLOG = 128  # maximum number of waiting connections
_MAX_PART = 2**20  # maximum size of an upload message in bytes; `messages` limits all others
_REQUEST_TIMEOUT = 10.0  # s
_STATIC = Path(__file__).with_name("static")
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".jpg": "image/jpeg",
    ".json": "application/json",
}
_SHARED = ("access.js", "uploads.js", "uploads.css")  # files that all pages need
_PAGE_NAME = "/sero-mj/page"  # path that returns the name of the served page; needs the token
# For each address of a server: the other address that browsers may use for `localhost`.
_TWINS = {"127.0.0.1": "::1", "::1": "127.0.0.1", "0.0.0.0": "::1"}

Talk = Callable[[ServerConnection], Awaitable[None]]


class PageAnswer(NamedTuple):
    """The body of an HTTP response.

    Attributes:
        body: contents of the response.
        ending: file extension, such as `.html`, which determines the content type.
        is_cached: whether browsers may cache the body and validate it with the ETag.
    """

    body: bytes
    ending: str
    is_cached: bool = False


class PageServer:
    """Serves a page until the server is closed.

    Args:
        page: HTML of the page, without secrets.
        files: mapping from names to contents of the page's files, without secrets.
        talk: coroutine function called with every connection to the page's websocket.
        socket_path: path of the websocket.
        may_upload: function that returns the reason why an upload is refused, or None.
        on_file: function called with each file that the user has dropped on the page.
        find: function that returns the response for any other path and query, or None.
        host: address to listen on.
        port: port to listen on; 0 for the first free port from 8080. Pages that are served one
            after the other share a `PageListener`.
        token: token of the page; True to create a token, False for none.

    Raises:
        RenderError: the page cannot be served at this address and port.
        UsageError: a page for other machines has no token.
    """

    def __init__(
        self,
        page: str,
        files: Mapping[str, bytes],
        talk: Talk,
        socket_path: str,
        may_upload: MayUpload,
        on_file: Callable[[Path], None],
        *,
        find: Callable[[str, str], PageAnswer | None] = lambda path, query: None,
        host: str = LOOPBACK,
        port: int | PageListener = 0,
        token: bool | str = True,
    ) -> None:
        self.is_private = is_loopback(check_address(host))
        self.token: str | None = None
        if token:
            self.token = token if isinstance(token, str) else make_token()
        elif not self.is_private:
            raise UsageError(f"host {host}: a page for other machines needs a token")
        listener = port if isinstance(port, PageListener) else PageListener(host, port)
        self._sockets = [each.dup() for each in listener.sockets]
        if listener is not port:
            listener.close()
        self.address, self.port = self._sockets[0].getsockname()[:2]
        self._host = host
        own = {name: (_STATIC / name).read_bytes() for name in _SHARED}
        self._files = {f"/{name}": body for name, body in {**own, **files}.items()}
        self.guard = Guard(self.address, host, self.token, self._files)
        if self.token is None:
            log.warning(
                "the page at port %d has no token: every user of this machine can view and "
                "control it", self.port,
            )  # fmt: skip
        self._page = page.encode()
        self._talk, self._path, self._find = talk, socket_path, find
        self._may_upload, self._on_file = may_upload, on_file
        self._compressed = CompressedResponses()
        self._stop: asyncio.Event | None = None
        self.loop: asyncio.AbstractEventLoop | None = None
        self._is_serving = threading.Event()
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve()), name="sero-mj page", daemon=True
        )
        self._thread.start()
        self._is_serving.wait()

    @property
    def plain_url(self) -> str:
        """Address of the page without the token, for browsers that have opened the page before."""
        return page_url(self._host, self.port)

    @property
    def url(self) -> str:
        return page_url(self._host, self.port, self.token)

    @property
    def urls(self) -> list[str]:
        """All addresses of the page. If other machines can open it, the second one is for them."""
        others = [page_url(socket.gethostname(), self.port, self.token)]
        return [self.url] + others * (self._host in ANY_ADDRESS)

    @property
    def is_running(self) -> bool:
        return self._thread.is_alive()

    def call(self, act: Callable[[], object]) -> None:
        """Schedules a function call on the server's thread."""
        if self.loop is not None:
            with contextlib.suppress(RuntimeError):  # The loop may have ended.
                self.loop.call_soon_threadsafe(act)

    def close(self) -> None:
        if self._stop is not None and self._thread.is_alive():
            self.call(self._stop.set)
        self._thread.join()
        for each in self._sockets:
            each.close()

    # ---- methods for the server's thread

    async def _serve(self) -> None:
        self._stop, self.loop = asyncio.Event(), asyncio.get_running_loop()
        async with contextlib.AsyncExitStack() as stack:
            for each in self._sockets:
                server = serve(
                    self._handle,
                    sock=each,
                    max_size=_MAX_PART,
                    process_request=self._request,
                    process_response=self._response,
                    # A slow network may need any time for a response, see `_Connection`.
                    open_timeout=None,
                    create_connection=_Connection,
                    extensions=[DEFLATE],
                    close_timeout=1.0,
                )
                await stack.enter_async_context(server)
            self._is_serving.set()
            await self._stop.wait()

    async def _handle(self, connection: ServerConnection) -> None:
        if connection.request is not None and is_for_files(connection.request):
            await take_files(connection, self._may_upload, self._on_file)
        else:
            await self._talk(connection)

    def _request(self, connection: ServerConnection, request: Request) -> Response | None:
        refusal = self.guard.refusal(request)
        path, _, query = request.path.partition("?")
        if refusal is not None or path == self._path or is_for_files(request):
            return refusal
        found = self._answer(path, query)
        if found is None:
            return connection.respond(404, "no such page\n")
        headers = Headers()
        headers["Content-Type"] = _TYPES[found.ending]
        headers["Content-Length"] = str(len(found.body))
        if not found.is_cached:
            headers["Cache-Control"] = "no-store"
        return Response(200, "OK", headers, found.body)

    def _answer(self, path: str, query: str) -> PageAnswer | None:
        if path in ("/", "/index.html"):
            return PageAnswer(self._page, ".html")
        if path in self._files:
            return PageAnswer(self._files[path], Path(path).suffix, is_cached=True)
        if path == _PAGE_NAME:
            return PageAnswer(json.dumps({"page": self._path}).encode(), ".json")
        return self._find(path, query)

    def _response(
        self, connection: ServerConnection, request: Request, response: Response
    ) -> Response | None:
        self.guard.set_security_headers(request, response)
        self._compressed.compress(request, response)
        return None


class _Connection(ServerConnection):
    """A connection with a time limit for its request, but without one for the response."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.loop.call_later(_REQUEST_TIMEOUT, self._end_without_request)

    def _end_without_request(self) -> None:
        if self.request is None:
            self.transport.abort()


@functools.cache
def static_text(name: str) -> str:
    """Returns the contents of a text file in the folder `static`."""
    return (_STATIC / name).read_text("utf-8")


class PageListener:
    """Sockets that listen at an address while pages are served one after the other.

    Between two pages, no other process can use the port and receive the token that browsers send
    there. Connections wait until the next page is served.

    Raises:
        RenderError: the address or port does not exist or is in use.
    """

    def __init__(self, host: str = LOOPBACK, port: int = 0) -> None:
        if not (isinstance(port, int) and 0 <= port < 65536):
            raise RenderError(
                f"port {shown(port)}: expected 1 to 65535, or 0 for the first free port"
            )
        check_address(host)
        self.sockets = listen(host, port)

    def close(self) -> None:
        for each in self.sockets:
            each.close()


def listen(host: str, port: int) -> list[socket.socket]:
    """Opens listening sockets at an address. For `localhost`, both IP versions are opened.

    Raises:
        RenderError: no port is free, or the address cannot be used.
    """
    family, *_, address = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM,
                                             flags=socket.AI_PASSIVE)[0]  # fmt: skip
    wanted = [port] if port else range(_FIRST_PORT, _FIRST_PORT + _MAX_PORTS)
    error: OSError | None = None
    for number in wanted:
        found: list[socket.socket] = []
        try:
            found.append(_listening(family, (address[0], number, *address[2:])))
            found += _twin(str(address[0]), number)
        except OSError as failure:
            for each in found:
                each.close()
            error = failure
        else:
            return found
    where = f"{host}:{port}" if port else host
    assert error is not None
    raise RenderError(f"cannot serve a page at {where}: {error.strerror}") from error


def _listening(family: int, address: tuple[Any, ...]) -> socket.socket:
    found = socket.socket(family, socket.SOCK_STREAM)
    try:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind(address)
        # The socket must listen at once, because others can bind the same port until then.
        found.listen(_BACKLOG)
    except OSError:
        found.close()
        raise
    return found


def _twin(address: str, port: int) -> list[socket.socket]:
    twin = _TWINS.get(address)
    if twin is None:
        return []
    try:
        return [_listening(socket.AF_INET6 if ":" in twin else socket.AF_INET, (twin, port))]
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise
        return []  # This machine has only one IP version.


def check_address(host: str) -> str:
    """Returns the IP address of a host name. Raises RenderError if this machine cannot use it."""
    try:
        family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            trial.bind(address)
    except (OSError, UnicodeError) as error:
        raise RenderError(
            f"cannot serve a page at {host!r}: this machine has no such address ({error}). Use "
            f"{LOOPBACK} for browsers on this machine, or 0.0.0.0 for all browsers"
        ) from error
    return str(address[0])


def socket_url(url: str, path: str) -> str:
    """Returns the address of a page's websocket, including the token that `url` contains."""
    parts = urlsplit(url)
    return urlunsplit(("ws", parts.netloc, path, parts.query, ""))


def page_url(address: str, port: int, token: str | None = None) -> str:
    """Returns the address of a page for browsers on this machine."""
    if address in (*ANY_ADDRESS, LOOPBACK, "::1"):
        address = "localhost"
    query = "" if token is None else f"?token={token}"
    return f"http://{f'[{address}]' if ':' in address else address}:{port}/{query}"
