"""Who is let in to a page: its own browsers, and nobody whom another website sends."""

from __future__ import annotations

import http.client
import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from conftest import free_udp_port
from page_client import read_sections
from web_tools import MISSING, Served
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from sero_mj import Mirror
from sero_mj.base.errors import RenderError, UsageError
from sero_mj.cli.browser import redirect_to
from sero_mj.load import load_scene
from sero_mj.viewer.web.guard import is_loopback
from sero_mj.viewer.web.host import WebHost
from sero_mj.viewer.web.server import PageListener, PageServer

# What a page is made of, without secrets, and what needs its token.
PUBLIC = ("/", "/index.html", "/player.js", "/player.css", "/access.js", "/uploads.js")
SECRET = ("/live", "/sero-mj/files", "/sero-mj/page", "/nothing")
PATHS = (*PUBLIC, *SECRET)


@pytest.fixture
def page(home: None) -> Iterator[WebHost]:
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror) as page:
        yield page


@pytest.fixture
def open_page(home: None) -> Iterator[WebHost]:
    """A page for everybody who has its address."""
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror, host="0.0.0.0") as page:
        yield page


def get(port: int, path: str = "/", **headers: str) -> tuple[int, str, dict[str, str]]:
    """Status, text and headers of an answer; `Sec_Fetch_Site` is the header Sec-Fetch-Site."""
    given = {"Host": f"localhost:{port}"} | {k.replace("_", "-"): v for k, v in headers.items()}
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    try:
        connection.request("GET", path, headers=given)
        answer = connection.getresponse()
        text = answer.read().decode("utf-8", "replace")
        return answer.status, text, dict(answer.headers)
    finally:
        connection.close()


def refusal_of(port: int, path: str, **options: Any) -> str:
    """What a websocket is refused with."""
    with (
        pytest.raises(InvalidStatus) as found,
        connect(f"ws://127.0.0.1:{port}{path}", **options),
    ):
        pass
    assert found.value.response.status_code == 403
    return bytes(found.value.response.body or b"").decode()


def test_every_path_rejects_unknown_hosts(page: WebHost) -> None:
    for path in PATHS:
        for host in (
            "evil.example",
            f"evil.example:{page.server.port}",
            "localhost.evil.example",
            "",
        ):
            status, text, _ = get(page.server.port, path, Host=host)
            assert status == 403, (path, host)
            expected = (
                f"found Host {host!r}; expected localhost; only this machine can open the page"
            )
            assert expected in text
    before = page.server.guard.refused
    assert before == 4 * len(PATHS)


def test_hosts_of_this_machine_are_accepted(page: WebHost) -> None:
    # A tunnel may have any port at its other end.
    for host in ("localhost", "localhost:9000", "127.0.0.1:1", "LOCALHOST.:80", "[::1]:8080"):
        assert get(page.server.port, "/", Host=host)[0] == 200, host
    # Not those of its network: they are not where it listens.
    assert get(page.server.port, "/", Host="192.168.1.7")[0] == 403


def test_every_path_rejects_other_origins(page: WebHost) -> None:
    port = page.server.port
    for path in PATHS:
        for origin in (
            "http://evil.example",
            "null",
            f"http://localhost:{port + 1}",
            f"http://127.0.0.1:{port}",
            f"http://localhost:{port}.evil.example",
        ):
            status, text, _ = get(port, path, Origin=origin)
            assert status == 403, (path, origin)
            assert f"found Origin {origin!r}; expected the origin of the page" in text
    token = f"?token={page.server.token}"
    for path in ("/live", "/sero-mj/files"):
        assert "found Origin" in refusal_of(port, path + token, origin="http://evil.example")
    with connect(f"ws://127.0.0.1:{port}/live{token}", origin=f"http://127.0.0.1:{port}") as own:
        assert read_sections(own.recv(timeout=5))["you"]["id"] == 1


