"""Who may talk to the page's server: the page itself, under its own names, with its token.

Any website that a browser has open can send requests to this machine, and open websockets, which
know no same-origin policy. It cannot choose the headers `Host`, `Origin` and `Sec-Fetch-Site`
though. So these are checked on every path, before Studio's server sees the request:

- `Host` names this machine; a name of somebody else's that leads here (DNS rebinding) does not.
- `Origin`, where a browser sends it, is the page's own.
- What another site asks for is refused, but for opening the page itself.
- Where a token is asked for, it is in the address (`?token=`) or in the cookie that the page sets.

Programs send neither `Origin` nor `Sec-Fetch-Site` and are let in by Host and token.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import logging
import secrets
import socket
import threading
import types
import urllib.parse
from collections.abc import Callable
from typing import Any

from mujoco.studio.web import web_server
from websockets.asyncio.server import serve
from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

from ...errors import RenderError

log = logging.getLogger(__name__)

TOKEN_BYTES = 24
_LONGEST_MESSAGE = 2**20  # bytes; input, a camera and the clipboard are far shorter
_OPEN_TIMEOUT = 10.0  # s until a connection has to have sent its request
_MOST_TOLD = 10  # requests that are refused and written into the log; all are counted
_PAGE_PATHS = ("/", "/index.html")
_FRAMES_OF = "vscode-webview: " + " ".join(  # notebooks show the page in a frame
    f"{scheme}://{name}:*" for name in ("localhost", "127.0.0.1") for scheme in ("http", "https")
)


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches an IP address."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address == "localhost"
    mapped = getattr(found, "ipv4_mapped", None)
    return (mapped or found).is_loopback


def make_token() -> str:
    """A token that nobody guesses, for an address."""
    return secrets.token_urlsafe(TOKEN_BYTES)


class Guard:
    """Checks every request, and keeps other sites from reading the answers.

    Args:
        page: the page itself, UTF-8.
        bound: the IP address that the server listens on.
        host: the address or name that its user gave for it.
        token: that has to be given; None where none is asked for.

    Attributes:
        refused: requests that were refused.
    """

    def __init__(self, page: bytes, bound: str, host: str, token: str | None) -> None:
        self.token = token
        self.refused = 0
        self._page = page
        self._is_private = is_loopback(bound)
        self._machine = "" if self._is_private else socket.gethostname().lower()
        self._names = {"localhost", host.lower(), self._machine} - {""}
        digest = hashlib.sha256((token or "").encode()).hexdigest()[:12]
        self._cookie = f"sero-mj-{digest}"  # several pages of one host name have one each

    def answer(self, request: Request) -> Response | None:
        """A refusal, or the page; None for what Studio's server is to answer."""
        path, _, query = request.path.partition("?")
        reason = self._refusal(request.headers, path, query)
        if reason is not None:
            return self._refuse(path, reason)
        if path not in _PAGE_PATHS:
            return None
        headers = Headers()
        headers["Content-Type"] = "text/html; charset=utf-8"
        headers["Content-Length"] = str(len(self._page))
        headers["Cache-Control"] = "no-store"
        # Threads of the page's program need a page that is isolated from others.
        headers["Cross-Origin-Opener-Policy"] = "same-origin"
        headers["Cross-Origin-Embedder-Policy"] = "require-corp"
        return Response(200, "OK", headers, self._page)

    def seal(self, request: Request, response: Response) -> None:
        """Sets the headers that keep other sites from reading an answer, or framing the page."""
        headers = response.headers
        for key in ("Access-Control-Allow-Origin", "Cross-Origin-Resource-Policy"):
            if key in headers:
                del headers[key]
        path, _, query = request.path.partition("?")
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        if path not in _PAGE_PATHS:
            headers["Cross-Origin-Resource-Policy"] = "same-origin"
            return
        name = _host_name(request.headers.get("Host", "")) if response.status_code == 200 else ""
        of_host = f"http://{name}:* https://{name}:*" if name and ":" not in name else ""
        headers["Content-Security-Policy"] = f"frame-ancestors 'self' {_FRAMES_OF} {of_host}"
        if self.token is not None and self._is_token(_token_of(query)):
            cookie = f"{self._cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            headers["Set-Cookie"] = cookie

    def _refusal(self, headers: Headers, path: str, query: str) -> str | None:
        """Why a request is refused, or None."""
        reason = self._foreign(headers, path)
        if reason is not None:
            return reason
        if self.token is not None and not self._has_token(headers, query):
            return (
                "found no valid token; open the address that was printed where this page "
                f"was started: http://{headers['Host']}/?token=..."
            )
        if path == "/drop":
            return "files are not taken: the page shows one scene"
        return None

    def _foreign(self, headers: Headers, path: str) -> str | None:
        """How a request shows that somebody else made it, or None."""
        try:
            host, origin = headers["Host"], headers.get("Origin")
            site, mode = headers.get("Sec-Fetch-Site", ""), headers.get("Sec-Fetch-Mode", "")
        except (KeyError, MultipleValuesError):
            return "expected one header Host, and no other one twice"
        if not self._is_ours(_host_name(host)):
            return f"found Host {host!r}; expected {self._expected()}"
        own = [f"{scheme}://{host.lower()}" for scheme in ("http", "https")]
        if origin is not None and origin.lower() not in own:
            return f"found Origin {origin!r}; expected the page's own, http://{host}"
        is_opened = mode == "navigate" and path in _PAGE_PATHS
        if site in ("cross-site", "same-site") and not is_opened:
            return f"found Sec-Fetch-Site {site!r}; expected the page's own requests"
        return None

    def _is_ours(self, name: str) -> bool:
        name = name.lower().removesuffix(".")
        if name in self._names or is_loopback(name):
            return True
        if self._is_private:
            return False
        try:
            ipaddress.ip_address(name)  # nobody can make an address lead elsewhere
        except ValueError:
            return name.startswith(f"{self._machine}.") and self._machine != "localhost"
        return True

    def _expected(self) -> str:
        if self._is_private:
            return "localhost; the page is for this machine only"
        return f"an IP address, or {' or '.join(sorted(self._names))}"

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), (self.token or "").encode())

    def _has_token(self, headers: Headers, query: str) -> bool:
        if self._is_token(_token_of(query)):
            return True
        # Cookies of other servers on this host come as well, and need not be well-formed.
        pairs = [pair.strip() for text in headers.get_all("Cookie") for pair in text.split(";")]
        given = [pair.partition("=")[2] for pair in pairs if pair.startswith(f"{self._cookie}=")]
        return any(self._is_token(token) for token in given)

    def _refuse(self, path: str, reason: str) -> Response:
        self.refused += 1
        if self.refused <= _MOST_TOLD:
            more = " (more of these are not told)" if self.refused == _MOST_TOLD else ""
            log.warning("refused a request for %.60r: %.200s%s", path, reason, more)
        body = f"sero-mj: {reason}\n".encode()
        headers = Headers()
        headers["Content-Type"] = "text/plain; charset=utf-8"
        headers["Content-Length"] = str(len(body))
        headers["Cache-Control"] = "no-store"
        return Response(403, "Forbidden", headers, body)


