"""What the page's server sends over slow links: less, once, and however long it takes."""

from __future__ import annotations

import contextlib
import gzip
import http.client
import socket
import time
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from page_client import PageClient
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from sero_mj import Mirror
from sero_mj.load import load_scene
from sero_mj.viewer.player.page import player_files
from sero_mj.viewer.web import server
from sero_mj.viewer.web.compression import CompressedResponses
from sero_mj.viewer.web.host import WebHost

PLAYER = player_files()["player.js"]


@pytest.fixture
def page(home: None) -> Iterator[WebHost]:
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror) as page:
        yield page


def get(page: WebHost, path: str, **headers: str) -> tuple[http.client.HTTPResponse, bytes]:
    """The answer to a request, and its body."""
    connection = http.client.HTTPConnection("127.0.0.1", page.server.port, timeout=10)
    named = {key.replace("_", "-"): value for key, value in headers.items()}
    connection.request("GET", path, headers={"Host": f"localhost:{page.server.port}", **named})
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


def test_files_are_compressed_for_who_can_read_it(page: WebHost) -> None:
    plain, whole = get(page, "/player.js")
    assert "Content-Encoding" not in plain.headers
    assert whole == PLAYER
    packed, less = get(page, "/player.js", Accept_Encoding="gzip, deflate, br")
    assert packed.headers["Content-Encoding"] == "gzip"
    assert packed.headers["Vary"] == "Accept-Encoding"
    assert len(less) == int(packed.headers["Content-Length"]) < 0.4 * len(whole)
    assert gzip.decompress(less) == whole
    # Those who may read it are the same.
    assert packed.headers["Cross-Origin-Resource-Policy"] == "same-origin"


def test_cached_file_is_not_sent_again(page: WebHost) -> None:
    first, body = get(page, "/player.js")
    again, nothing = get(page, "/player.js", If_None_Match=first.headers["ETag"])
    assert (again.status, nothing) == (304, b"")
    other, whole = get(page, "/player.js", If_None_Match='"of an older version"')
    assert (other.status, whole) == (200, body)
    html, _ = get(page, "/")
    assert html.headers["Cache-Control"] == "no-store"
    assert "ETag" not in html.headers


def test_states_are_compressed_for_who_can_read_it(page: WebHost) -> None:
    with PageClient(page) as packed, PageClient(page, compression=None) as plain:
        assert "permessage-deflate" in packed.line.response.headers["Sec-WebSocket-Extensions"]
        assert "Sec-WebSocket-Extensions" not in plain.line.response.headers
        for client in (packed, plain):
            client.until(lambda client=client: "run" in client.state)
        assert packed.state["run"] == plain.state["run"]


def test_slow_client_is_waited_for_and_a_silent_one_is_not(
    page: WebHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_REQUEST_TIMEOUT", 0.2)
    with socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
        slow.settimeout(10)
        slow.connect(("127.0.0.1", page.server.port))
        host = f"localhost:{page.server.port}"
        slow.sendall(f"GET /player.js HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        with socket.create_connection(("127.0.0.1", page.server.port), timeout=10) as silent:
            begin = time.monotonic()
            with contextlib.suppress(ConnectionResetError):
                assert silent.recv(1) == b""
            assert time.monotonic() - begin > 0.15
        # By now the other one has had longer, and has most of it yet to come.
        found = b""
        while part := slow.recv(65536):
            found += part
    assert found.partition(b"\r\n\r\n")[2] == PLAYER


@given(st.lists(st.binary(max_size=5000), min_size=1, max_size=6))
def test_compressed_responses_decode_to_the_original(bodies: list[bytes]) -> None:
    responses = CompressedResponses()
    for body in [*bodies, *bodies]:
        headers = Headers({"Content-Length": str(len(body)), "Cache-Control": "no-store"})
        response = Response(200, "OK", headers, body)
        responses.compress(Request("/", Headers({"Accept-Encoding": "gzip"})), response)
        sent = bytes(response.body or b"")
        assert int(response.headers["Content-Length"]) == len(sent)
        is_packed = "Content-Encoding" in response.headers
        assert (gzip.decompress(sent) if is_packed else sent) == body
        assert is_packed == (len(body) >= 1024)


def test_error_responses_are_not_compressed() -> None:
    headers = Headers({"Content-Length": "2000"})
    response = Response(403, "Forbidden", headers, b"a" * 2000)
    CompressedResponses().compress(Request("/", Headers({"Accept-Encoding": "gzip"})), response)
    assert response.body == b"a" * 2000
    assert "Content-Encoding" not in response.headers
