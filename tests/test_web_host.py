"""A page's host without a browser: what is sent, and what a browser's words do."""

from __future__ import annotations

import json
import socket
import struct
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import numpy as np
import pytest
from conftest import sampled
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from page_client import PageClient
from PIL import Image
from polling import until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from sero_mj import Mirror, Scene, SerialRobot, UdpReceiver, World
from sero_mj.base.errors import RenderError
from sero_mj.load import load_scene
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.host.restoring import restore, save
from sero_mj.viewer.image.scene_decor import SceneDecor
from sero_mj.viewer.player.frame import shown_bodies
from sero_mj.viewer.web import browsers
from sero_mj.viewer.web.host import WebHost
from sero_mj.viewer.web.messages import (
    MAX_BYTES,
    CameraMessage,
    CloseArea,
    Control,
    Fold,
    ForScene,
    ForStartPage,
    Got,
    HoldMessage,
    KeyMessage,
    Left,
    MessageReader,
    MessageSender,
    OpenShown,
    OpenTile,
    PageMessage,
    PageSize,
    PointerMessage,
    Received,
    TextClick,
    ViewMessage,
    Wheel,
    Widget,
)
from sero_mj.viewer.web.server import socket_url

SIZE = (1200, 800)


@pytest.fixture
def page(home: None) -> Iterator[WebHost]:
    with (
        Mirror(load_scene("impedance_push", by_hand=True)) as mirror,
        WebHost(mirror) as page,
    ):
        yield page


@pytest.fixture
def client(page: WebHost) -> Iterator[PageClient]:
    with PageClient(page) as client:
        client.say("size", w=SIZE[0], h=SIZE[1], page=SIZE[0])
        client.until(lambda: page.view.size == SIZE and client.state.get("panel"))
        yield client


def joint(page: WebHost, index: int) -> tuple[float, float]:
    """Where a joint is on the page, pixels from the upper left corner."""
    assert page.decor.view is not None
    (x, y), _ = page.decor.view.project(page.data.site_xpos[page.world.joints.centre_site[index]])
    return float(x), float(page.decor.view.height - y)


def test_copied_command_has_toggles_and_selection_also_for_a_photo_camera(
    page: WebHost, monkeypatch: pytest.MonkeyPatch
) -> None:
    page.toggles.billboards[:] = page.toggles.legend = False
    page.select(3)
    expected = ["--show", "billboards=0", "--show", "legend=0", "--select", "lwr/A3"]
    words = page.render_words()
    assert words[-6:] == expected and "--camera" in words
    monkeypatch.setattr(SceneDecor, "fixed", "the camera is that of the photo")
    words = page.render_words()
    assert words[-6:] == expected and "--camera" not in words


# ---- what is sent


def test_poses_values_and_arrows_are_those_of_the_data(page: WebHost, client: PageClient) -> None:
    client.until(lambda: page.clock.time > 0.6)
    page.clock.pause()
    page.frame()
    page.frame()
    client.until(lambda: client.state["time"] == round(page.data.time, 4))
    bodies = shown_bodies(page.world)
    count = len(bodies)
    poses = client.state["poses"]
    places = np.frombuffer(poses, "<f4", 3 * count).reshape(-1, 3)
    turns = np.frombuffer(poses, "<i2", 4 * count, 12 * count).reshape(-1, 4) / 16384
    np.testing.assert_allclose(places, page.data.xpos[bodies], atol=3e-5)
    np.testing.assert_allclose(turns, page.data.xquat[bodies], atol=4e-5)
    assert client.state["valueKeys"] == ["joint_angles"]
    angles = np.frombuffer(client.state["values"], "<f8")
    np.testing.assert_array_equal(angles[:7], page.data.qpos[:7])
    torques = page.data.userdata[page.world.slots["lwr.torques"]]
    np.testing.assert_array_equal(np.frombuffer(client.state["arrowValues"], "<f8")[:7], torques)
    assert np.abs(torques).max() > 5
    assert np.frombuffer(client.state["arrowOn"], "u1").tolist() == page.toggles.arrows.tolist()
    limits = [each["limit"] for each in client.state["arrowLook"]]
    assert limits[:7] == page.world.joints.torque_limit[:7].tolist()