def _host_name(host: str) -> str:
    """The name in a Host header, without its port: `::1` of `[::1]:8080`."""
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]


def _token_of(query: str) -> str:
    try:
        found = urllib.parse.parse_qs(query, max_num_fields=20).get("token", [""])
    except ValueError:
        return ""
    return found[0]


class GuardedRun:
    """Studio's server, every connection of which a guard has let in.

    Studio gives `serve` of websockets what it answers with, and nobody a way to have a say. Its
    server runs here in a namespace whose `serve` asks the guard first; Studio itself is not
    changed. Should another Studio not come by here, the page is not served at all.

    Args:
        guard: is asked.
    """

    def __init__(self, guard: Guard) -> None:
        self._guard = guard
        self._is_guarded = threading.Event()
        self._error: OSError | None = None

    def __call__(self, server: Any, stop: threading.Event) -> None:
        """Runs until `stop` is set."""
        theirs = web_server._run_server
        namespace = {**theirs.__globals__, "serve": self._serve}
        run = types.FunctionType(
            theirs.__code__, namespace, theirs.__name__, theirs.__defaults__, theirs.__closure__
        )
        try:
            run(server, stop)
        except OSError as error:  # another program has taken the port meanwhile, say
            self._error = error
            self._is_guarded.set()

    def wait(self, seconds: float = 10.0) -> None:
        """Returns once every connection goes by the guard.

        Raises:
            RenderError: none does, or the server could not be started.
        """
        is_guarded = self._is_guarded.wait(seconds)
        if self._error is not None:
            raise RenderError(f"no web page: {self._error.strerror}") from self._error
        if not is_guarded:
            raise RenderError(
                "no web page: Studio's web server of this MuJoCo is another one, and requests of "
                "other sites could not be refused; `sero-mj view SCENE --window` needs none"
            )

    def _serve(self, handler: Any, **options: Any) -> Any:
        ask: Callable[..., Response | None] = options["process_request"]
        tell: Callable[..., Response | None] = options["process_response"]

        def process_request(connection: Any, request: Request) -> Response | None:
            answer = self._guard.answer(request)
            return ask(connection, request) if answer is None else answer

        def process_response(
            connection: Any, request: Request, response: Response
        ) -> Response | None:
            other = tell(connection, request, response)
            self._guard.seal(request, other or response)
            return other

        options |= {
            "process_request": process_request,
            "process_response": process_response,
            "max_size": _LONGEST_MESSAGE,
            "open_timeout": _OPEN_TIMEOUT,
        }
        options["sock"].listen()  # from now on connections wait for it, and none is refused
        self._is_guarded.set()
        return serve(handler, **options)