def test_cross_site_embedding_is_rejected_and_links_are_not(page: WebHost) -> None:
    for site in ("cross-site", "same-site"):
        other = {"Sec_Fetch_Site": site, "Sec_Fetch_Mode": "no-cors"}
        for path in ("/", "/player.js", "/player.css"):
            status, text, _ = get(page.server.port, path, **other)
            assert (status, f"found Sec-Fetch-Site '{site}'" in text) == (403, True)
        assert get(page.server.port, "/", Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate")[0] == 200
        assert (
            get(page.server.port, "/player.js", Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate")[0]
            == 403
        )


def test_no_response_is_readable_by_other_sites(page: WebHost) -> None:
    token = f"?token={page.server.token}"
    for path in (*PUBLIC, "/sero-mj/page" + token, "/nothing" + token, "/nothing"):
        _, _, headers = get(page.server.port, path)
        assert "Access-Control-Allow-Origin" not in headers, path
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert headers["Cross-Origin-Opener-Policy"] == "same-origin"
    with connect(f"ws://127.0.0.1:{page.server.port}/live{token}") as own:
        assert own.response is not None
        assert "Access-Control-Allow-Origin" not in own.response.headers


def test_page_requests_its_own_server_only_and_has_no_inline_scripts(
    page: WebHost,
) -> None:
    for path in ("/", "/index.html"):
        _, text, headers = get(page.server.port, path)
        policy = dict(
            part.strip().split(" ", 1) for part in headers["Content-Security-Policy"].split(";")
        )
        assert policy["default-src"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
        assert policy["frame-ancestors"] == "'none'"
        assert "<script>" not in text
        assert " style=" not in text


def test_too_long_messages_end_their_connection(page: WebHost) -> None:
    with connect(f"ws://127.0.0.1:{page.server.port}/live?token={page.server.token}") as own:
        own.send(bytes(2**20 + 1))
        with pytest.raises(ConnectionClosed, match="1009"):  # message too big
            while True:
                own.recv(timeout=5)


def test_malformed_requests_are_rejected(page: WebHost) -> None:
    port = page.server.port
    for lines in (
        "GET / HTTP/1.1\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil.example\r\n\r\n",
        "GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: null\r\nOrigin: null\r\n\r\n",
    ):
        with socket.create_connection(("127.0.0.1", port), 5) as raw:
            raw.sendall(lines.encode())
            assert raw.recv(100).startswith(b"HTTP/1.1 403 "), lines
    assert get(port)[0] == 200


def test_refusals_do_not_fill_the_log(page: WebHost, caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(30):
        get(page.server.port, "/live", Host="evil.example")
    told = [r.getMessage() for r in caplog.records if "refused a request" in r.getMessage()]
    assert len(told) == 10
    assert told[-1].endswith("(further ones are not logged)")
    assert page.server.guard.refused == 30


def test_page_requires_its_token_and_its_files_do_not(page: WebHost) -> None:
    port, token = page.server.port, page.server.token
    assert token is not None and len(token) >= 32
    assert page.url == f"http://localhost:{port}/?token={token}"
    for path in PUBLIC:  # reloaded without the token, which the browser has stored
        status, text, headers = get(port, path)
        assert status == 200, path
        assert token not in text
        assert "Set-Cookie" not in headers
        for wrong in ("", "x" * len(token), "%FF", f"{token}x", f"{token}&" + "a=1&" * 30):
            status, text, _ = get(port, f"{path}?token={wrong}")
            assert (status, "found no valid token; open the link" in text) == (403, True), wrong
    for path in SECRET:
        assert get(port, path)[0] == 403, path
        # Nothing that a browser sends to other ports of this host, too, opens anything.
        for header in ("Cookie", "Authorization", "Referer"):
            for value in (token, f"sero-mj-{port}={token}", f"token={token}", page.url):
                assert get(port, path, **{header: value})[0] == 403, (path, header)
    assert "found no valid token" in refusal_of(port, "/live")
    status, text, _ = get(port, f"/?token={token}")
    assert (status, "<canvas" in text, token in text) == (200, True, False)
    assert json.loads(get(port, f"/sero-mj/page?token={token}")[1]) == {"page": "/live"}
    assert get(port, f"/nothing?token={token}")[0] == 404
    # Who has the token, and is sent by another site, does not come in either.
    for other in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}):
        assert get(port, f"/sero-mj/page?token={token}", **other)[0] == 403


def test_every_page_has_its_own_token(page: WebHost) -> None:
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror) as other:
        assert other.server.token != page.server.token
        assert get(other.server.port, f"/sero-mj/page?token={page.server.token}")[0] == 403


def test_page_without_a_token_warns_and_is_for_this_machine_only(
    home: None, caplog: pytest.LogCaptureFixture
) -> None:
    with Mirror(load_scene("lwr")) as mirror:
        with WebHost(mirror, token=False) as page:
            port = page.server.port
            assert page.url == f"http://localhost:{port}/"
            assert f"the page at port {port} has no token" in caplog.text
            for path in (*PUBLIC, "/sero-mj/page"):
                assert get(port, path)[0] == 200
        with pytest.raises(UsageError, match="a page for other machines needs a token"):
            WebHost(mirror, host="0.0.0.0", token=False)


def test_page_for_other_machines_accepts_its_host_names(open_page: WebHost) -> None:
    page, port, token = open_page, open_page.server.port, open_page.server.token
    assert not page.server.is_private
    assert page.urls[0] == page.url
    assert page.urls[1] == f"http://{socket.gethostname()}:{port}/?token={token}"
    for host in (f"127.0.0.1:{port}", "192.168.1.7", "[fe80::1]", socket.gethostname()):
        assert get(port, f"/sero-mj/page?token={token}", Host=host)[0] == 200
        assert get(port, "/sero-mj/page", Host=host)[0] == 403


@pytest.mark.parametrize("address", ["127.0.0.1", "::1", "0.0.0.0"])
def test_no_other_process_can_listen_on_the_localhost_addresses(address: str, home: None) -> None:
    if not has_ipv6():
        pytest.skip("this machine has no IPv6 loopback")
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror, host=address) as page:
        for family, other in ((socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1")):
            with socket.socket(family, socket.SOCK_STREAM) as thief:
                thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                with pytest.raises(OSError, match="in use"):
                    thief.bind((other, page.server.port))
                    thief.listen()
            with connect(f"ws://{'[::1]' if ':' in other else other}:{page.server.port}/live"
                         f"?token={page.server.token}") as line:  # fmt: skip
                assert "you" in read_sections(line.recv(timeout=5))
        # Where somebody is there already, the page goes elsewhere.
        with socket.socket(socket.AF_INET6, socket.SOCK_STREAM) as thief:
            thief.bind(("::1", 0))
            thief.listen()
            with pytest.raises(RenderError, match="in use"):
                WebHost(mirror, host="127.0.0.1", port=thief.getsockname()[1])


def test_browser_on_this_machine_is_recognized(open_page: WebHost) -> None:
    """For what only who sits at this machine may allow."""
    page, port = open_page, open_page.server.port

    def is_local(address: str, **headers: str) -> bool:
        with connect(
            f"ws://{address}:{port}/live?token={page.server.token}", additional_headers=headers
        ) as line:
            found: bool = read_sections(line.recv(timeout=5))["you"]["isLocal"]
            return found

    assert is_local("127.0.0.1")
    assert not is_local("127.0.0.1", **{"X-Forwarded-For": "192.168.1.7"})
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing
        except OSError:
            return  # this machine has no network
        own = probe.getsockname()[0]
    assert is_loopback(own) or not is_local(own)


def has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6, socket.SOCK_STREAM) as found:
            found.bind(("::1", 0))
    except OSError:
        return False
    return True


def test_addresses_of_this_machine_are_known() -> None:
    for address in ("127.0.0.1", "127.3.2.1", "::1", "::ffff:127.0.0.1", "localhost"):
        assert is_loopback(address)
    for address in ("0.0.0.0", "::", "192.168.1.7", "::ffff:192.168.1.7", "fe80::1%eth0", "x"):
        assert not is_loopback(address)


ATTACK = """<!doctype html><body></body><script>
const at = "PAGE";
async function socket(path) {
  return new Promise((done) => {
    const ws = new WebSocket(at.replace("http", "ws") + path);
    ws.onopen = () => { ws.send('{"t":"control"}'); };
    ws.onmessage = () => done("read");
    ws.onclose = () => done("refused");
    ws.onerror = () => done("refused");
    setTimeout(() => done("open"), 3000);
  });
}
async function read(path, mode) {
  try {
    const answer = await fetch(at + path, { mode });
    return answer.type === "opaque" ? "opaque" : (await answer.blob()).size;
  } catch (error) { return "refused"; }
}
async function script(path) {
  return new Promise((done) => {
    const tag = document.createElement("script");
    tag.onload = () => done("ran");
    tag.onerror = () => done("refused");
    tag.src = at + path;
    document.head.append(tag);
  });
}
async function frame() {
  return new Promise((done) => {
    const tag = document.createElement("iframe");
    tag.onload = () => done();
    tag.src = at + "/";
    document.body.append(tag);
  });
}
async function attack() {
  return {
    live: await socket("/live"), files: await socket("/sero-mj/files"),
    which: await read("/sero-mj/page", "cors"),
    player: await read("/player.js", "cors"), blind: await read("/player.js", "no-cors"),
    page: await read("/", "cors"), script: await script("/player.js"),
  };
}
</script>"""


class Website:
    """A website of somebody else, that leads to a page of ours in whoever opens it.

    Args:
        target: the page.
        told: takes what browsers send to it.
    """

    def __init__(self, target: str, told: list[str] | None = None) -> None:
        target = target.partition("?")[0]
        body = ATTACK.replace("PAGE", target.rstrip("/")).encode()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                (told if told is not None else []).append(f"{self.path}\n{self.headers}")
                self.send_response(200)
                self.send_header("Content-Type", "text/html")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *args: Any) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        self.port = self._server.server_port

    def __enter__(self) -> Website:
        return self

    def __exit__(self, *exc: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.timeout(200)
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_website_in_the_browser_of_the_user_gets_nothing(browser: Any, tmp_path: Path) -> None:
    """Its own script, from its own origin, and by a name that it makes lead here."""
    with browser.new_context() as evil, Served(tmp_path, "lwr") as served:
        port = urlsplit(served.url).port
        for target in (f"http://localhost:{port}", f"http://rebound.example:{port}"):
            with Website(target) as site:
                visited = evil.new_page()
                visited.goto(f"http://evil.example:{site.port}/")
                found = visited.evaluate("attack()")
                assert set(found.values()) == {"refused"} or found == dict.fromkeys(
                    found, "refused"
                ) | {"blind": "opaque"}, (target, found)
                visited.close()
        rebound = evil.new_page()
        answer = rebound.goto(f"http://rebound.example:{port}/")
        assert answer.status == 403
        assert "expected localhost" in answer.text()
        # Nobody has looked at it in all this, and nothing was uploaded.
        assert served.ask("w.is_seen") is False
        assert served.ask("w._dropped") == []
        assert served.ask("w.server.guard.refused") >= 10
        rebound.close()
        # No other site has it in a frame, under which clicks would be its.
        with Website(served.url) as site:
            framing = evil.new_page()
            said: list[str] = []
            framing.on("console", lambda message: said.append(message.text))
            framing.goto(f"http://evil.example:{site.port}/")
            framing.evaluate("frame()")
            assert any("frame-ancestors" in line for line in said), said
            assert served.ask("w.is_seen") is False
            framing.close()


@pytest.mark.gl
@pytest.mark.timeout(200)
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_browser_with_the_address_shows_the_robot(browser: Any, tmp_path: Path) -> None:
    context = browser.new_context(viewport={"width": 280, "height": 240}, device_scale_factor=0.5)
    with closing(context), Served(tmp_path, "lwr") as served:
        page = context.new_page()
        plain = served.url.partition("?")[0]
        page.goto(plain)
        page.wait_for_function("() => document.getElementById('problem').innerText.match('locked')")
        assert served.ask("w.is_seen") is False
        with closing(context.new_page()) as second:
            # As `view` opens it, without the token in the arguments of a program.
            file = redirect_to(f"{served.url}#view=x")
            assert file.stat().st_mode & 0o077 == 0
            second.goto(file.as_uri())
            second.wait_for_url(f"{plain}#view=x")
            second.wait_for_function("() => globalThis.player?.state")
            # The address bar has lost the token, and a reload does not need it.
            assert second.url == f"{plain}#view=x"
            second.reload()
            second.wait_for_function("() => player.state")
            # Nor does the tab that was locked, which goes on.
            page.wait_for_function("() => player.state")
            served.until("len(w.browsers._browsers) == 2")
            # Who reloads a page stays in control of it.
            second.evaluate("document.getElementById('take').click()")
            second.wait_for_function("() => player.isInControl")
            second.reload()
            second.wait_for_function("() => globalThis.player?.isInControl")
            assert context.cookies() == []


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.timeout(200)
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_another_users_server_on_another_port_learns_nothing(browser: Any, tmp_path: Path) -> None:
    """It can ask any port with any headers, and whoever uses the page visits it, too."""
    told: list[str] = []
    with closing(browser.new_context()) as user, Served(tmp_path, "lwr") as served:
        page = user.new_page()
        page.goto(served.url)
        page.wait_for_function("() => player.state")
        token = parse_qs(urlsplit(served.url).query)["token"][0]
        with Website(served.url, told) as site:
            visited = user.new_page()
            visited.goto(f"http://localhost:{site.port}/")
            found = visited.evaluate("attack()")
            assert set(found.values()) <= {"refused", "opaque"}, found
            assert visited.evaluate("JSON.stringify(localStorage)") == "{}"
        assert told
        assert token not in "".join(told)
        assert "Cookie" not in "".join(told)


def test_terminal_prints_the_address_of_the_page_and_the_expected_packets(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sero_mj", "view", "lwr_udp", "--web"]
    port = free_udp_port()
    with subprocess.Popen(
        [*command, "--set", f"sources.udp.port={port}"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert "lwr_udp is at http://localhost:" in process.stdout.readline()
        said = process.stdout.readline()
        process.terminate()
    assert said == f"waiting for packets of 112 bytes on UDP 127.0.0.1:{port}\n"


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform == "win32", reason="there are no such signals")
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_terminated_page_leaves_no_files(sent: signal.Signals, tmp_path: Path) -> None:
    import os

    folder = tmp_path / "tmp"
    folder.mkdir()
    with subprocess.Popen(
        [sys.executable, "-m", "sero_mj", "view", "lwr", "--web"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(folder), "HOME": str(tmp_path)},
    ) as process:
        assert process.stdout is not None
        assert "lwr is at http://localhost:" in process.stdout.readline()
        process.send_signal(sent)
        status = process.wait(timeout=20)
    assert list(folder.iterdir()) == []
    assert status == (-signal.SIGKILL if sent == signal.SIGKILL else 0)


def test_port_is_held_between_two_pages_of_a_viewer() -> None:
    """Another user's program that listens there would receive the token that browsers send."""
    listener = PageListener("127.0.0.1")
    port = listener.sockets[0].getsockname()[1]

    def page(text: str) -> PageServer:
        async def talk(connection: Any) -> None:
            del connection

        return PageServer(
            text, {}, talk, "/live", lambda key: None, lambda path: None, port=listener
        )

    def is_free() -> bool:
        with socket.socket() as other:
            other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                other.bind(("127.0.0.1", port))
                other.listen()
            except OSError:
                return False
        return True

    first = page("<html>first</html>")
    assert get(port, "/")[1] == "<html>first</html>"
    first.close()
    assert not is_free()
    with socket.create_connection(("127.0.0.1", port), 10) as waiting:  # until the next page
        waiting.sendall(f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n".encode())
        second = page("<html>second</html>")
        assert b"second" in waiting.recv(100_000)
        assert second.port == port
        second.close()
    assert not is_free()
    listener.close()
    assert is_free()
