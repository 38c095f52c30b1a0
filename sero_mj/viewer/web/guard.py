"""Access control of a page's server.

The guard refuses requests of websites that are open in the user's browser. It also refuses requests
of other users of this machine, who can connect to every port and send any headers.

Three headers that websites cannot forge are checked for every path:

- `Host` must name this machine. This excludes external names that resolve to it (DNS rebinding).
- `Origin`, if present, must be the origin of the page.
- `Sec-Fetch-Site` must not name another site, except for opening the page.

A token, which a page has by default, excludes other users:

- The printed link contains the token (`?token=`). A script of the page, `access.js`, stores the
  token in the browser's `localStorage`, which belongs to one origin (scheme, name and port). The
  script also removes the token from the address bar. A reload, a second tab and a link to a view
  therefore need no token.
- The token is not stored in a cookie, because browsers send cookies to every port of a host.
  Another user's server on another port would receive the cookie.
- The page's HTML, scripts and styles contain no secret and need no token. The websockets, the
  scenes and images of the start page, and uploads need the token. The script adds the token to
  their addresses.
- An upload also needs the key of the connection in control, which only that connection has
  received, see `Browsers.is_in_control`. Someone who has only the token must take control first.
  All browsers display who is in control.
- The server listens on both loopback addresses. Otherwise, another user could listen on the second
  address, and browsers that resolve `localhost` to this address would send the token there.
- A token is valid until its viewer ends. A viewer uses the same port for all pages, see
  `PageListener`. If another user gets the port later, a token received there is useless.

Programs other than browsers send neither `Origin` nor `Sec-Fetch-Site`. They need only the host and
the token.
"""

from __future__ import annotations

import hmac
import ipaddress
import logging
import secrets
import socket
import urllib.parse
from collections.abc import Collection

from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

log = logging.getLogger(__name__)

TOKEN_BYTES = 24
_MAX_LOGGED = 10  # maximum number of refused requests in the log
_PAGE_PATHS = ("/", "/index.html")
_FORWARDED = ("Forwarded", "X-Forwarded-For", "X-Real-IP", "Via")  # headers of proxies
# A page only connects to its own server, and runs no inline scripts.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def is_loopback(address: str) -> bool:
    """Returns whether an address can only be reached from this machine."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address == "localhost"
    mapped = getattr(found, "ipv4_mapped", None)
    return (mapped or found).is_loopback


def is_local(connection: ServerConnection) -> bool:
    """Returns whether a connection comes from this machine.

    Connections through SSH tunnels and notebook kernels count as local, because their users can run
    programs on this machine anyway. Connections with headers of a proxy do not count as local.
    """
    request, peer = connection.request, connection.remote_address
    if request is None or not isinstance(peer, tuple) or not is_loopback(str(peer[0])):
        return False
    return not any(name in request.headers for name in _FORWARDED)


def same_text(text: str, expected: str) -> bool:
    """Returns whether two strings are equal, in a time that does not depend on their contents."""
    return hmac.compare_digest(text.encode("utf-8", "replace"), expected.encode())


def make_token() -> str:
    """Returns a random token for the address of a page."""
    return secrets.token_urlsafe(TOKEN_BYTES)


class Guard:
    """Checks every request to a page's server, and sets security headers of the responses.

    Args:
        bound: IP address that the server listens on.
        host: address or name that the user has specified for the server.
        token: required token, or None.
        public: paths of files that need no token.
    """

    def __init__(
        self, bound: str, host: str, token: str | None, public: Collection[str] = ()
    ) -> None:
        self.token = token
        self._public = {*_PAGE_PATHS, *public}
        self.refused = 0
        self._is_private = is_loopback(bound)
        self._machine = "" if self._is_private else socket.gethostname().lower()
        self._names = {"localhost", host.lower(), self._machine} - {""}

    def refusal(self, request: Request) -> Response | None:
        path, _, query = request.path.partition("?")
        reason = self._refusal(request.headers, path, query)
        return None if reason is None else self._refuse(path, reason)

    def set_security_headers(self, request: Request, response: Response) -> None:
        """Sets headers that prevent other sites from reading a response or embedding the page."""
        headers = response.headers
        headers["Cross-Origin-Opener-Policy"] = "same-origin"
        headers["Cross-Origin-Resource-Policy"] = "same-origin"
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        if request.path.partition("?")[0] in _PAGE_PATHS:
            headers["Content-Security-Policy"] = _POLICY

    def _refusal(self, headers: Headers, path: str, query: str) -> str | None:
        reason = self._cross_site_reason(headers, path)
        if reason is not None:
            return reason
        if self.token is None:
            return None
        token = _token_of(query)
        if token is None and path in self._public:
            return None
        if token is None or not same_text(token, self.token):
            return (
                "found no valid token; open the link that was printed when this page "
                f"was started: http://{headers['Host']}/?token=..."
            )
        return None

    def _cross_site_reason(self, headers: Headers, path: str) -> str | None:
        try:
            host, origin = headers["Host"], headers.get("Origin")
            site, mode = headers.get("Sec-Fetch-Site", ""), headers.get("Sec-Fetch-Mode", "")
        except (KeyError, MultipleValuesError):
            return "expected exactly one Host header, and no duplicate headers"
        if not self._is_own_host(_host_name(host)):
            return f"found Host {host!r}; expected {self._expected()}"
        own = [f"{scheme}://{host.lower()}" for scheme in ("http", "https")]
        if origin is not None and origin.lower() not in own:
            return f"found Origin {origin!r}; expected the origin of the page, http://{host}"
        is_opened = mode == "navigate" and path in _PAGE_PATHS
        if site in ("cross-site", "same-site") and not is_opened:
            return f"found Sec-Fetch-Site {site!r}; expected a request of the page"
        return None

    def _is_own_host(self, name: str) -> bool:
        name = name.lower().removesuffix(".")
        if name in self._names or is_loopback(name):
            return True
        if self._is_private:
            return False
        try:
            ipaddress.ip_address(name)  # DNS rebinding needs a name.
        except ValueError:
            return name.startswith(f"{self._machine}.") and self._machine != "localhost"
        return True

    def _expected(self) -> str:
        if self._is_private:
            return "localhost; only this machine can open the page"
        return f"an IP address, or {' or '.join(sorted(self._names))}"

    def _refuse(self, path: str, reason: str) -> Response:
        self.refused += 1
        if self.refused <= _MAX_LOGGED:
            more = " (further ones are not logged)" if self.refused == _MAX_LOGGED else ""
            log.warning("refused a request for %.60r: %.200s%s", path, reason, more)
        body = f"sero-mj: {reason}\n".encode()
        headers = Headers()
        headers["Content-Type"] = "text/plain; charset=utf-8"
        headers["Content-Length"] = str(len(body))
        headers["Cache-Control"] = "no-store"
        return Response(403, "Forbidden", headers, body)


def _host_name(host: str) -> str:
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]


def _token_of(query: str) -> str | None:
    try:
        fields = urllib.parse.parse_qs(query, keep_blank_values=True, max_num_fields=20)
    except ValueError:
        return ""
    return fields["token"][0] if "token" in fields else None
