"""The page's host without a browser: messages of Studio's controls, keys, address, refusals."""

from __future__ import annotations

import copy
import socket
import struct
import urllib.parse
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import av
import mujoco
import numpy as np
import pytest
from mujoco.studio import messages, sim_history, ux
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.web import state_payload, web_server
from PIL import Image
from polling import until
from websockets.sync.client import connect

from sero_mj import Mirror, Scene, SerialRobot, UdpReceiver
from sero_mj.base.errors import RenderError
from sero_mj.load import load_scene
from sero_mj.viewer.panels.imgui_widgets import MOODS
from sero_mj.viewer.web.host import WebHost

# Studio's server ends without closing the connection of its user interface.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.usefixtures("home"),
]


@pytest.fixture
def page() -> Iterator[WebHost]:
    with Mirror(load_scene("impedance_push")) as mirror, WebHost(mirror) as page:
        yield page


def test_studios_messages_pause_scrub_step_and_reset_a_simulation(page: WebHost) -> None:
    """What Studio's controls send, without a browser to click on them."""
    while page.clock.time < 0.4:
        assert page.frame()
    page.viewer.send_to_sim(sim_history.SimHistorySnapshot(index=-10))
    page.frame()
    page.frame()
    assert page.clock.is_paused
    assert 0 < page.clock.time < 0.4
    assert page.data.time == pytest.approx(page.clock.time)
    assert page.viewer.data.time == pytest.approx(page.clock.time)
    before = page.clock.time
    page.viewer.send_to_sim(messages.SingleStepEvent())
    page.frame()
    assert page.clock.time == pytest.approx(before + page.clock.step_size)
    page.viewer.send_to_sim(messages.ResetEvent())
    page.frame()
    assert page.clock.time == 0.0
    np.testing.assert_allclose(page.data.qpos, page.world.make_data().qpos, atol=1e-9)


def test_a_live_robot_is_scrubbed_too_and_then_shown_as_it_is() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    source = UdpReceiver(name="udp", port=port, structure="7F")
    scene = Scene(
        robots=[SerialRobot.from_model("lwr")],
        sources={"udp": source},
        routes={"lwr.joint_angles": "udp.values0"},
    )
    with (
        Mirror(scene) as mirror,
        WebHost(mirror) as page,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver = mirror.sources["udp"]
        for step in range(40):
            sender.sendto(struct.pack("<7d", *[0.02 * step] * 7), ("127.0.0.1", port))
            assert until(lambda wanted=step + 1: receiver.counters.received == wanted)
            page.frame()
        assert page.data.qpos[0] == pytest.approx(0.78)
        page.viewer.send_to_sim(sim_history.SimHistorySnapshot(index=-20))
        page.frame()
        page.frame()
        assert page.clock.is_paused
        assert 0.1 < page.data.qpos[0] < 0.7
        page.actions.press("end")
        page.frame()
        assert page.data.qpos[0] == pytest.approx(0.78)  # the latest packet, sent long ago


def test_keys_of_the_table_act_on_the_page(page: WebHost) -> None:
    page.actions.press("a")
    assert not page.toggles.arrows.any()
    assert page.notice.text == "arrows: off"
    page.actions.press("]")
    assert page.joint == 1
    assert page.notice.text == "selected: lwr/A2"
    page.actions.press("9")
    assert page.notice.text.startswith("no camera 9: the scene has ")
    page.actions.press("f")
    assert page.notice.text == "follows nothing"
    page.actions.press("-")
    assert page.clock.speed == 0.5
    page.actions.press("f11")  # a browser's own


def test_a_page_says_where_it_is_and_keeps_its_port(page: WebHost) -> None:
    assert page.url == f"http://localhost:{page.port}/"
    assert page.is_private
    with socket.create_connection(("127.0.0.1", page.port), 5):
        pass


def test_a_page_is_for_this_machine_only(page: WebHost) -> None:
    for listening in (page.viewer.listening, page.viewer._tcp_sock):
        assert listening.getsockname()[0] == "127.0.0.1"


def test_a_simulation_waits_for_the_first_browser() -> None:
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
        with connect(f"ws://127.0.0.1:{page.port}/state?sid=test", max_size=None) as browser:
            while not isinstance(browser.recv(timeout=5), bytes):
                pass
            page.frame()
            page.frame()
            assert page.clock.time > 0.0


def test_one_page_at_a_time_and_another_after_it() -> None:
    with Mirror(load_scene("lwr")) as mirror:
        for _ in range(3):
            with WebHost(mirror) as page:
                for _ in range(5):
                    assert page.frame()
                with pytest.raises(RenderError, match="no second page: Studio serves one"):
                    WebHost(mirror)


def test_pages_that_start_at_once_get_ports_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    bind = web_server.bind_public_socket
    rivals = []

    def bind_with_rival(host: str, port: int = 0) -> socket.socket:
        bound = bind(host, port)
        if not rivals:  # both may bind the port, and one can listen
            rivals.append(socket.socket())
            rivals[0].setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            rivals[0].bind(bound.getsockname())
            rivals[0].listen()
        return bound

    monkeypatch.setattr(web_server, "bind_public_socket", bind_with_rival)
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror) as page:
        assert page.port != rivals[0].getsockname()[1]
        socket.create_connection(("localhost", page.port), 5).close()
    rivals[0].close()


