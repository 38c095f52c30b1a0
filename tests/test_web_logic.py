"""The page without a browser: what Studio's controls do, what is drawn and where it is served."""

from __future__ import annotations

import logging
import re
import socket
from typing import Any

import mujoco
import numpy as np
import pytest
from mujoco.studio.web import state_payload
from sero_mj.viewer.web.studio import (
    _DISCONNECT_FILTER,
    ChangesOnlyServer,
    ThrottledUi,
    read_page,
    with_head,
)
from websockets.exceptions import ConnectionClosedError

from sero_mj.base.errors import DeclarationError, RenderError, UsageError
from sero_mj.cli import main
from sero_mj.cli.view import ViewOptions, wants_page
from sero_mj.viewer.decor.font import DEFAULT_FONT, Font
from sero_mj.viewer.decor.geom_buffer import MAX_GEOMS
from sero_mj.viewer.decor.panels import labels_at
from sero_mj.viewer.decor.picture_view import PictureView
from sero_mj.viewer.mujoco_private import page_files
from sero_mj.viewer.session.interaction import HOST_KEYS, KEYS, MORE_KEYS, OF_BROWSER, help_columns
from sero_mj.viewer.session.tool import tool_keys
from sero_mj.viewer.web import studio_controls
from sero_mj.viewer.web.guard import Guard
from sero_mj.viewer.web.host import check_address, page_url


def test_the_page_takes_every_geom_of_the_budget() -> None:
    assert state_payload.MAX_EXTRA_GEOMS >= MAX_GEOMS


def test_every_state_says_where_the_head_reads_it_whether_the_pointer_is_over_the_scene() -> None:
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    scene = mujoco.MjvScene(model, maxgeom=9)
    parts = (mujoco.MjvCamera(), mujoco.MjvPerturb(), mujoco.MjvOption(), model, [0] * 10)
    found = re.search(r"MOUSE_FOCUS = (\d+);", read_page("title").decode())
    assert found is not None
    for geoms in ([], list(scene.geoms)):
        over, beside = (
            state_payload.serialize_state_payload(
                1, 1, bytes(80), *parts, geoms, state_payload.ViewerInputState(mouse_focus=focus)
            )
            for focus in (True, False)
        )
        differs = [len(over) - i for i in range(len(over)) if over[i] != beside[i]]
        assert differs == [int(found[1])]


def test_every_key_of_the_table_is_one_of_the_page() -> None:
    ours = {*KEYS, *HOST_KEYS, *MORE_KEYS} - set(OF_BROWSER) - {"+", "_"}  # with Shift
    ours = {key for key in ours if not key.startswith("ctrl+")}
    assert ours <= set(studio_controls.IMGUI_KEYS)


def test_the_help_of_the_page_is_about_the_page() -> None:
    rows = [row for column in help_columns(tool_keys(), on_page=True) for row in column]
    assert ("t", "panel on or off") in rows
    assert not {how for how, _ in rows} & {"F11", "Ctrl+Q"}
    assert {"F11", "Ctrl+Q"} <= {how for column in help_columns(tool_keys()) for how, _ in column}


def test_lines_are_as_wide_as_their_characters() -> None:
    lines = [b"A1 -12.3 Nm", b"", b"i"]
    assert DEFAULT_FONT.line_widths(lines).tolist() == [DEFAULT_FONT.width(line) for line in lines]


