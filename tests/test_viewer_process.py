"""A viewer in a process of its own: what it costs, how it ends, and what comes back."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, raises_with
from polling import until
from web_tools import MISSING as NO_BROWSER
from window_tools import MISSING as NO_WINDOW
from window_tools import screen

import sero_mj
from sero_mj import Scene, SerialRobot, Viewer
from sero_mj.base.errors import RenderError, UnknownName, UsageError

pytestmark = pytest.mark.gl

PATIENCE = 60.0  # s


def answers(url: str) -> bool:
    """Whether there is a page."""
    try:
        with urllib.request.urlopen(url, timeout=5) as answer:
            return b"<html" in answer.read().lower()
    except (urllib.error.URLError, ConnectionError):
        return False


def process_of(viewer: Viewer) -> subprocess.Popen[bytes]:
    return viewer._process._process


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    """A page of a simulation, with a robot that nothing moves but its user."""
    scene = sero_mj.load_scene("impedance_push")
    scene.add(SerialRobot.from_model("lwr", name="mine", base_frame={"xyz": [0.0, 1.0, 0.0]}))
    with sero_mj.view(scene, web=True) as viewer:
        yield viewer


def test_viewer_is_shown_without_calls_and_no_call_waits_for_it(viewer: Viewer) -> None:
    assert until(lambda: viewer.frame_count > 5, PATIENCE)
    assert viewer.url is not None and answers(viewer.url)
    process = process_of(viewer)
    process.send_signal(signal.SIGSTOP)  # as if it were in the middle of a long picture
    try:
        shown, begin = viewer.frame_count, time.monotonic()
        for k in range(1000):
            viewer.set("mine.torques", np.full(7, float(k)))
            assert viewer.sync()
        assert time.monotonic() - begin < 1.0
        assert viewer.frame_count == shown
    finally:
        process.send_signal(signal.SIGCONT)
    assert until(lambda: viewer.frame_count > shown, PATIENCE)


def test_source_data_comes_back_and_inputs_persist(viewer: Viewer) -> None:
    viewer.robot("mine").joint_angles = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    viewer.set("mine.torques", np.arange(7.0))
    simulated = viewer.robot("lwr")

    def has_come() -> bool:
        viewer.sync()
        return viewer.data.time > 0.1 and bool(np.abs(simulated.torques).max() > 1.0)

    assert until(has_come, PATIENCE)
    begin = viewer.data.time
    assert until(lambda: viewer.sync() and viewer.data.time > begin, PATIENCE)
    mine = viewer.robot("mine")
    assert mine.joint_angles.tolist() == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
    assert mine.torques.tolist() == [*range(7)]
    # Frames are those of the angles.
    alone = sero_mj.World(Scene(robots=[SerialRobot.from_model("lwr")]))
    data = alone.make_data()
    alone.set_input(data, "lwr.joint_angles", mine.joint_angles)
    sero_mj.Placer(alone).place(data)
    found = viewer.world.frame(viewer.data, "mine/flange")
    assert found[:3, 3] == pytest.approx(alone.frame(data, "lwr/flange")[:3, 3] + [0, 1, 0])


@pytest.mark.thorough
def test_image_includes_all_previous_inputs(viewer: Viewer) -> None:
    viewer.set("mine.joint_angles", np.zeros(7))
    before = viewer.image()
    viewer.set("mine.joint_angles", [0, 1.5, 0, 0, 0, 0, 0])
    after = viewer.image()
    assert before.shape == after.shape == (800, 1280, 3)
    assert (np.abs(before.astype(int) - after) > 30).any(axis=2).sum() > 5000
    with raises_with(UnknownName, kind="input of mine", name="joint_angle", near="joint_angles"):
        viewer.set("mine.joint_angle", np.zeros(7))


@pytest.mark.thorough
@pytest.mark.skipif(bool(NO_BROWSER), reason=f"needs {', '.join(NO_BROWSER)}")
def test_first_torques_show_arrows_and_billboards_unless_declared() -> None:
    quiet = SerialRobot.from_model("lwr", name="quiet", show_arrows=False, show_billboards=False)
    scene = Scene(robots=[SerialRobot.from_model("lwr"), quiet])
    with sero_mj.view(scene, web=True) as viewer:

        def shown(name: str) -> list[bool]:
            slots, values = viewer.world.slots, viewer._memory.data.userdata
            toggles = ("show_arrows", "show_billboards")
            return [bool(values[slots[f"{name}.{toggle}"]][0] > 0.5) for toggle in toggles]

        viewer.set("lwr.show_billboards", False)
        assert shown("lwr") == [False, False]
        for name in ("lwr", "quiet"):
            viewer.robot(name).torques = [10.0] * 7
        assert shown("lwr") == [True, False]  # the program has set the billboards
        assert shown("quiet") == [False, False]
        viewer.set("lwr.show_arrows", False)
        viewer.robot("lwr").torques = [20.0] * 7
        assert shown("lwr") == [False, False]


def test_browser_sees_the_viewer_live_without_calls(viewer: Viewer, browser: Any) -> None:
    states: list[str] = []

    def watch(socket: Any) -> None:
        if "/live" in socket.url:
            socket.on("framereceived", lambda _: states.append("received"))
            socket.on("close", lambda _: states.append("closed"))

    page = browser.new_page(viewport={"width": 400, "height": 300})
    page.on("websocket", watch)
    page.goto(viewer.url)
    assert until(lambda: page.wait_for_timeout(100) or len(states) > 10, PATIENCE)
    before = viewer.frame_count
    page.wait_for_timeout(1500)
    assert viewer.frame_count > before + 22  # and not 10 a second, as where nobody looks
    seen = len(states)
    assert until(lambda: page.wait_for_timeout(100) or len(states) > seen, PATIENCE)
    assert "closed" not in states
    page.close()


@pytest.mark.thorough
def test_second_viewer_replaces_the_first_and_a_dead_one_does_not_stop_the_loop(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    first = sero_mj.view("lwr", web=True)
    again = sero_mj.view("lwr", web=True)  # a cell that is run again
    assert not first.is_open and not first.sync()
    assert again.is_open and first.url is not None and again.url is not None
    # At the same port, with a token that nobody could receive there in between.
    assert again.url.partition("?")[0] == first.url.partition("?")[0]
    assert again.url != first.url
    assert process_of(first).returncode == 0
    with sero_mj.view("panda", web=True) as other:  # another scene has a page of its own
        assert again.is_open and other.url != again.url
    assert not other.is_open
    assert again.url is not None and answers(again.url)
    assert "http://localhost" in capfd.readouterr().out

    process_of(again).kill()
    assert until(lambda: not again.is_open, PATIENCE)
    assert until(lambda: caplog.records, PATIENCE)
    for _ in range(100):
        again.set("lwr.torques", np.ones(7))
        assert not again.sync()
    with pytest.raises(RenderError, match="cannot render an image: the viewer is closed"):
        again.image()
    again.close()
    (record,) = caplog.records
    assert record.getMessage() == "the viewer process ended; your program continues: SIGKILL"


@pytest.mark.thorough
def test_errors_of_the_viewer_process_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    with sero_mj.view("lwr", web=True) as viewer:
        # As if a driver failed: it writes why, and ends.
        viewer._process._send(("picture",))
        assert until(lambda: not viewer.is_open, PATIENCE)
        assert until(lambda: caplog.records, PATIENCE)
    (record,) = caplog.records
    assert (
        "continues: exit status 1; last output: ValueError: not enough values"
        in record.getMessage()
    )
    with raises_with(UnknownName, kind="camera", name="frnt"):
        sero_mj.view("lwr", web=True, camera="frnt")
    with pytest.raises(
        RenderError, match=r"cannot serve a page at 'nowhere\.invalid': this machine has no such"
    ):
        sero_mj.view("lwr", web=True, host="nowhere.invalid")


_OF_A_SCRIPT = """
import sero_mj, sys, time
class Mine(sero_mj.UdpReceiver):
    pass
