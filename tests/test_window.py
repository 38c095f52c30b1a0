"""A real window, worked with mouse and keys: what they change."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from PIL import Image
from window_tools import MISSING, SIZE, Driven, screen

from sero_mj.data.record.recording_writer import RecordingWriter
from sero_mj.simulate.runs.run_recording import read_run

pytestmark = [
    pytest.mark.gl,
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]

# Where the LWR's joints are in the window, from the upper left corner.
_JOINTS = (
    "[w.decor.view.project(w.data.site_xpos[w.world.joints.centre_site])[0][{0}].tolist(), "
    "w.decor.rect.bottom]"
)


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    with screen() as name:
        yield name


@pytest.fixture(scope="module")
def lwr_window(display: str, tmp_path_factory: Any) -> Iterator[Driven]:
    folder = tmp_path_factory.mktemp("window")
    settings = ("lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0", "lwr.torques=20,60,-30,40,-9,5,3")
    with Driven(display, folder, "lwr", settings=settings) as window:
        window.folder = folder  # type: ignore[attr-defined]
        yield window


@pytest.fixture
def window(lwr_window: Driven) -> Driven:
    """The window as it was when it was opened."""
    lwr_window.tool("mousemove", 5, 5)
    lwr_window.ask("w.toggles.reset()")
    lwr_window.ask("w.navigator.choose(0)[:0]")
    lwr_window.settle()
    return lwr_window


def make_recording(path: Path, seconds: float) -> None:
    """Records what `lwr_udp` expects: the first joint turns by 0.1 rad/s, at 100 packets/s."""
    writer = RecordingWriter(path, about={"scene": "lwr_udp"}, overwrite=True)
    declared = {"port": 32000, "structure": "7F7F", "double": True}
    events = {"values0": (7,), "values1": (7,)}
    writer.add_source("udp", kind="udp", declared=declared, events=events, size=112)
    start = writer.clock.monotonic_ns / 1e9
    for k in range(round(seconds * 100) + 1):
        values = np.zeros(14)
        values[0], values[8] = 0.1 * k / 100, 20.0
        writer.write_raw("udp", values.tobytes(), start + k / 100)
    writer.close()


def pixel(window: Driven, joint: int) -> tuple[float, float]:
    (x, y), bottom = window.ask(_JOINTS.format(joint))
    return x, SIZE[1] - bottom - y


@pytest.mark.thorough
def test_key_switches_its_toggle(window: Driven) -> None:
    assert not window.ask("w.toggles.arrows.any()")
    window.key("a")
    window.until("w.toggles.arrows.all()")
    window.key("a")
    window.until("not w.toggles.arrows.any()")


def test_click_on_a_link_shows_its_billboard_and_selects_its_joint(window: Driven) -> None:
    x, y = pixel(window, 3)
    window.click(x, y)
    shown = window.until("w.toggles.billboards.nonzero()[0].tolist()")
    assert shown == [window.ask("w.joint")]


def test_shift_and_click_shows_all_billboards(window: Driven) -> None:
    x, y = pixel(window, 3)
    window.tool("mousemove", round(x), round(y), "keydown", "shift", "click", 1, "keyup", "shift")
    window.until("w.toggles.billboards.all()")


def test_double_click_shows_the_axes_and_no_billboard(window: Driven) -> None:
    x, y = pixel(window, 3)
    window.click(x, y, "click", "--repeat", 2, "--delay", 60, 1)
    window.until("w.toggles.axes.sum() > 3")
    assert not window.ask("w.toggles.billboards.any()")


def test_name_under_the_pointer_is_shown_beside_it(window: Driven) -> None:
    x, y = pixel(window, 3)
    window.tool("mousemove", round(x), round(y))
    assert window.until("w.toggles.hover")[0].startswith("lwr/")
    window.tool("mousemove", 4, 4)
    window.until("w.toggles.hover is None")


def test_drag_rotates_the_view_and_is_not_a_click(window: Driven) -> None:
    before = window.ask("[w.navigator.camera.azimuth, w.navigator.camera.elevation]")
    x, y = pixel(window, 3)
    window.tool("mousemove", round(x), round(y), "mousedown", 1)
    window.tool("mousemove", round(x) + 60, round(y), "mousemove", round(x) + 120, round(y) + 40)
    window.tool("mouseup", 1)
    window.settle()
    after = window.ask("[w.navigator.camera.azimuth, w.navigator.camera.elevation]")
    turned = (before[0] - after[0] + 180) % 360 - 180
    assert turned == pytest.approx(180 * 120 / SIZE[1], abs=1)
    assert before[1] - after[1] == pytest.approx(180 * 40 / SIZE[1], abs=1)
    assert not window.ask("w.toggles.billboards.any()")


def test_drag_with_the_right_button_pans_the_view(window: Driven) -> None:
    before = pixel(window, 1)
    window.tool("mousemove", 300, 200, "mousedown", 3, "mousemove", 330, 200)
    window.tool("mousemove", 360, 230, "mouseup", 3)
    window.settle()
    after = pixel(window, 1)
    assert after[0] - before[0] == pytest.approx(60, abs=6)
    assert after[1] - before[1] == pytest.approx(30, abs=6)


def test_wheel_zooms_in(window: Driven) -> None:
    before = window.ask("w.navigator.camera.distance")
    window.tool("mousemove", 300, 200, "click", 4, "click", 4)
    window.until(f"abs(w.navigator.camera.distance - {before} * 0.81) < 1e-6")


def test_double_click_of_the_right_button_centers_the_view(window: Driven) -> None:
    x, y = pixel(window, 5)
    window.click(x, y, "click", "--repeat", 2, "--delay", 60, 3)
    window.settle()
    seen = window.ask("w.decor.view.project(np.array(w.navigator.camera.lookat))[0].tolist()")
    picture = window.ask("[w.decor.rect.width, w.decor.rect.height]")
    assert seen == pytest.approx([picture[0] / 2, picture[1] / 2], abs=1)
    assert pixel(window, 5) == pytest.approx((320, picture[1] / 2), abs=40)


@pytest.mark.thorough
def test_camera_follows_a_frame(window: Driven) -> None:
    x, y = pixel(window, 5)
    window.tool("mousemove", round(x), round(y))
    window.until("w.toggles.hover")
    window.key("f")
    followed = window.until("w.navigator.following")
    before = np.array(window.ask("w.navigator.camera.lookat"))
    there = np.array(window.ask(f"w.world.frame(w.data, {followed!r})[:3, 3]"))
    window.ask("w.data.qpos.__setitem__(0, 0.9)")
    window.settle()
    moved = np.array(window.ask(f"w.world.frame(w.data, {followed!r})[:3, 3]")) - there
    assert np.linalg.norm(moved) > 0.05
    goal = (before + moved).tolist()  # it is late, and arrives
    window.until(f"np.abs(w.navigator.camera.lookat - {goal}).max() < 1e-3")
    window.ask("w.data.qpos.__setitem__(0, 0.0)")


@pytest.mark.thorough
def test_help_is_shown_and_closed_by_a_click(window: Driven) -> None:
    window.key("F1")
    window.until("w.shows_help")
    window.click(320, 240)
    window.until("not w.shows_help")
    window.tool("type", "?")
    window.until("w.shows_help")
    window.tool("mousemove", 320, 240, "click", 5)  # the wheel scrolls it
    window.settle()
    assert window.ask("w.shows_help")
    window.key("F1")
    window.until("not w.shows_help")
    window.key("h")
    window.until("w.shows_help")
    window.key("Escape")
    window.until("not w.shows_help")


def test_screenshot_equals_the_visible_image(window: Driven) -> None:
    folder: Path = window.folder  # type: ignore[attr-defined]
    window.key("F2")
    window.until("'screenshot saved' in w.notice.text")
    (picture,) = folder.glob("lwr_*.png")
    pixels = np.asarray(Image.open(picture))
    assert pixels.shape == (*window.ask("[w.decor.rect.width, w.decor.rect.height]")[::-1], 3)
    assert pixels.std() > 10
    assert pixels[:40].mean() > pixels[-200:].mean()  # the sky is up


@pytest.mark.thorough
def test_video_has_the_recorded_duration(window: Driven) -> None:
    import av

    folder: Path = window.folder  # type: ignore[attr-defined]
    window.key("F3")
    window.until("w.tools['images'].writer.seconds > 1.0")
    window.key("F3")
    window.until("'video of' in w.notice.text and 'saved' in w.notice.text")
    (film,) = folder.glob("lwr_*.mp4")
    with av.open(str(film)) as container:
        frames = sum(1 for _ in container.decode(video=0))
    assert frames / 30 == pytest.approx(window.ask("w.tools['images'].writer.seconds"), abs=0.3)


@pytest.mark.thorough
def test_window_can_be_resized(window: Driven) -> None:
    window.tool("search", "--name", "lwr - sero-mj", "windowsize", 500, 400)
    window.until("w.gl.size == (500, 400)")
    window.settle()
    assert window.ask("w.decor.rect.width") == 500
    window.tool("search", "--name", "lwr - sero-mj", "windowsize", *SIZE)
    window.until(f"w.gl.size == {SIZE}")


def test_full_screen_and_back(window: Driven) -> None:
    window.key("F11")
    window.until("w.gl.size == (1000, 700)")
    window.key("Escape")
    window.until(f"w.gl.size == {SIZE}")


def test_plot_shows_the_selected_joint(window: Driven) -> None:
    window.key("p")
    window.until("w.tools['plot'].shows_area")
    window.until("places.get('##joint')")
    joint = window.ask("w.joint")
    window.key("bracketright")
    window.until(f"w.joint == ({joint} + 1) % 7")
    window.key("p")


def test_simulation_is_paused_stepped_scrubbed_and_reset(display: str, tmp_path: Path) -> None:
    with Driven(display, tmp_path, "impedance_push") as window:
        window.until("w.clock.time > 0.2")
        window.key("space")
        window.until("w.clock.is_paused")
        time = window.ask("w.clock.time")
        window.settle()
        assert window.ask("w.clock.time") == time
        window.key("period")
        window.until("w.clock.time == " + repr(time + window.ask("w.clock.step_size")))
        window.key("plus")
        window.until("w.clock.speed == 2.0")
        window.click(*window.on_time_line(0.5))
        assert window.ask("w.clock.time") == pytest.approx(window.ask("w.clock.end / 2"), abs=0.02)
        # It is simulated until there in pieces, and the window lives on meanwhile.
        window.until("abs(w.data.time - w.clock.time) < 1e-9")
        window.key("BackSpace")
        window.until("w.clock.time == 0 and w.data.time == 0")
        assert not window.ask("clicks")  # the time line is not the picture


@pytest.mark.thorough
def test_recording_is_scrubbed_and_stops_at_its_end(display: str, tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    make_recording(recording, seconds=2.0)
    with Driven(display, tmp_path, "lwr_udp", replay=str(recording)) as window:
        window.until("w.clock.time > 0.1")
        assert window.ask("w.clock.end") == pytest.approx(2.0, abs=0.02)
        at = window.on_time_line(0.25)
        window.tool("mousemove", *at, "mousedown", 1, "key", "space")
        window.tool("mousemove", *window.on_time_line(0.5))
        window.tool("mousemove", *at, "mouseup", 1)
        window.until("abs(w.clock.time - 0.5) < 0.02")
        time = window.ask("w.clock.time")
        # The first joint goes as fast as the recording says: 0.1 rad/s.
        assert window.ask("w.data.qpos[0]") == pytest.approx(0.1 * time, abs=1e-3)
        window.key("space")
        window.until("w.clock.is_at_end")
        assert window.ask("w.data.qpos[0]") == pytest.approx(0.2, abs=1e-3)


@pytest.mark.thorough
def test_window_survives_the_end_of_a_live_source(display: str, tmp_path: Path) -> None:
    sender = subprocess.Popen(
        [sys.executable, "-m", "sero_mj", "send", "lwr_udp", "--port", "32755", "--rate", "200"],
        stdout=subprocess.DEVNULL,
        cwd=ROOT,
    )
    try:
        scene = tmp_path / "live.toml"
        text = (ROOT / "scenes" / "lwr_udp.toml").read_text().replace("32000", "32755")
        scene.write_text(text)
        with Driven(display, tmp_path, str(scene)) as window:
            window.until("next(iter(w.mirror.sources.values())).receiving")
            before = window.ask("w.data.qpos.tolist()")
            window.until(f"w.data.qpos.tolist() != {before}")
            sender.terminate()
            sender.wait()
            window.until("not next(iter(w.mirror.sources.values())).receiving")
            window.key("a")
            assert window.ask("w.clock.is_live")
            window.until("w.decor.buffer.grey is not None")  # shown as stale
    finally:
        sender.kill()
        sender.wait()


@pytest.mark.thorough
def test_past_of_a_live_source_is_replayed_with_the_timeline(display: str, tmp_path: Path) -> None:
    scene = tmp_path / "live.toml"
    text = (ROOT / "scenes" / "lwr_udp.toml").read_text().replace("32000", "32756")
    scene.write_text(text)
    sender = subprocess.Popen(
        [sys.executable, "-m", "sero_mj", "send", "lwr_udp", "--port", "32756", "--rate", "200"],
        stdout=subprocess.DEVNULL,
        cwd=ROOT,
    )
    try:
        with Driven(display, tmp_path, str(scene)) as window:
            window.until("w.clock.end and w.clock.end - w.clock.begin > 2.5")
            window.key("m")
            window.click(*window.on_time_line(0.3))
            window.key("space")
            assert window.ask("[w.clock.is_past, w.clock.is_paused]") == [True, True]
            ago = window.ask("w.clock.end - w.clock.time")
            assert ago > 1.5
            assert window.ask("abs(w.data.time - w.clock.time)") < 0.3  # frames are slow here
            window.until(f"w.clock.end > {window.ask('w.clock.end') + 0.5}")  # it goes on
            window.key("e")
            window.until("w.clock.time in [each.time for each in w.tools['bookmarks'].all()]")
            assert window.ask("any(bookmark.is_mark for bookmark in w.tools['bookmarks'].all())")
            window.key("k")
            window.until("'page saved: live_' in w.notice.text")
            window.until("w.tools['rolling_recorder']._exports._made is not None")
            film = window.ask("w.tools['rolling_recorder']._exports._made[0].process.args")
            # It takes its time without a GPU.
            window.ask("w.tools['rolling_recorder']._exports._made[0].process.kill()")
            window.until("w.notice.text.startswith('video live_') and w.notice.is_bad")
            kept = tmp_path / next(each for each in film if each.endswith(".mcap"))
            assert kept.with_suffix(".html").stat().st_size > 200_000
            run = read_run(kept)
            assert run.times[-1] > 2.5 and len(run.times) > 100
            assert film[3:6] == ["render", scene.name, "--camera"]
            assert film[6] == window.ask("w.view_state().camera")
            assert film[-6:-4] == ["--replay", str(kept.relative_to(tmp_path))]
            assert film[-4] == "--duration"
            assert float(film[-3]) == pytest.approx(run.times[-1] - run.times[0], abs=0.3)
            window.key("End")
            assert window.ask("[w.clock.is_past, w.clock.is_paused]") == [False, False]
            window.until("w.data.time == w.clock.end")
    finally:
        sender.kill()
        sender.wait()


def test_missing_display_is_reported(tmp_path: Path) -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [sys.executable, "-m", "sero_mj", "view", "lwr", "--window"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "no display for a window" in done.stderr


_CLOSED = """
import sero_mj
from sero_mj.base.errors import RenderError
with sero_mj.view("lwr", size=(320, 240)) as viewer:
    assert viewer.sync()
    viewer.image()
