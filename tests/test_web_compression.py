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
from websockets.datastructures import Headers
from websockets.http11 import Request, Response
from websockets.sync.client import connect

from sero_mj import Mirror
from sero_mj.load import load_scene
from sero_mj.viewer.mujoco_private import page_files
from sero_mj.viewer.web import browsers
from sero_mj.viewer.web.compression import CompressedResponses
from sero_mj.viewer.web.host import WebHost

# Studio's server ends without closing the connection of its user interface.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture
def page(home: None) -> Iterator[WebHost]:
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror) as page:
        yield page


def get(page: WebHost, path: str, **headers: str) -> tuple[http.client.HTTPResponse, bytes]:
    """The answer to a request, and its body."""
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=10)
    named = {key.replace("_", "-"): value for key, value in headers.items()}
    connection.request("GET", path, headers={"Host": f"localhost:{page.port}", **named})
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


@pytest.mark.parametrize("path", ["/web_client.wasm", "/model?offset_bytes=0&size_bytes=500000"])
def test_files_and_models_are_compressed_for_who_can_read_it(page: WebHost, path: str) -> None:
    plain, whole = get(page, path)
    assert "Content-Encoding" not in plain.headers
    packed, less = get(page, path, Accept_Encoding="gzip, deflate, br")
    assert packed.headers["Content-Encoding"] == "gzip"
    assert packed.headers["Vary"] == "Accept-Encoding"
    assert len(less) == int(packed.headers["Content-Length"]) < 0.4 * len(whole)
    assert gzip.decompress(less) == whole
    # Those who may read it are the same.
    assert packed.headers["Cross-Origin-Resource-Policy"] == "same-origin"


def test_a_file_that_a_browser_has_is_not_sent_again(page: WebHost) -> None:
    first, body = get(page, "/web_client.js")
    assert body == (page_files() / "web_client.js").read_bytes()
    again, nothing = get(page, "/web_client.js", If_None_Match=first.headers["ETag"])
    assert (again.status, nothing) == (304, b"")
    other, whole = get(page, "/web_client.js", If_None_Match='"of an older version"')
    assert (other.status, whole) == (200, body)
    model, _ = get(page, "/model")  # the current one, which changes
    assert model.headers["Cache-Control"] == "no-store"
    assert "ETag" not in model.headers


def test_states_are_compressed_for_who_can_read_it(page: WebHost) -> None:
    url = f"ws://127.0.0.1:{page.port}/state?sid="
    with connect(url + "a") as packed, connect(url + "b", compression=None) as plain:
        assert "permessage-deflate" in packed.response.headers["Sec-WebSocket-Extensions"]
        assert "Sec-WebSocket-Extensions" not in plain.response.headers
        page.frame()
        states = {}
        for visitor in (packed, plain):
            while not isinstance(state := visitor.recv(timeout=5), bytes):
                pass
            states[visitor] = state
        assert states[packed] == states[plain]


def test_a_slow_link_is_waited_for_and_a_silent_one_is_not(
    page: WebHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(browsers, "_REQUEST_TIMEOUT", 0.2)
    expected = (page_files() / "web_client.wasm").read_bytes()
    with socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8192)
        slow.settimeout(10)
        slow.connect(("127.0.0.1", page.port))
        host = f"localhost:{page.port}"
        slow.sendall(f"GET /web_client.wasm HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        with socket.create_connection(("127.0.0.1", page.port), timeout=10) as silent:
            begin = time.monotonic()
            with contextlib.suppress(ConnectionResetError):
                assert silent.recv(1) == b""
            assert time.monotonic() - begin > 0.15
        # By now the other one has had longer, and has most of it yet to come.
        found = b""
        while part := slow.recv(65536):
            found += part
    assert found.partition(b"\r\n\r\n")[2] == expected


@given(st.lists(st.binary(max_size=5000), min_size=1, max_size=6))
def test_what_is_compressed_is_what_was_given(bodies: list[bytes]) -> None:
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


def test_refusals_are_left_as_they_are() -> None:
    headers = Headers({"Content-Length": "2000"})
    response = Response(403, "Forbidden", headers, b"a" * 2000)
    CompressedResponses().compress(Request("/", Headers({"Accept-Encoding": "gzip"})), response)
    assert response.body == b"a" * 2000
    assert "Content-Encoding" not in response.headers