def test_cards_have_the_text_of_billboards_and_their_places(
    page: WebHost, client: PageClient
) -> None:
    client.until(lambda: client.state["cards"])
    page.clock.pause()
    page.frame()
    page.frame()
    client.take()
    cards = {card["item"]: card for card in client.state["cards"] if card["kind"] == Kind.BILLBOARD}
    torques = page.data.userdata[page.world.slots["lwr.torques"]]
    for index in range(7):
        card = cards[index]
        assert card["title"] == page.world.joints.names[index]
        ((label, value),) = card["lines"]
        assert label == ""
        assert float(value.removesuffix(" Nm")) == pytest.approx(torques[index], abs=0.051)
        assert card["sign"] == ("positive" if torques[index] > 0 else "negative")
        place = page.data.site_xpos[page.world.joints.centre_site[index]]
        np.testing.assert_allclose(card["at"], place, atol=1e-4)
    client.say("card", kind=2, item=3, x=5, y=5)
    client.until(lambda: 3 not in [card["item"] for card in client.state["cards"]])
    assert not page.toggles.billboards[3]


def test_only_changes_are_sent_again(page: WebHost, client: PageClient) -> None:
    client.until(lambda: page.clock.time > 0.3)
    page.clock.pause()
    client.until(lambda: client.state["time"] == round(page.data.time, 4))
    for _ in range(6):
        page.frame()
    client.take()
    client.messages.clear()
    for _ in range(30):
        page.frame()
        client.take()
    assert sum(client.messages) < 30 * 200


@pytest.mark.parametrize(
    ("scene", "most"), sampled([["impedance_push", 1000], ["justin_push", 4000]], 1)
)
def test_state_messages_are_small(scene: str, most: int, home: None) -> None:
    """Of robots that move, with cards, as sent: compressed."""
    with Mirror(load_scene(scene)) as mirror, WebHost(mirror) as page, PageClient(page) as client:
        client.until(lambda: page.clock.time > 0.3)
        before = wire_bytes(client)
        frames = 0
        begin = len(client.messages)
        while frames < 60:
            page.frame()
            client.take()
            frames += 1
        sent = len(client.messages) - begin
        assert sent > 20
        assert (wire_bytes(client) - before) / sent < most


def wire_bytes(client: PageClient) -> int:
    """How many bytes a client has received, as the kernel counts them."""
    # tcpi_bytes_received of Linux's struct tcp_info.
    found = client.line.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 232)
    return int(struct.unpack_from("<Q", found, 128)[0])