assert not viewer.is_open
assert not viewer.sync()
viewer.close()
try:
    sero_mj.view("lwr", size=(0, -5))
except RenderError as error:
    print(error)
"""


def run_script(text: str, folder: Path, display: str, **more: str) -> str:
    """What a script prints that opens a window."""
    environment = {**os.environ, "DISPLAY": display, "PYTHONPATH": str(ROOT)}
    environment.pop("MUJOCO_GL", None)
    done = subprocess.run(
        [sys.executable, "-c", text],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**environment, **more},
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
def test_closed_viewer_and_invalid_size_are_reported(display: str, tmp_path: Path) -> None:
    assert (
        run_script(_CLOSED, tmp_path, display, MUJOCO_GL="glfw").strip()
        == "window size: found [0, -5]; expected 1 to 16384 pixels per side"
    )


_LOOP = """
import sero_mj, numpy as np, time
scene = sero_mj.Scene(robots=[sero_mj.SerialRobot.from_model("lwr", show_arrows=True)])
clicks = []
with sero_mj.view(scene, size=(400, 300)) as viewer:
    viewer.on_click(lambda picked, gesture: clicks.append(gesture))
    before = viewer.image()
    rounds, end = 0, time.monotonic() + 1.5
    while viewer.sync() and time.monotonic() < end:
        viewer.set("lwr.joint_angles", [0.4, 0.5, 0, -1, 0, 1, 0])
        viewer.robot("lwr").torques = np.full(7, 40.0)
        rounds += 1
        time.sleep(0.0005)
    after = viewer.image()
    assert before.shape == after.shape and (before != after).mean() > 0.01
    assert rounds > 100, rounds  # it did not wait for the screen in every round
    assert abs(viewer.world.frame(viewer.data, "lwr/flange")[1, 3]) > 0.05
    try:
        viewer.set("lwr.joint_angle", [0.0] * 7)
    except sero_mj.SeroError as error:
        assert "joint_angles" in str(error)
    assert not clicks and viewer.frame_count > 1