def test_a_port_that_is_taken_is_told() -> None:
    with Mirror(load_scene("lwr")) as mirror, socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        expected = f"no page at 127.0.0.1:{port}: Port {port} is already in use"
        with pytest.raises(RenderError, match=expected) as found:
            WebHost(mirror, port=port)
        assert "or 0" not in str(found.value)
        for wrong in (70000, -1, "a"):
            with pytest.raises(RenderError, match=f"port {wrong!r}: expected a number from 1"):
                WebHost(mirror, port=wrong)  # type: ignore[arg-type]


def test_what_a_browser_has_no_room_for_is_said(caplog: pytest.LogCaptureFixture) -> None:
    fields = {"show_arrows": True, "show_billboards": True, "show_axes": True}
    robots = [
        SerialRobot.from_model("lwr", name=f"r{i}", torques=[50.0] * 7, **fields) for i in range(24)
    ]
    with Mirror(Scene(robots=robots)) as mirror, WebHost(mirror) as page:
        while page.decor.view is None:
            page.frame()
        assert 0 < page.decor.count <= 1024
        assert len(page.viewer.extra_geoms) == page.decor.count
        assert page.decor.dropped > 0
        for _ in range(5):
            page.frame()
    said = [record.getMessage() for record in caplog.records if "not shown" in record.getMessage()]
    assert len(said) == 1
    assert said[0].endswith("decor geoms are not shown: the scene's capacity is 1024")


def test_doubles_that_are_off_are_out_of_sight_in_browsers_only(page: WebHost) -> None:
    double = next(iter(page.world.doubles.values()))
    page.clock.seek(1.5)  # pushed away from where its double stands
    while page.data.time < 1.5:
        page.frame()
    page.toggles.doubles[:] = False
    page.decor._hide_doubles(page.viewer.data)
    assert (page.viewer.data.mocap_pos[double.mocap, 2] < -50).all()
    assert (page.data.mocap_pos[double.mocap, 2] > -1).any()


def test_a_browser_that_takes_control_does_not_change_the_theme(page: WebHost) -> None:
    before = page._app.theme
    for theme in ("dark", "light", "classic"):
        page.viewer.server.set_theme(theme)
        page.frame()
        page.viewer.dispatch(messages.UpdateEvent())
        assert page._app.theme == before


def test_studios_inspector_moves_no_mirrored_robot(page: WebHost) -> None:
    page.clock.pause()
    page.frame()
    before = page.data.qpos.copy()
    shown = page.viewer.data
    with page.viewer.send_if_changes(
        lambda: messages.StateEvent.from_data(
            page.world.model, shown, int(mujoco.mjtState.mjSTATE_QPOS)
        )
    ):
        shown.qpos += 0.5
    for _ in range(3):
        page.frame()
    assert page.data.qpos.tolist() == before.tolist()
    assert shown.qpos.tolist() == before.tolist()


