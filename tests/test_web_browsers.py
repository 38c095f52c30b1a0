"""Several browsers at one page: each has a layout for its size, and clicks when they were made."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.sync.client import ClientConnection, connect

from sero_mj import Mirror
from sero_mj.load import load_scene
from sero_mj.viewer.web import browsers as browsers_module
from sero_mj.viewer.web.browsers import Browsers
from sero_mj.viewer.web.host import WebHost

# Studio's server ends without closing the connection of its user interface.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


@pytest.fixture
def page(home: None) -> Iterator[WebHost]:
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror) as page:
        yield page


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time of `time.monotonic`, to be set."""
    now = [100.0]
    monkeypatch.setattr(browsers_module.time, "monotonic", lambda: now[0])
    return now


def state(visitor: ClientConnection) -> bytes:
    while not isinstance(message := visitor.recv(timeout=5), bytes):
        pass
    return message


def test_every_browser_is_sent_the_state_for_its_size(page: WebHost) -> None:
    url = f"ws://127.0.0.1:{page.port}/state?sid="
    known = page.viewer.server.browsers
    with connect(url + "large") as large, connect(url + "small") as small:
        large.send("sero-mj size 1280 800")
        small.send("sero-mj size 300 200")
        while len(known.sizes_beside((1, 1), 9)) < 2:  # until both were heard
            page.frame()
        assert known.sizes_beside((1280, 800), 9) == [(300, 200)]
        known.states = {(300, 200): b"laid out for 300 x 200"}
        page.viewer.server.update_state(b"laid out for 1280 x 800")
        while state(large) != b"laid out for 1280 x 800":
            large.send("state_ack")
        while state(small) != b"laid out for 300 x 200":
            small.send("state_ack")
    while known.sizes_beside((1, 1), 9):  # until both have left
        page.frame()


def test_sizes_of_most_browsers_come_first() -> None:
    known = Browsers()
    for connection, size in enumerate(["10 10", "20 20", "20 20", "30 30", "30 30", "30 30"]):
        assert known.hear(connection, f"sero-mj size {size}")
    assert known.sizes_beside((1, 1), 2) == [(30, 30), (20, 20)]
    assert known.sizes_beside((30, 30), 9) == [(20, 20), (10, 10)]
    known.hear(5, "sero-mj size 10 10")  # its window was made smaller
    known.forget(1)
    assert known.sizes_beside((1, 1), 9) == [(10, 10), (30, 30), (20, 20)]


def test_who_pressed_and_has_left_is_told_once() -> None:
    known = Browsers()
    known.hear(0, "sero-mj press 0")
    known.forget(1)
    assert not known.take_left()
    known.forget(0)
    assert [known.take_left(), known.take_left()] == [True, False]


def test_clicks_are_stamped_when_they_were_made(clock: list[float]) -> None:
    known = Browsers()
    known.hear(0, "sero-mj press 0")
    clock[0] += 1.2
    known.hear(0, "sero-mj press 0")
    clock[0] += 2.0  # the server was busy, and sees both now
    assert [known.press_time(0), known.press_time(0)] == [100.0, pytest.approx(101.2)]
    assert known.press_time(0) == clock[0]  # of a page that says nothing


def test_presses_that_were_no_clicks_are_forgotten(clock: list[float]) -> None:
    known = Browsers()
    known.hear(0, "sero-mj press 0")
    clock[0] += 5.0
    known.forget_presses()
    known.hear(0, "sero-mj press 1")
    known.hear(0, "sero-mj press 0")
    assert known.press_time(0) == clock[0] == 105.0


@given(st.text(max_size=40) | st.from_regex(r"sero-mj (size|press)[ 0-9-]*", fullmatch=True))
def test_other_messages_are_left_to_studio(message: str) -> None:
    known = Browsers()
    words = message.split(" ")
    is_heard = known.hear(0, message)
    if is_heard:
        assert words[0] == "sero-mj" and all(word.isascii() for word in words)
        assert words[1:2] != ["size"] or known.sizes_beside((0, 0), 1) == [
            (int(words[2]), int(words[3]))
        ]
    else:
        assert known.sizes_beside((0, 0), 1) == []
