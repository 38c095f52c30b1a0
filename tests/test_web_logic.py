"""The page without a browser: its keys, its addresses, and when there is one."""

from __future__ import annotations

import queue
import urllib.request
import webbrowser
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from sero_mj.base.errors import DeclarationError, RenderError, UsageError
from sero_mj.cli import main
from sero_mj.cli.view import Session, ViewOptions, wants_page
from sero_mj.viewer.decor.font import DEFAULT_FONT
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.decor.panels import labels_at
from sero_mj.viewer.session.keys import help_columns
from sero_mj.viewer.session.tool import tool_keys
from sero_mj.viewer.web.page_state import billboard_lines
from sero_mj.viewer.web.server import check_address, page_url


def test_help_of_the_page_describes_the_page() -> None:
    rows = [row for column in help_columns(tool_keys(), on_page=True) for row in column]
    assert ("t", "panel on or off") in rows
    assert not {how for how, _ in rows} & {"F11", "Ctrl+Q"}
    assert {"F11", "Ctrl+Q"} <= {how for column in help_columns(tool_keys()) for how, _ in column}


def test_line_widths_equal_the_sums_of_characters() -> None:
    lines = [b"A1 -12.3 Nm", b"", b"i"]
    assert DEFAULT_FONT.line_widths(lines).tolist() == [DEFAULT_FONT.width(line) for line in lines]


def image_view(**options: Any) -> ImageView:
    return ImageView(
        position=np.array([0.0, -3.0, 0.5]),
        right=np.array([1.0, 0.0, 0.0]),
        up=np.array([0.0, 0.0, 1.0]),
        forward=np.array([0.0, 1.0, 0.0]),
        tan_half_fovy=0.4,
        near=0.01,
        width=800,
        height=600,
        **options,
    )


def test_panels_stay_clear_of_what_the_host_covers() -> None:
    view = image_view(inset=(300.0, 50.0, 100.0, 20.0))
    wanted = np.array([[0.0, 0.0], [790.0, 599.0], [400.0, 300.0]])
    centres, sizes = labels_at(view, wanted, [[b"one"], [b"two"], [b"three"]])
    low, high = centres - sizes / 2, centres + sizes / 2
    assert (low >= [300.0, 50.0]).all()
    assert (high <= [700.0, 580.0]).all()
    assert centres[2].tolist() == [400.0, 300.0]


def test_billboard_text_is_split_into_title_values_and_labels() -> None:
    assert billboard_lines([b"A1      12.3 Nm"]) == ("A1", [["", "12.3 Nm"]])
    assert billboard_lines([b"A1  cmd     1.2 Nm", b"    msr  no data"]) == (
        "A1",
        [["cmd", "1.2 Nm"], ["msr", "no data"]],
    )
    assert billboard_lines([b"push: force", b"x   3.0 N"]) == ("push: force", [["x", "3.0 N"]])
    assert billboard_lines([b"hot"]) == ("", [["", "hot"]])


def test_page_addresses_are_valid_for_browsers() -> None:
    assert page_url("127.0.0.1", 8080) == "http://localhost:8080/"
    assert page_url("0.0.0.0", 80) == "http://localhost:80/"
    assert page_url("192.168.1.7", 8080) == "http://192.168.1.7:8080/"
    assert page_url("fe80::1", 8080) == "http://[fe80::1]:8080/"
    assert page_url("::", 8080, "secret") == "http://localhost:8080/?token=secret"


@pytest.mark.parametrize("host", ["203.0.113.7", "no such host", "x" * 300])
def test_address_of_another_machine_is_rejected(host: str) -> None:
    with pytest.raises(RenderError, match="this machine has no such address"):
        check_address(host)
    check_address("127.0.0.1")
    check_address("localhost")


def test_there_is_a_page_where_there_is_no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sero_mj.viewer.image.backend.has_display", lambda: True)
    assert not wants_page(ViewOptions(scene="lwr"))
    assert wants_page(ViewOptions(scene="lwr", web=True))
    assert wants_page(ViewOptions(scene="lwr", port=8081))
    assert wants_page(ViewOptions(scene="lwr", host="0.0.0.0"))
    monkeypatch.setattr("sero_mj.viewer.image.backend.has_display", lambda: False)
    assert wants_page(ViewOptions(scene="lwr"))


def test_reason_for_a_page_instead_of_a_window_is_printed_once_a_scene_is_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sero_mj.viewer.image.backend.has_display", lambda: False)
    monkeypatch.setattr("sero_mj.cli.view.Session.show", lambda session, scene: None)
    for scene, said in (("lwr", True), ("lrw", False)):
        with pytest.raises(SystemExit):
            main(["view", scene])
        err = capsys.readouterr().err
        assert ("no display for a window, serving a web page" in err) == said, scene


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"window": True, "port": 8080}, "--port needs --web"),
        ({"window": True, "host": "0.0.0.0"}, "--host needs --web"),
        ({"window": True, "token": True}, "--token needs --web"),
        ({"window": True, "no_token": True}, "--no-token needs --web"),
        ({"window": True, "no_browser": True}, "--no-browser needs --web"),
        ({"token": True, "no_token": True}, "--token cannot be combined with --no-token"),
        ({"web": True, "size": (640, 480)}, "--size needs a window"),
        ({"port": 8080, "full_screen": True}, "--full-screen needs a window"),
        ({"window": True}, "no display for a window"),
        ({"size": (640, 480)}, "no display for a window"),
    ],
)
def test_options_of_the_other_host_are_refused(
    monkeypatch: pytest.MonkeyPatch, given: dict[str, Any], expected: str
) -> None:
    monkeypatch.setattr("sero_mj.viewer.image.backend.has_display", lambda: False)
    with pytest.raises((UsageError, DeclarationError), match=expected):
        wants_page(ViewOptions(scene="lwr", **given))


def test_browser_is_opened_only_for_local_users(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    opened: queue.SimpleQueue[str] = queue.SimpleQueue()
    monkeypatch.setattr(webbrowser, "open", opened.put)
    for name in ("SSH_CONNECTION", "SSH_TTY"):
        monkeypatch.delenv(name, raising=False)
    session = Session(ViewOptions(), on_page=True)
    listening = SimpleNamespace(
        port=8080, token="secret", url="http://localhost:8080/?token=secret",
        urls=["http://localhost:8080/?token=secret"], is_private=True,
    )  # fmt: skip

    def announce(*, is_terminal: bool, has_display: bool, **options: bool) -> None:
        monkeypatch.setattr("sys.stdout.isatty", lambda: is_terminal)
        monkeypatch.setattr("sero_mj.cli.browser.has_display", lambda: has_display)
        session.options = ViewOptions(**options)
        session._is_announced = False
        session._announce("lwr", listening, "127.0.0.1")
        assert listening.url in capsys.readouterr().out

    announce(is_terminal=False, has_display=True)
    announce(is_terminal=True, has_display=False)
    announce(is_terminal=True, has_display=True, no_browser=True)
    monkeypatch.setenv("SSH_CONNECTION", "192.0.2.1 1 192.0.2.2 22")
    announce(is_terminal=True, has_display=True)
    assert opened.empty()
    monkeypatch.delenv("SSH_CONNECTION")
    announce(is_terminal=True, has_display=True)
    address = opened.get(timeout=10)
    assert address.startswith("file:")
    assert "secret" not in address  # all users see the arguments of a browser
    page = Path(urllib.request.url2pathname(urlsplit(address).path)).read_text()
    assert f"url={listening.url}" in page