def test_silent_source_makes_its_robot_gray(home: None) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source = UdpReceiver(name="udp", port=port, structure="7F")
    scene = Scene(
        robots=[SerialRobot.from_model("lwr", stale_after=0.2)],
        sources={"udp": source},
        routes={"lwr.joint_angles": "udp.values0"},
    )
    with (
        Mirror(scene) as mirror,
        WebHost(mirror) as page,
        PageClient(page) as client,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        of_robot = np.isin(shown_bodies(page.world), page.world.robots["lwr"].bodies)

        def grey() -> np.ndarray:
            return np.frombuffer(client.state["grey"], "u1").astype(bool)

        def is_grey() -> bool:
            return "grey" in client.state and bool(grey()[of_robot].all())

        client.until(is_grey)
        client.until(lambda: client.state["labels"])
        assert [text for text, *_ in client.state["labels"]] == ["lwr: no data yet"]

        def is_fresh() -> bool:
            sender.sendto(struct.pack("<7d", *[0.1] * 7), ("127.0.0.1", port))
            return not grey().any()

        client.until(is_fresh)
        client.until(is_grey)
        assert any("lwr: no data for" in text for text, *_ in client.state["labels"])


def test_hidden_doubles_are_not_visible(page: WebHost, client: PageClient) -> None:
    double = next(iter(page.world.doubles.values()))
    of_double = np.isin(shown_bodies(page.world), double.bodies)
    client.until(lambda: page.clock.time > 1.5)  # pushed away from where its double stands

    def opacity() -> np.ndarray:
        return np.frombuffer(client.state["opacity"], "u1")[of_double]

    assert client.until(lambda: opacity().max() > 0)
    client.say("key", key="d")
    client.until(lambda: not opacity().any())
    assert not page.toggles.doubles.any()


def test_slow_browser_gets_fewer_states_and_the_last_one(page: WebHost) -> None:
    with PageClient(page, answers=False) as slow, PageClient(page) as quick:
        for _ in range(40):
            page.frame()
            quick.take()
            slow.take()
        assert len(slow.messages) <= 3
        assert len(quick.messages) > 20
        slow.say("got")
        page.clock.pause()
        page.frame()
        slow.until(lambda: slow.state.get("time") == round(page.data.time, 4))


@pytest.mark.thorough
def test_many_browsers_look_on(page: WebHost) -> None:
    clients = [PageClient(page) for _ in range(40)]
    try:
        clients[0].until(lambda: clients[0].state["control"]["count"] == 40)
        for client in clients:
            client.until(lambda client=client: "poses" in client.state)
    finally:
        for client in clients:
            client.close()


# ---- what browsers say


def test_keys_of_the_table_act_on_the_page(page: WebHost, client: PageClient) -> None:
    for key, found in (
        ("a", lambda: page.notice.text == "arrows: off" and not page.toggles.arrows.any()),
        ("]", lambda: page.joint == 1 and page.notice.text == "selected: lwr/A2"),
        ("9", lambda: page.notice.text.startswith("no camera 9: the scene has ")),
        ("-", lambda: page.clock.speed == 0.5),
        ("t", lambda: client.state["panel"] is None),
        ("t", lambda: client.state["panel"] is not None),
        ("h", lambda: client.state["help"] is not None),
        ("escape", lambda: client.state["help"] is None),
        ("p", lambda: [area["title"] for area in client.state["areas"]] == ["Plots"]),
    ):
        client.say("key", key=key)
        client.until(found)
    assert client.until(lambda: client.state["message"]) is not None
    client.say("close", area="Plots")
    client.until(lambda: client.state["areas"] == [])


def test_click_on_a_link_shows_its_billboard_and_calls_back(
    page: WebHost, client: PageClient
) -> None:
    page.clock.pause()
    page.toggles.arrows[:] = False
    page.toggles.billboards[:] = False
    clicks: list[tuple[str, str]] = []
    page.pointer.on_click = lambda picked, gesture: clicks.append(
        (gesture, picked.name if picked else "")
    )
    client.until(lambda: not client.state["cards"])
    client.click(*joint(page, 1))
    client.until(lambda: client.state["cards"])
    assert clicks == [("click", "lwr/link2")]
    assert page.joint == 1
    assert client.until(lambda: client.state["selected"] == 1)
    client.point("move", *joint(page, 3))
    client.until(lambda: (client.state["hover"] or {}).get("text") == "lwr/link4")
    client.point("leave", 0, 0)
    client.until(lambda: client.state["hover"] is None)


def test_browser_camera_is_used_for_clicks_and_links(page: WebHost, client: PageClient) -> None:
    page.clock.pause()
    page.toggles.arrows[:] = page.toggles.billboards[:] = False
    look_at = [0.0, 0.0, 0.5]
    client.say("camera", fixed=-1, lookAt=look_at, distance=3.0, azimuth=30.0, elevation=-40.0)
    client.until(lambda: page.navigator.camera.distance == 3.0)
    assert page.view_state().camera == "30,-40,3,0,0,0.5"
    assert client.state["camera"]["by"] == client.id or client.until(
        lambda: client.state["camera"]["by"] == client.id
    )
    serial = client.state["camera"]["serial"]
    client.click(*joint(page, 3))
    client.until(lambda: page.toggles.billboards[3])
    client.say("key", key="0")  # the host moves it, and tells the browser
    client.until(lambda: client.state["camera"]["serial"] > serial)
    assert client.state["camera"]["distance"] == pytest.approx(page.navigator.camera.distance)
    assert client.state["camera"]["distance"] != 3.0


def test_link_opens_the_page_with_its_view(page: WebHost, client: PageClient) -> None:
    page.toggles.legend = not page.toggles.legend
    page.navigator.camera.azimuth = 12.3456789
    page.clock.seek(1.5)
    wanted, link = page.view_state(), page.link
    address, _, text = link.partition("#view=")
    assert address == f"http://localhost:{page.server.port}/"  # without the token
    assert wanted.time == 1.5
    page.toggles.reset()
    page.navigator.camera.azimuth = 0.0
    page.clock.seek(0.0)
    client.say("view", text=urllib.parse.unquote(text))
    client.until(lambda: page.clock.time == pytest.approx(1.5))
    assert page.view_state()._replace(time=1.5) == wanted
    assert page.clock.is_paused
    client.say("view", text="<script>")
    client.until(lambda: page.notice.is_bad)
    assert page.notice.text.startswith("view: '<script>' is not a valid view: ")


def test_panels_switch_what_is_shown_and_the_time_line_scrubs(
    page: WebHost, client: PageClient
) -> None:
    client.until(lambda: page.clock.time > 0.5)
    check = client.widget("panel", "axes")
    client.say("widget", tree="panel", id=check["id"], value=True)
    client.until(lambda: page.toggles.axes.any() and client.state["items"] != b"\0\0\0\0")
    client.say("widget", tree="timeLine", id="pause", value=True)
    client.until(lambda: page.clock.is_paused)
    client.say("widget", tree="timeLine", id="##time", value=0.2)
    client.until(lambda: page.clock.time == 0.2)
    client.until(lambda: client.state["time"] == pytest.approx(0.2, abs=1e-3))
    client.say("widget", tree="panel", id="copy link to this view", value=True)
    assert client.until(lambda: client.events)[0]["copy"].startswith(page.link.partition("%22")[0])
    client.say("fold", tree="panel", id="Sources", open=False)
    client.until(lambda: client.widget("panel", "Sources")["nodes"] == [])


def test_folded_sections_are_restored_after_a_restart(page: WebHost, client: PageClient) -> None:
    assert client.widget("panel", "lwr")["open"] and not client.widget("panel", "Model")["open"]
    client.say("fold", tree="panel", id="Model", open=True)
    client.say("fold", tree="panel", id="lwr/lwr", open=False)
    client.until(lambda: client.widget("panel", "Model")["open"])
    save(page)
    with Mirror(load_scene("impedance_push", by_hand=True)) as mirror, WebHost(mirror) as again:
        restore(again)
        with PageClient(again) as other:
            other.until(lambda: other.state.get("panel"))
            found = [other.widget("panel", name)["open"] for name in ("Model", "lwr", "Scene")]
            assert found == [True, False, True]


def test_page_has_the_requested_look(page: WebHost, home: None) -> None:
    def look_of(host: WebHost) -> str:
        with urllib.request.urlopen(host.url) as answer:
            return str(answer.read().decode()).partition('data-look="')[2].partition('"')[0]

    assert look_of(page) == ""
    scene = load_scene("lwr")
    scene.view.look = "dark"
    with Mirror(scene) as mirror, WebHost(mirror) as dark:
        assert look_of(dark) == "dark"


def test_drag_with_control_pulls_without_moving_the_camera(
    page: WebHost, client: PageClient
) -> None:
    client.until(lambda: page.clock.time > 0.1)
    camera = page.view_state().camera
    x, y = joint(page, 3)
    client.point("move", x, y)
    client.point("press", x, y, ctrl=True)
    client.point("move", x - 60, y - 40, ctrl=True)
    client.until(lambda: client.state["dragging"])
    assert page.notice.text.startswith("pulls lwr/link4 with 500 N/m")
    client.say("wheel", n=1)
    client.until(lambda: "N/m" in page.notice.text and "500 N/m" not in page.notice.text)
    client.point("release", x - 60, y - 40)
    client.until(lambda: not client.state["dragging"])
    assert page.view_state().camera == camera
    client.point("press", x, y)  # a finger, which waits
    client.say("hold")
    client.until(lambda: page.notice.text.startswith("drag to pull lwr/link"))
    client.point("move", x + 40, y)
    client.until(lambda: client.state["dragging"])
    client.point("release", x + 40, y)
    client.until(lambda: not client.state["dragging"])


def test_one_browser_has_control_and_hands_it_over(page: WebHost, client: PageClient) -> None:
    with PageClient(page) as other:
        other.until(lambda: other.state.get("control") == {"holder": client.id, "count": 2})
        refused = page.browsers.refused
        other.say("key", key="a")
        other.say("size", w=300, h=200, page=300)
        assert other.until(lambda: page.browsers.refused == refused + 1)
        assert page.toggles.arrows.any()
        assert page.view.size == SIZE
        other.say("control")
        client.until(lambda: client.state["control"]["holder"] == other.id)
        other.say("key", key="a")
        other.until(lambda: not page.toggles.arrows.any())
        page.to_clipboard("of the one in control")
        other.until(lambda: other.events)
        assert other.events == [{"copy": "of the one in control"}]
        assert client.events == []
    client.until(lambda: client.state["control"] == {"holder": client.id, "count": 1})


def test_browser_that_leaves_with_a_pressed_button_releases_it(
    page: WebHost, client: PageClient
) -> None:
    client.until(lambda: page.clock.time > 0.1)
    x, y = joint(page, 3)
    with PageClient(page) as other:
        client.point("press", x, y, ctrl=True)
        client.point("move", x - 60, y - 40, ctrl=True)
        client.until(lambda: client.state["dragging"])
        client.close()
        other.until(lambda: other.state["control"]["count"] == 1 and not other.state["dragging"])


SAID = st.fixed_dictionaries(
    {
        "t": st.sampled_from(
            ["size", "camera", "pointer", "wheel", "hold", "key", "card", "widget", "fold", "close",
             "view", "left", "x"]
        )
    },
    optional={
        key: st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
        | st.lists(st.floats(), max_size=4)
        for key in ("w", "h", "page", "fixed", "lookAt", "distance", "azimuth", "elevation", "kind",
                    "x", "y", "button", "shift", "ctrl", "n", "key", "item", "tree", "id", "value",
                    "open", "area", "text")
    },
)  # fmt: skip


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebHost]:
    folder = tmp_path_factory.mktemp("fuzzed")
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror, folder=folder) as page:
        yield page


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(said=st.lists(SAID, max_size=5))
def test_page_continues_after_any_browser_messages(fuzzed: WebHost, said: list[Any]) -> None:
    reader = MessageReader(ForScene)
    messages = [message for each in said if (message := reader.read(json.dumps(each)))]
    fuzzed._input.take(Received(message, MessageSender(1, is_local=True)) for message in messages)
    fuzzed.decor.lay_out(fuzzed.data, fuzzed.view.of_data(fuzzed.data))
    assert np.isfinite(fuzzed.navigator.camera.lookat).all()