print("done")
"""


@pytest.mark.thorough
def test_user_loop_moves_the_robot(display: str, tmp_path: Path) -> None:
    assert run_script(_LOOP, tmp_path, display) == "done\n"


# Panels, pixels that they change, and the largest difference from headless pictures' way.
_BLENDED = """(lambda np, setting, full, placed, bare: [
    len(placed),
    int((bare != full).any(axis=2).sum()),
    setting.compose(bare, placed) or int(np.abs(full.astype(int) - bare).max()),
])(
    __import__("numpy"),
    __import__("sero_mj.viewer.image.typesetting", fromlist=[""]),
    w.image(),
    w.decor._typesetter.place(w.decor.panels),
    [w.decor.panels.clear(), w.decor.render(w.gl), w.gl.read(w.decor.rect)][2],
)"""


def test_window_blends_panels_like_headless_images(window: Driven) -> None:
    window.ask("w.toggles.billboards.fill(True)")
    window.settle()
    panels, changed, difference = window.ask(" ".join(_BLENDED.split()))
    assert panels >= 7 and changed > 7 * 500
    assert difference <= 2


_JAGGED = """(lambda np, mujoco, rect, smooth: (lambda raw: [
    mujoco.mjr_readPixels(raw, None, rect, w.gl.context) or w.gl.context.windowSamples,
    int((np.abs(raw[::-1].astype(int) - smooth).max(axis=2) > 8).sum()),
])(np.empty((rect.height, rect.width, 3), np.uint8)))(
    __import__("numpy"), __import__("mujoco"), w.decor.rect, w.image(),
)"""


def test_images_of_a_window_are_as_smooth_as_the_window(window: Driven) -> None:
    """Reading its buffer of several samples a pixel directly would take one of them."""
    samples, differ = window.ask(" ".join(_JAGGED.split()))
    assert samples >= 4
    assert differ > 100  # along the edges


@pytest.mark.thorough
def test_on_a_slow_machine_a_moving_view_is_drawn_quickly_and_comes_back(window: Driven) -> None:
    picture = "w.image()[::4, ::4].astype(int)"
    before = np.array(window.ask(picture))
    window.ask("setattr(w._pace, 'slow', 0.0)")  # whatever this machine can do
    window.ask("vars(w._pace).pop('is_quick') and vars(w).pop('_draw') and None")
    window.settle()
    try:
        assert not window.ask("w.is_quick")
        window.tool("mousemove", 500, 100, "mousedown", 1)
        for x in range(490, 300, -10):
            window.tool("mousemove", x, 100)
        window.until("w.is_quick")
        window.tool("mouseup", 1)
        window.until("not w.is_quick")
        moved = np.array(window.ask(picture))
        assert (np.abs(moved - before).max(axis=2) > 30).mean() > 0.02
    finally:
        window.tool("mouseup", 1)
        window.ask("setattr(w._pace, 'is_quick', lambda view, now: True)")
        window.ask("setattr(w, '_draw', draw_some)")
    window.ask("w.navigator.choose(0)[:0]")
    window.tool("mousemove", 5, 5)
    window.settle()
    assert np.array_equal(window.ask(picture), before)
