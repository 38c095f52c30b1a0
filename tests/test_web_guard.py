"""Who is let in to a page: its own browsers, and nobody whom another website sends."""

from __future__ import annotations

import http.client
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
from sero_mj.load import load_scene
from sero_mj.viewer.web.guard import is_loopback
from sero_mj.viewer.web.host import WebHost

PATHS = ("/", "/index.html", "/player.js", "/player.css", "/uploads.js", "/live", "/sero-mj/files")


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


def test_every_path_refuses_hosts_of_others(page: WebHost) -> None:
    for path in (*PATHS, "/nothing"):
        for host in (
            "evil.example",
            f"evil.example:{page.server.port}",
            "localhost.evil.example",
            "",
        ):
            status, text, _ = get(page.server.port, path, Host=host)
            assert status == 403, (path, host)
            expected = f"found Host {host!r}; expected localhost; the page is for this machine only"
            assert expected in text
    before = page.server.guard.refused
    assert before == 4 * 8


def test_hosts_that_are_this_machine_are_let_in(page: WebHost) -> None:
    # A tunnel may have any port at its other end.
    for host in ("localhost", "localhost:9000", "127.0.0.1:1", "LOCALHOST.:80", "[::1]:8080"):
        assert get(page.server.port, "/", Host=host)[0] == 200, host
    # Not those of its network: they are not where it listens.
    assert get(page.server.port, "/", Host="192.168.1.7")[0] == 403


def test_every_path_refuses_origins_of_others(page: WebHost) -> None:
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
            assert f"found Origin {origin!r}; expected the page's own" in text
    for path in ("/live", "/sero-mj/files"):
        assert "found Origin" in refusal_of(port, path, origin="http://evil.example")
    with connect(f"ws://127.0.0.1:{port}/live", origin=f"http://127.0.0.1:{port}") as own:
        assert read_sections(own.recv(timeout=5)) == {"you": {"id": 1}}


def test_what_other_sites_embed_is_refused_and_links_are_not(page: WebHost) -> None:
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


def test_no_answer_may_be_read_by_others(page: WebHost) -> None:
    for path in (*PATHS[:5], "/nothing"):
        _, _, headers = get(page.server.port, path)
        assert "Access-Control-Allow-Origin" not in headers, path
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
        assert headers["Cross-Origin-Opener-Policy"] == "same-origin"
    with connect(f"ws://127.0.0.1:{page.server.port}/live") as own:
        assert own.response is not None
        assert "Access-Control-Allow-Origin" not in own.response.headers


def test_a_page_asks_its_own_server_only_and_runs_no_script_that_stands_in_it(
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


def test_messages_that_are_too_long_end_their_connection(page: WebHost) -> None:
    with connect(f"ws://127.0.0.1:{page.server.port}/live") as own:
        own.send(bytes(2**20 + 1))
        with pytest.raises(ConnectionClosed, match="1009"):  # message too big
            while True:
                own.recv(timeout=5)


def test_requests_that_are_none_are_refused(page: WebHost) -> None:
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


def test_beyond_this_machine_a_token_is_needed(open_page: WebHost) -> None:
    page, port = open_page, open_page.server.port
    assert not page.server.is_private
    assert page.urls[0] == page.url
    assert page.urls[1].startswith(f"http://{socket.gethostname()}:{port}/?token=")
    (token,) = parse_qs(urlsplit(page.url).query)["token"]
    assert len(token) >= 32
    for path in (*PATHS, "/?token=", "/?token=" + "x" * len(token), "/?token=%FF"):
        status, text, headers = get(port, path)
        assert (status, "found no valid token; open the address" in text) == (403, True), path
        assert "Set-Cookie" not in headers
    assert "found no valid token" in refusal_of(port, "/live")

    for host in (f"127.0.0.1:{port}", "192.168.1.7", "[fe80::1]", socket.gethostname()):
        assert get(port, f"/?token={token}", Host=host)[0] == 200
    status, text, headers = get(port, f"/?token={token}")
    assert (status, "<canvas" in text) == (200, True)
    cookie, *about = headers["Set-Cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} == set(about)
    # Browsers send it to other servers on this host, too.
    assert cookie.startswith(f"sero-mj-{port}=")
    assert token not in cookie
    _, _, elsewhere = get(port, f"/?token={token}", Host="192.168.1.7:9000")
    assert elsewhere["Set-Cookie"].startswith("sero-mj-9000=")
    for host in ("127.0.0.1", "[::1]"):
        _, _, elsewhere = get(port, f"/?token={token}", Host=host)
        assert elsewhere["Set-Cookie"].startswith("sero-mj-80=")
    stolen = cookie.partition("=")[2]
    assert get(port, f"/player.js?token={stolen}")[0] == 403
    assert get(port, "/player.js", Cookie=f"sero-mj-{port + 1}={stolen}")[0] == 403
    assert get(port, "/player.js", Cookie=f'junk="{{; a b=[; {cookie}')[0] == 200
    assert get(port, "/player.js", Cookie=cookie + "x")[0] == 403
    # Who has the cookie, and is sent by another site, does not come in either.
    assert get(port, "/player.js", Cookie=cookie, Origin="http://evil.example")[0] == 403
    assert get(port, "/player.js", Cookie=cookie, Host="evil.example")[0] == 403
    # Files in the page have it, too: in a frame of another site browsers send no cookie.
    assert f'"/player.js?token={token}"' in text
    with connect(f"ws://127.0.0.1:{port}/live?token={token}") as own:
        assert read_sections(own.recv(timeout=5)) == {"you": {"id": 1}}


def test_a_token_can_be_had_on_this_machine_too(home: None) -> None:
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror, token=True) as page:
        assert page.server.is_private
        assert get(page.server.port)[0] == 403
        assert get(page.server.port, page.url.partition(str(page.server.port))[2])[0] == 200
        first = page.url
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror, token=True) as page:
        assert page.url.partition("token=")[2] != first.partition("token=")[2]


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
    player: await read("/player.js", "cors"), blind: await read("/player.js", "no-cors"),
    page: await read("/", "cors"), script: await script("/player.js"),
  };
}
</script>"""


class Website:
    """A website of somebody else, that leads to a page of ours in whoever opens it.

    Args:
        target: the page.
    """

    def __init__(self, target: str) -> None:
        body = ATTACK.replace("PAGE", target.rstrip("/")).encode()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
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
def test_a_website_in_the_users_browser_gets_nothing(browser: Any, tmp_path: Path) -> None:
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
def test_a_browser_with_the_address_sees_the_robot(browser: Any, tmp_path: Path) -> None:
    page = browser.new_page(viewport={"width": 280, "height": 240}, device_scale_factor=0.5)
    with closing(page), Served(tmp_path, "lwr", token=True) as served:
        assert page.goto(served.url.partition("?")[0]).status == 403
        page.goto(served.url)
        # A function: Playwright evaluates other texts, which the page's policy refuses.
        page.wait_for_function("() => document.documentElement.dataset.ready === '1'")
        served.until("w.is_seen")


def test_the_terminal_says_where_the_page_is_and_what_it_waits_for(tmp_path: Path) -> None:
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
def test_a_page_that_is_ended_leaves_no_files(sent: signal.Signals, tmp_path: Path) -> None:
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