def test_malformed_messages_are_counted(page: WebHost, client: PageClient) -> None:
    for text in ("{", "[]", "null", '{"t": 5}', '{"a": 1}', "[" * 5000):
        client.line.send(text)
    client.line.send(b"\xff\xfe")
    client.say("key")
    client.say("pointer", kind="press", x="a", y=0)
    client.say("camera", fixed=-1, lookAt=[0, 0], distance=1, azimuth=0, elevation=0)
    client.say("card", kind=1, item=10**6, x=5, y=5)  # nothing is there
    client.until(lambda: page.browsers.refused == 10 and page._input.wrong == 1)
    client.say("key", key="a")
    client.until(lambda: not page.toggles.arrows.any())


# One message of every kind that changes something.
EXAMPLES: dict[type[PageMessage], dict[str, Any]] = {
    PageSize: {"w": 640, "h": 400, "page": 640},
    CameraMessage: {
        "fixed": -1,
        "lookAt": [0, 0, 1],
        "distance": 3,
        "azimuth": 7,
        "elevation": -8.5,
    },
    PointerMessage: {"kind": "press", "x": 9, "y": 9.5, "button": 2, "shift": True, "ctrl": True},
    Wheel: {"n": 1.5},
    HoldMessage: {},
    KeyMessage: {"key": "a", "repeat": False},
    TextClick: {"kind": int(Kind.BILLBOARD), "item": 0, "x": 9, "y": 9.5, "shift": True},
    Widget: {"tree": "panel", "id": "axes", "value": True},
    Fold: {"tree": "panel", "id": "Sources", "open": False},
    CloseArea: {"area": "Plots"},
    ViewMessage: {"text": '{"switches":{"axes":"1"}}'},
}
KINDS = {kind: kind.model_fields["t"].annotation.__args__[0] for kind in EXAMPLES}  # type: ignore[union-attr]