def luminance(rgb: Sequence[float]) -> float:
    """Relative luminance of an sRGB colour by WCAG 2."""
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgb]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


@pytest.mark.parametrize("theme", ux.GuiTheme.__members__.values())
def test_text_of_every_mood_is_readable_on_every_theme(page: WebHost, theme: ux.GuiTheme) -> None:
    ux.setup_theme(theme)
    ground = imgui.GetStyleColorVec4(int(imgui.Col.WindowBg))
    behind = luminance((ground.x, ground.y, ground.z))
    for mood, rgbs in MOODS.items():
        rgb = rgbs[ground.y < 0.5]
        low, high = sorted((behind, luminance(rgb)))
        assert (high + 0.05) / (low + 0.05) >= 4.5, mood


@pytest.mark.parametrize("is_over_window", [True, False])
def test_a_drag_of_a_window_does_not_turn_the_view(
    page: WebHost, monkeypatch: pytest.MonkeyPatch, is_over_window: bool
) -> None:
    page.frame()
    viewer = page.viewer
    before = viewer.camera.azimuth
    sent = copy.copy(viewer.camera)
    sent.azimuth = before + 40.0
    generation = viewer._client_camera.generation
    message = state_payload.serialize_client_camera(sent, generation)
    monkeypatch.setattr(viewer.server, "take_client_camera", lambda: message)
    monkeypatch.setattr(imgui, "GetIO", lambda: SimpleNamespace(WantCaptureMouse=is_over_window))
    monkeypatch.setattr(imgui, "IsMouseDown", lambda button: button == 0)
    viewer.prepare_next_frame()
    assert viewer.camera.azimuth == (before if is_over_window else before + 40.0)


@pytest.mark.thorough
def test_screenshots_and_films_are_made_of_pages_too(tmp_path: Path) -> None:
    with Mirror(load_scene("impedance_push")) as mirror, WebHost(mirror, folder=tmp_path) as page:
        said: list[str] = []
        page.say = lambda text, is_bad=False: said.append(text)  # type: ignore[method-assign]
        page.frame()
        page.actions.press("f2")
        page.actions.press("f3")
        assert said[-1].startswith("filming to ")
        for _ in range(6):
            page.frame()
        page.actions.press("f3")
        assert said[-1] == "the film is complete"
        assert until(lambda: page.frame() and sum("saved: " in each for each in said) == 2)
        expected = page.picture()
    (picture,), (film,) = tmp_path.glob("*.png"), tmp_path.glob("*.mp4")
    assert f"screenshot saved: {picture}" in said
    assert Image.open(picture).size == (1280, 800) == expected.shape[1::-1]
    with av.open(str(film)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) >= 6
    difference = np.abs(frames[0].astype(int) - np.asarray(Image.open(picture)))
    assert difference.mean() < 3.0  # of one moment


def test_a_link_opens_the_page_with_its_view(page: WebHost) -> None:
    page.frame()
    page.toggles.legend = not page.toggles.legend
    page.viewer.camera.azimuth = 12.3456789
    page.clock.seek(1.5)
    wanted, link = page.view_state(), page.link
    address, _, text = link.partition("#view=")
    assert address == page.url and wanted.time == 1.5
    page.toggles.reset()
    page.viewer.camera.azimuth = 0.0
    page.clock.seek(0.0)
    browsers = page.viewer.server.browsers
    assert browsers.hear(object(), f"sero-mj view {urllib.parse.unquote(text)}")
    page.frame()
    assert page.view_state()._replace(time=1.5) == wanted
    assert page.clock.time == pytest.approx(1.5) and page.clock.is_paused
    assert browsers.hear(object(), "sero-mj view <script>")
    page.frame()
    assert page.notice.is_bad
    assert page.notice.text.startswith("found no state of a view in '<script>': ")