source = Mine(structure="7F", udpport=0)
robot = sero_mj.SerialRobot.from_model("lwr")
scene = dict(robots=[robot], routes={"lwr.torques": "mine.values0"})
try:
    sero_mj.view(sero_mj.Scene(sources={"mine": source}, **scene), web=True)
except sero_mj.SeroError as error:
    print(error, flush=True)
viewer = sero_mj.view("lwr", web=True)
try:
    print("waits", flush=True)
    while viewer.sync():
        time.sleep(0.01)
except KeyboardInterrupt:
    time.sleep(0.2)
    shown = viewer.frame_count
    time.sleep(0.5)
    print("interrupted", viewer.is_open, viewer.frame_count > shown, flush=True)
sys.stdin.readline()
"""


@pytest.mark.thorough
def test_viewer_ends_with_the_script_and_not_before(tmp_path: Path) -> None:
    script = subprocess.Popen(
        [sys.executable, "-c", _OF_A_SCRIPT],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        process_group=0,
    )
    assert script.stdin and script.stdout and script.stderr
    with script, script.stdin:
        refused = script.stdout.readline()
        assert "Can't get attribute 'Mine'" in refused and "a module that can be" in refused
        (url,) = re.findall(r"http://\S+", script.stdout.readline())
        assert script.stdout.readline() == "waits\n" and answers(url)
        os.killpg(script.pid, signal.SIGINT)  # as Ctrl+C in a terminal
        assert script.stdout.readline() == "interrupted True True\n"
        script.stdin.write("\n")
        script.stdin.flush()
        assert script.wait(PATIENCE) == 0
        assert script.stderr.read() == "" and not answers(url)


@pytest.mark.thorough
@pytest.mark.skipif(bool(NO_WINDOW), reason=f"needs {', '.join(NO_WINDOW)}")
def test_window_is_drawn_while_the_loop_waits_and_clicks_come_back(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with screen() as display:
        monkeypatch.setenv("DISPLAY", display)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        robot = SerialRobot.from_model("lwr", show_arrows=True)
        with sero_mj.view(Scene(robots=[robot], name="window"), size=(400, 300)) as viewer:
            assert viewer.url is None
            viewer._ipython_display_()
            assert "window is shown in a window" in capfd.readouterr().out
            assert until(lambda: viewer.frame_count > 3, PATIENCE)
            clicks: list[tuple[Any, str, threading.Thread]] = []
            viewer.on_click(lambda *click: clicks.append((*click, threading.current_thread())))
            assert viewer.image().shape == (300 - 29, 400, 3)

            def click(x: int, y: int) -> None:
                command = ["xdotool", "mousemove", str(x), str(y), "click", "1"]
                subprocess.run(command, check=True, timeout=20)

            def robot_was_clicked() -> bool:
                click(200, 150)
                shown = viewer.frame_count
                assert until(lambda: viewer.frame_count > shown + 2, PATIENCE)
                viewer.sync()
                return bool(clicks)

            assert until(robot_was_clicked, PATIENCE)
            picked, gesture, thread = clicks[0]
            assert picked.owner == "lwr" and gesture == "click"
            assert thread is threading.main_thread()
            subprocess.run(["xdotool", "key", "ctrl+q"], check=True, timeout=20)
            assert until(lambda: not viewer.sync(), PATIENCE)
            assert process_of(viewer).wait(20) == 0


def test_unpicklable_class_of_a_script_is_rejected() -> None:
    scene = Scene(robots=[SerialRobot.from_model("lwr")])
    scene.sources["mine"] = lambda: None
    with pytest.raises(UsageError, match=r"cannot be sent to the viewer's process .*picklable"):
        sero_mj.view(scene, web=True)


_WITH_FORKS = """
import os, sero_mj, sys, time
viewer = sero_mj.view("lwr", web=True)
if os.fork() == 0:
    sys.exit()  # closes what it has open, but not the viewer, which is not its own
os.wait()
if os.fork() == 0:  # has all pipes open
    sys.stdin.readline()
    os._exit(0)
assert viewer.sync()
print("forked", flush=True)
time.sleep(100)
"""


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "fork"), reason="Linux and macOS")
def test_viewer_ends_with_a_killed_script_even_if_forks_survive(tmp_path: Path) -> None:
    script = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", _WITH_FORKS],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert script.stdin and script.stdout
    with script, script.stdin:
        (url,) = re.findall(r"http://\S+", script.stdout.readline())
        assert script.stdout.readline() == "forked\n" and answers(url)
        script.kill()
        assert until(lambda: not answers(url), PATIENCE)