def test_every_kind_of_message_is_declared_once_with_its_permission() -> None:
    assert set(MessageReader(ForScene).kinds) == {*EXAMPLES, Got, Control}
    assert set(MessageReader(ForStartPage).kinds) == {OpenTile, OpenShown, Got, Control}
    reader = MessageReader(ForScene)
    for kind, fields in EXAMPLES.items():
        message = {"t": KINDS[kind], **fields}
        assert type(reader.read(json.dumps(message))) is kind
        # Unknown fields, and none of those that are needed.
        assert reader.read(json.dumps({**message, "more": 1})) is None
        required = [name for name, field in kind.model_fields.items() if field.is_required()]
        for name in required:
            assert reader.read(json.dumps({k: v for k, v in message.items() if k != name})) is None


def test_only_the_browser_in_control_changes_anything(page: WebHost, client: PageClient) -> None:
    """Every kind of message: from a spectator it does nothing, from the one in control it acts."""
    acted: list[type[Any]] = []
    for kind, act in [*page._input._acts.items()]:
        page._input._acts[kind] = lambda said, act=act: (acted.append(type(said)), act(said))

    def state() -> tuple[Any, ...]:
        view, layout = page.view_state()._replace(time=None), page.layout
        return view, layout, page.view.size, page.pointer.at, page.joint, page.folds.copy()

    page.actions.perform("plot")
    client.until(lambda: client.state.get("areas"))
    before, acted[:] = state(), []
    with PageClient(page) as other:
        for number, (kind, fields) in enumerate(EXAMPLES.items()):
            other.say(KINDS[kind], **fields)
            # Every browser tells its size when it connects.
            other.until(lambda number=number: page.browsers.refused == number)  # size is first
        for _ in range(3):
            page.frame()
        assert state() == before
        assert acted == []
        other.say("control")
        other.until(lambda: acted == [Left])  # the other one holds no button any more
        assert page.browsers.holder == other.id
        acted.clear()
        for kind, fields in EXAMPLES.items():
            other.say(KINDS[kind], **fields)
        other.until(lambda: acted == [*EXAMPLES])
        assert page._input.wrong == 0
        assert page._input.sender == (other.id, True)
        assert state() != before