def picture_view(**options: Any) -> PictureView:
    return PictureView(
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
    view = picture_view(inset=(300.0, 50.0, 100.0, 20.0))
    wanted = np.array([[0.0, 0.0], [790.0, 599.0], [400.0, 300.0]])
    centres, sizes = labels_at(view, wanted, [[b"one"], [b"two"], [b"three"]])
    low, high = centres - sizes / 2, centres + sizes / 2
    assert (low >= [300.0, 50.0]).all()
    assert (high <= [700.0, 580.0]).all()
    assert centres[2].tolist() == [400.0, 300.0]


def test_labels_stand_where_the_host_takes_them_from() -> None:
    """A host that centres labels below their position shows the same lines."""
    from sero_mj.viewer.decor.geom_buffer import GeomBuffer
    from sero_mj.viewer.decor.panels import Panels, draw_panels

    def places(anchor: tuple[float, float]) -> tuple[np.ndarray, PictureView]:
        font = Font(DEFAULT_FONT.height, DEFAULT_FONT.widths, anchor)
        view, buffer = picture_view(font=font), GeomBuffer(20)
        panels = Panels(np.array([[400.0, 300.0]]), np.array([[200.0, 80.0]]), [[b"ab", b"cde"]])
        draw_panels(buffer, view, [panels])
        rows = buffer.rows[: buffer.count]
        labels = rows[rows["type"] == mujoco.mjtGeom.mjGEOM_LABEL]
        return view.project(labels["pos"].astype(float))[0], view

    left, _ = places((0.0, 0.0))
    middle, _ = places((0.5, 1.0))
    widths = DEFAULT_FONT.line_widths([b"ab", b"cde"])
    np.testing.assert_allclose(middle - left, np.stack([widths / 2, [28.0, 28.0]], 1), atol=0.05)


def test_studios_page_gets_a_title_and_fingers_that_click_once() -> None:
    page = "<html>\n  <head>\n    <title>Studio</title>\n  </head>\n  <body></body></html>"
    ours = with_head(page, "a <b> - sero-mj")
    assert "<title>a &lt;b&gt; - sero-mj</title>" in ours
    assert ours.count("turnWheel(") == 3
    assert ours.index("turnWheel(") < ours.index("</head>") < ours.index("<body>")
    assert with_head("<html></html>", "title") == "<html></html>"  # another Studio's


def test_the_page_has_its_title_and_studios_files() -> None:
    assert b"<title>lwr - sero-mj</title>" in read_page("lwr - sero-mj")
    assert (page_files() / "web_client.wasm").is_file()


def test_a_state_is_sent_once(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [10.0]
    monkeypatch.setattr("sero_mj.viewer.web.studio.time.monotonic", lambda: now[0])
    with socket.socket() as one, socket.socket() as two:
        guard = Guard(b"", "127.0.0.1", "localhost", None)
        server = ChangesOnlyServer(guard, http_sock=one, tcp_sock=two)
        for payload, after in ((b"a", 0.0), (b"a", 0.1), (b"b", 0.1), (b"b", 0.1), (b"b", 0.6)):
            now[0] += after
            server.update_state(payload)
    assert (server.sent, server.sent_bytes) == (3, 3)


class FakeUi:
    """Counts the frames of a user interface."""

    def __init__(self, *, is_ready: bool) -> None:
        self.begun = self.ended = 0
        self.is_ready = is_ready

    def new_frame(self) -> bool:
        self.begun += 1
        return self.is_ready

    def end_frame(self) -> None:
        self.ended += 1


@pytest.mark.parametrize("is_ready", [True, False])
def test_the_user_interface_has_half_the_frames(
    monkeypatch: pytest.MonkeyPatch, is_ready: bool
) -> None:
    now = [5.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr("sero_mj.viewer.web.studio.time.monotonic", lambda: now[0])
    monkeypatch.setattr("sero_mj.viewer.web.studio.time.sleep", sleep)
    ui = FakeUi(is_ready=is_ready)
    calm = ThrottledUi(ui)
    begin = now[0]
    for _ in range(120):
        assert calm.new_frame()
        assert calm.is_due <= is_ready
        now[0] += 0.004  # work
        calm.end_frame()
    assert now[0] - begin == pytest.approx(2.0, abs=0.05)
    assert ui.begun == pytest.approx(60, abs=2)
    assert ui.ended == (ui.begun if is_ready else 0)


def test_pages_are_named_by_addresses_that_a_browser_takes() -> None:
    assert page_url("127.0.0.1", 8080) == "http://localhost:8080/"
    assert page_url("0.0.0.0", 80) == "http://localhost:80/"
    assert page_url("192.168.1.7", 8080) == "http://192.168.1.7:8080/"
    assert page_url("fe80::1", 8080) == "http://[fe80::1]:8080/"
    assert page_url("::", 8080, "secret") == "http://localhost:8080/?token=secret"


@pytest.mark.parametrize("host", ["203.0.113.7", "no such host", "x" * 300])
def test_an_address_of_others_is_refused(host: str) -> None:
    with pytest.raises(RenderError, match="this machine has no such address"):
        check_address(host)
    check_address("127.0.0.1")
    check_address("localhost")


def test_there_is_a_page_where_there_is_no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sero_mj.viewer.headless.backend.has_display", lambda: True)
    assert not wants_page(ViewOptions(scene="lwr"))
    assert wants_page(ViewOptions(scene="lwr", web=True))
    assert wants_page(ViewOptions(scene="lwr", port=8081))
    assert wants_page(ViewOptions(scene="lwr", host="0.0.0.0"))
    monkeypatch.setattr("sero_mj.viewer.headless.backend.has_display", lambda: False)
    assert wants_page(ViewOptions(scene="lwr"))


def test_it_says_why_it_is_a_page_once_there_is_a_scene(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sero_mj.viewer.headless.backend.has_display", lambda: False)
    monkeypatch.setattr("sero_mj.cli.view.Session.show", lambda session, scene: None)
    for scene, said in (("lwr", True), ("lrw", False)):
        with pytest.raises(SystemExit):
            main(["view", scene])
        err = capsys.readouterr().err
        assert ("no display for a window, so it is a page" in err) == said, scene


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"window": True, "port": 8080}, "--port is for the page"),
        ({"window": True, "host": "0.0.0.0"}, "--host is for the page"),
        ({"window": True, "token": True}, "--token is for the page"),
        ({"web": True, "size": (640, 480)}, "--size is for the window"),
        ({"port": 8080, "full_screen": True}, "--full-screen is for the window"),
        ({"window": True}, "no display for a window"),
        ({"size": (640, 480)}, "no display for a window"),
    ],
)
def test_options_of_the_other_host_are_refused(
    monkeypatch: pytest.MonkeyPatch, given: dict[str, Any], expected: str
) -> None:
    monkeypatch.setattr("sero_mj.viewer.headless.backend.has_display", lambda: False)
    with pytest.raises((UsageError, DeclarationError), match=expected):
        wants_page(ViewOptions(scene="lwr", **given))


def test_a_browser_that_is_there_when_the_page_ends_is_no_error() -> None:
    log = logging.getLogger("asyncio")
    log.addFilter(_DISCONNECT_FILTER)
    try:
        for error, is_told in ((ConnectionClosedError(None, None), False), (OSError("no"), True)):
            record = log.makeRecord("asyncio", 40, "", 1, "x", (), (type(error), error, None))
            assert bool(log.filter(record)) == is_told
    finally:
        log.removeFilter(_DISCONNECT_FILTER)
