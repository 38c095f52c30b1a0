"""Access control of the page's server.

Any website open in a browser can send requests to this machine and open websockets, to which the
same-origin policy does not apply. But it cannot choose the headers `Host`, `Origin` and
`Sec-Fetch-Site`. So these are checked on every path, before anything is answered:

- `Host` must name this machine; this excludes foreign names that resolve to it (DNS rebinding).
- `Origin`, if present, must be that of the page.
- Requests of other sites are refused, except opening the page itself.
- A token, if required, must be in the address (`?token=`), or what was made of it in the cookie
  that the page sets. Browsers send cookies to every port of a host, so other servers there get to
  know the cookie: it is named by the port, and does not tell the token.

Programs send neither `Origin` nor `Sec-Fetch-Site`; they are admitted by Host and token.
"""

from __future__ import annotations

import hmac
import ipaddress
import logging
import secrets
import socket
import urllib.parse

from websockets.datastructures import Headers, MultipleValuesError
from websockets.http11 import Request, Response

log = logging.getLogger(__name__)

TOKEN_BYTES = 24
_MOST_TOLD = 10  # refused requests that are logged; all are counted
_PAGE_PATHS = ("/", "/index.html")
# Of a page: it asks its own server, and nobody else, and runs no script that stands in it.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def is_loopback(address: str) -> bool:
    """Whether an IP address can only be reached from this machine."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address == "localhost"
    mapped = getattr(found, "ipv4_mapped", None)
    return (mapped or found).is_loopback


def make_token() -> str:
    """Returns a random token for the address of a page."""
    return secrets.token_urlsafe(TOKEN_BYTES)


class Guard:
    """Checks every request, and prevents other sites from reading the responses.

    Args:
        bound: the IP address that the server listens on.
        host: the address or name that the user specified for it.
        token: required token; None for none.

    Attributes:
        refused: number of refused requests.
    """

    def __init__(self, bound: str, host: str, token: str | None) -> None:
        self.token = token
        self.refused = 0
        self._is_private = is_loopback(bound)
        self._machine = "" if self._is_private else socket.gethostname().lower()
        self._names = {"localhost", host.lower(), self._machine} - {""}
        self._pass = hmac.digest((token or "").encode(), b"cookie", "sha256").hex()

    def refusal(self, request: Request) -> Response | None:
        """Returns a refusal of a request; None for one that may be answered."""
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
        path, _, query = request.path.partition("?")
        if path not in _PAGE_PATHS:
            return
        headers["Content-Security-Policy"] = _POLICY
        if self.token is not None and self._is_token(_token_of(query)):
            cookie = f"{_cookie_name(request.headers)}={self._pass}"
            headers["Set-Cookie"] = f"{cookie}; Path=/; HttpOnly; SameSite=Strict"

    def _refusal(self, headers: Headers, path: str, query: str) -> str | None:
        """Returns why a request is refused, or None."""
        reason = self._cross_site_reason(headers, path)
        if reason is not None:
            return reason
        if self.token is not None and not self._has_token(headers, query):
            return (
                "found no valid token; open the address that was printed where this page "
                f"was started: http://{headers['Host']}/?token=..."
            )
        return None

    def _cross_site_reason(self, headers: Headers, path: str) -> str | None:
        """Returns how a request differs from one of the page itself, or None."""
        try:
            host, origin = headers["Host"], headers.get("Origin")
            site, mode = headers.get("Sec-Fetch-Site", ""), headers.get("Sec-Fetch-Mode", "")
        except (KeyError, MultipleValuesError):
            return "expected one header Host, and no other one twice"
        if not self._is_own_host(_host_name(host)):
            return f"found Host {host!r}; expected {self._expected()}"
        own = [f"{scheme}://{host.lower()}" for scheme in ("http", "https")]
        if origin is not None and origin.lower() not in own:
            return f"found Origin {origin!r}; expected the page's own, http://{host}"
        is_opened = mode == "navigate" and path in _PAGE_PATHS
        if site in ("cross-site", "same-site") and not is_opened:
            return f"found Sec-Fetch-Site {site!r}; expected the page's own requests"
        return None

    def _is_own_host(self, name: str) -> bool:
        name = name.lower().removesuffix(".")
        if name in self._names or is_loopback(name):
            return True
        if self._is_private:
            return False
        try:
            ipaddress.ip_address(name)  # IP addresses cannot be rebound
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
        # Cookies of other servers on this host are sent too and may be malformed.
        pairs = [pair.strip() for text in headers.get_all("Cookie") for pair in text.split(";")]
        start = f"{_cookie_name(headers)}="
        given = [pair.removeprefix(start) for pair in pairs if pair.startswith(start)]
        return any(hmac.compare_digest(each.encode(), self._pass.encode()) for each in given)

    def _refuse(self, path: str, reason: str) -> Response:
        self.refused += 1
        if self.refused <= _MOST_TOLD:
            more = " (further ones are not logged)" if self.refused == _MOST_TOLD else ""
            log.warning("refused a request for %.60r: %.200s%s", path, reason, more)
        body = f"sero-mj: {reason}\n".encode()
        headers = Headers()
        headers["Content-Type"] = "text/plain; charset=utf-8"
        headers["Content-Length"] = str(len(body))
        headers["Cache-Control"] = "no-store"
        return Response(403, "Forbidden", headers, body)


def _host_name(host: str) -> str:
    """Returns the name in a Host header without its port: `::1` of `[::1]:8080`."""
    if host.startswith("["):
        return host[1:].partition("]")[0]
    return host.partition(":")[0]


def _cookie_name(headers: Headers) -> str:
    """Returns the name of a page's cookie, by the port that the browser knows: of a tunnel, say."""
    port = headers["Host"].rpartition("]")[2].partition(":")[2]
    return f"sero-mj-{port if port.isdecimal() else 80}"


def _token_of(query: str) -> str:
    try:
        found = urllib.parse.parse_qs(query, max_num_fields=20).get("token", [""])
    except ValueError:
        return ""
    return found[0]