def test_page_sends_nothing_without_the_token(page: WebHost) -> None:
    port, token = page.server.port, page.server.token
    assert token is not None
    for query in ("", "?token=", f"?token={token[:-1]}", f"?token={token}x", f"?tok={token}"):
        for path in ("/live", "/sero-mj/files", "/sero-mj/page"):
            with pytest.raises(InvalidStatus) as refused:
                connect(f"ws://localhost:{port}{path}{query}", additional_headers={"Cookie": token})
            assert refused.value.response.status_code == 403
    assert not page.is_seen


DEEP = "[" * 5000


@pytest.mark.parametrize("text", [
    DEEP, '{"a":' * 3000, json.dumps({"switches": {"axes": DEEP}}), '{"time":NaN}',
    '{"time":1e999}', '{"time":1e300}', '{"camera":"nan,nan,nan"}',
    '{"camera":"1e308,1e308,1e308"}', '{"switches":{"axes":{"a":1}}}', '{"joint":["a"]}',
    json.dumps({"switches": {"x": "9" * 19000}}),
])  # fmt: skip
def test_no_view_in_a_link_ends_the_page(text: str, page: WebHost, client: PageClient) -> None:
    client.say("view", text=text)
    client.until(lambda: page.notice.is_bad)
    client.until(lambda: client.state["message"] is not None)
    assert np.isfinite(client.state["time"])


def test_too_long_message_ends_its_connection_only(page: WebHost, client: PageClient) -> None:
    with PageClient(page) as other:
        other.line.send(json.dumps({"t": "view", "text": "x" * MAX_BYTES}))
        client.until(lambda: client.state["control"]["count"] == 1)
        with pytest.raises(ConnectionClosed, match="1009"):
            while True:  # states that were sent before
                other.line.recv(timeout=5)


def test_browser_that_sends_too_much_is_throttled(page: WebHost, client: PageClient) -> None:
    """While the page shows no frames, messages stay in the connection, and later all arrive."""
    client.say("key", key="t")
    client.until(lambda: client.state["panel"] is None)
    refused, sent = page.browsers.refused, 3 * browsers._MAX_QUEUED
    with ThreadPoolExecutor(1) as thread:
        # An odd number of times.
        sending = thread.submit(lambda: [client.say("key", key="t") for _ in range(sent + 1)])
        assert until(lambda: len(page.browsers._queue) == browsers._MAX_QUEUED, 20)
        client.until(lambda: len(page.browsers._queue) < 10 and sending.done())
    client.until(lambda: client.state["panel"] is not None)
    assert page.browsers.refused == refused


def test_page_closes_while_a_browser_waits(home: None) -> None:
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror) as page, PageClient(page) as client:
        with ThreadPoolExecutor(1) as thread, suppress(ConnectionClosed):
            sending = thread.submit(lambda: [client.say("hold") for _ in range(10_000)])
            assert until(lambda: len(page.browsers._queue) == browsers._MAX_QUEUED, 20)
            page.close()
            sending.result(10)
        assert not page.server.is_running


def test_number_of_browsers_is_limited(
    page: WebHost, client: PageClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(browsers, "_MAX_BROWSERS", 1)
    address = socket_url(page.url, "/live")
    with connect(address) as other, pytest.raises(ConnectionClosed, match="1013"):
        other.recv(timeout=5)
    client.say("key", key="a")
    client.until(lambda: not page.toggles.arrows.any())


# ---- where it is served, and how long


def test_simulation_waits_for_the_first_browser(home: None) -> None:
    with (
        Mirror(load_scene("impedance_push")) as mirror,
        WebHost(mirror, waits=True) as page,
    ):
        for _ in range(10):
            page.frame()
        assert page.clock.time == 0.0
        with urllib.request.urlopen(page.url, timeout=5) as answer:  # somebody looks at the files
            assert answer.status == 200
        page.frame()
        assert page.clock.time == 0.0
        with PageClient(page) as client:
            client.until(lambda: page.clock.time > 0.0)


def test_page_that_no_browser_shows_only_follows_the_data(
    monkeypatch: pytest.MonkeyPatch, home: None
) -> None:
    source = UdpReceiver(name="udp", port=0, structure="7F")
    scene = Scene(
        robots=[SerialRobot.from_model("lwr")],
        sources={"udp": source},
        routes={"lwr.joint_angles": "udp.values0"},
    )
    with Mirror(scene) as mirror, WebHost(mirror) as page:
        drawn: list[int] = []
        pauses: list[float] = []
        lay_out = page.decor.lay_out

        def count(*arguments: Any) -> None:
            drawn.append(1)
            lay_out(*arguments)

        def pause(seconds: float) -> None:
            pauses.append(seconds)
            if len(pauses) == 10:
                raise InterruptedError

        monkeypatch.setattr(page.decor, "lay_out", count)
        with monkeypatch.context() as patched:
            clock = SimpleNamespace(monotonic=time.monotonic, sleep=pause)
            patched.setattr("sero_mj.viewer.web.host.time", clock)
            with pytest.raises(InterruptedError):
                page.run()
        assert len(drawn) == 1  # a browser that connects must find a state
        assert 0.05 < pauses[-1] <= 0.1
        with PageClient(page) as client:
            client.until(lambda: len(drawn) > 5)


def test_pages_of_one_process_are_beside_each_other(home: None) -> None:
    with (
        Mirror(load_scene("lwr")) as one,
        Mirror(load_scene("scara")) as two,
        WebHost(one) as first,
        WebHost(two) as second,
    ):
        assert first.url != second.url
        for page, name in ((first, "lwr"), (second, "scara")):
            with PageClient(page) as client:
                client.until(lambda client=client: "about" in client.state)
                assert client.state["about"]["title"] == name


def test_page_is_for_this_machine_only_by_default(page: WebHost) -> None:
    assert page.server.address == "127.0.0.1"
    assert page.server.is_private
    token = page.server.token
    assert token is not None and len(token) >= 32
    assert page.url == f"http://localhost:{page.server.port}/?token={token}"
    assert page.urls == [page.url]


def test_port_in_use_is_reported(home: None) -> None:
    with Mirror(load_scene("lwr")) as mirror, socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(RenderError) as found:
            WebHost(mirror, port=port)
        assert (
            str(found.value) == f"cannot serve a page at 127.0.0.1:{port}: Address already in use"
        )
        for wrong in (70000, -1, "a"):
            with pytest.raises(RenderError, match=f"port {wrong!r}: expected 1 to 65535"):
                WebHost(mirror, port=wrong)  # type: ignore[arg-type]


@pytest.mark.thorough
def test_screenshots_and_videos_can_be_made_of_pages(tmp_path: Path, home: None) -> None:
    with Mirror(load_scene("impedance_push")) as mirror, WebHost(mirror, folder=tmp_path) as page:
        said: list[str] = []
        page.say = lambda text, is_bad=False: said.append(text)  # type: ignore[method-assign]
        page.frame()
        page.actions.press("f2")
        page.actions.press("f3")
        assert said[-1].startswith("recording a video: ")
        for _ in range(6):
            page.frame()
        page.actions.press("f3")
        assert said[-1] == "video recording stopped"
        assert until(lambda: page.frame() and sum("saved: " in each for each in said) == 2)
        expected = page.picture()
    (picture,), (film,) = tmp_path.glob("*.png"), tmp_path.glob("*.mp4")
    assert f"screenshot saved: {picture}" in said
    with Image.open(picture) as image:
        shot = np.asarray(image)
    assert shot.shape == (800, 1280, 3) == expected.shape
    with av.open(str(film)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) >= 6
    difference = np.abs(frames[0].astype(int) - shot)
    assert difference.mean() < 3.0  # of one moment


def test_overlay_sends_its_joint_positions(home: None) -> None:
    import mujoco

    from sero_mj.data.drive.mirror import Watch
    from sero_mj.robots.external.model_world import ModelWorld

    model = World(load_scene("lwr")).model
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    world = ModelWorld(model, data)
    with WebHost(Watch(world)) as page, PageClient(page) as client:
        client.until(lambda: "sites" in client.state)
        n = len(world.joints.names)
        sites = client.state["sites"]
        places = np.frombuffer(sites, "<f4", 3 * n).reshape(-1, 3)
        state = world.state(page.data)
        np.testing.assert_allclose(places, state.site_xpos[world.joints.centre_site], atol=1e-6)
        quats = np.frombuffer(sites, "<f4", 4 * n, 12 * n).reshape(-1, 4)
        np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-6)
        head = json.loads(
            client.state["run"][4:][: int.from_bytes(client.state["run"][:4], "little")]
        )
        assert head["surroundings"]["floor"] is not None
