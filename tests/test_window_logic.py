"""What a window does, without one: camera, clock, time line, status line, plots, mouse, help."""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np
import pytest
from PIL import Image
from scripted_widgets import ScriptedWidgets
from shown import Shown
from source_slots import set_source

from sero_mj import Mirror, Scene, SerialRobot, UdpReceiver, World
from sero_mj.base.errors import RenderError
from sero_mj.load import load_scene
from sero_mj.simulate.tools.bookmarks import Bookmarks
from sero_mj.viewer.host.live import LiveHost
from sero_mj.viewer.image.clicks import CLICKS, KEYS
from sero_mj.viewer.panels.dialogs import build_help
from sero_mj.viewer.panels.status_line import SourcesPanel, build_status_line, build_timeline
from sero_mj.viewer.session.capture import ImageWriter, due_frames, unused_name
from sero_mj.viewer.session.clock import SPEEDS, Clock, Tick, time_text
from sero_mj.viewer.session.input import (
    DOUBLE_CLICK_TIME,
    LEFT,
    MIDDLE,
    RIGHT,
    Clicked,
    Event,
    Mouse,
    Moved,
)
from sero_mj.viewer.session.keys import (
    MORE_KEYS,
    VIEWER_KEYS,
    VIEWER_MOUSE,
    help_columns,
)
from sero_mj.viewer.session.status_line import clock_text, source_text, status_pieces
from sero_mj.viewer.session.tool import tool_keys
from sero_mj.viewer.session.torque_history import TorqueHistory
from sero_mj.viewer.window.chrome import arrange
from sero_mj.viewer.window.glfw_window import spread_times
from sero_mj.viewer.window.host import Pace, Window

# ---- clock


@pytest.fixture(scope="module")
def simulated() -> Any:
    with Mirror(load_scene("impedance_push")) as mirror:
        yield mirror


def test_time_advances_at_the_chosen_speed_and_stops_at_the_end(simulated: Mirror) -> None:
    clock = Clock(simulated)
    assert not clock.is_live
    assert clock.end == pytest.approx(5.0)
    clock.advance(0.02)
    assert simulated.data.time == clock.time == pytest.approx(0.02)
    assert clock.faster(1) == "speed 2"
    clock.advance(0.02)
    assert clock.time == pytest.approx(0.06)
    for _ in range(400):
        clock.advance(0.02)
    assert clock.is_at_end
    assert clock.time == pytest.approx(5.0)
    clock.pause()
    clock.pause()  # from the end it begins anew
    assert clock.time == 0.0


def test_simulation_that_cannot_keep_up_reports_its_speed(simulated: Mirror) -> None:
    clock = Clock(simulated)
    clock.advance(0.02)
    assert clock_text(clock)[0].endswith("x1")
    for _ in range(30):
        clock.advance(1.8)  # frames so long that time does not jump after them
    assert clock.is_at_end or "(actual 0.2" in clock_text(clock)[0]
    clock.seek(0.0)
    for _ in range(6):
        clock.advance(1.8)
    assert "(actual 0." in clock_text(clock)[0]


def test_simulation_can_use_as_much_time_as_drawing_of_slow_frames() -> None:
    now = 0.0  # on a clock on which 50 ms take 100 ms to simulate

    def simulate(time: float) -> None:
        nonlocal now
        now += 0.1

    run = SimpleNamespace(end=60.0, step=0.001, newest=None, error=None, advance_to=simulate)
    mirror: Any = SimpleNamespace(is_live=False, sources={"run": run}, advance=lambda time: None)
    pieces, before = [], 0.0
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sero_mj.viewer.session.clock.clock", SimpleNamespace(monotonic=lambda: now))
        clock = Clock(mirror)
        for drawing in (0.15, 0.15, 0.15, 0.01, 0.01):
            simulated = now - before
            before = now
            clock.advance(drawing + simulated)
            pieces.append(round((now - before) / 0.1))
    assert pieces == [2, 2, 2, 1, 1]


def test_paused_clock_steps_and_seeks(simulated: Mirror) -> None:
    clock = Clock(simulated)
    clock.pause()
    clock.advance(0.2)
    assert clock.time == 0.0
    clock.step()
    assert clock.time == pytest.approx(clock.step_size) == pytest.approx(0.001)
    clock.seek(0.3)
    while simulated.data.time < 0.3 - 1e-9:
        clock.advance(0.01)
    angles = simulated.data.qpos.copy()
    clock.seek(9.0)
    clock.advance(0.01)
    clock.seek(0.3)
    clock.advance(0.01)
    assert simulated.data.time == pytest.approx(0.3)
    assert np.array_equal(simulated.data.qpos, angles)  # the past stays as it was
    clock.seek(-1.0)
    assert clock.time == 0.0


def test_plots_have_full_resolution_at_a_low_frame_rate(simulated: Mirror) -> None:
    clock, seen = Clock(simulated), []
    clock.advance(0.0)
    clock.on_state = lambda: seen.append(simulated.data.time)
    clock.advance(0.1)
    assert len(seen) >= 10
    assert np.diff(seen).max() < 0.011
    assert seen[-1] == clock.time


@pytest.mark.parametrize("way", [(4.5, 3.0), (4.5, 0.0), (4.99, 2.0, 4.0)])
def test_after_a_jump_plots_show_what_was_before_it(
    simulated: Mirror, way: tuple[float, ...]
) -> None:
    clock, history = Clock(simulated), TorqueHistory(simulated.world)
    clock.on_state = lambda: history.add(simulated.data)
    clock.pause()
    for goal in way:
        clock.seek(goal)
        while simulated.data.time != goal:
            clock.advance(0.0)
    times, (measured, *_) = history.of(1)
    assert times[0] == pytest.approx(-goal, abs=0.01)
    assert np.diff(times).max(initial=0.0) < 0.08
    assert np.isfinite(measured).all()


def test_plot_opened_after_a_jump_shows_the_past(simulated: Mirror) -> None:
    clock, history = Clock(simulated), TorqueHistory(simulated.world)
    for goal in (4.0, 2.2):
        clock.seek(goal)
        clock.is_paused = False
        while simulated.data.time < goal:
            clock.advance(0.01)
        history.add(simulated.data)
        clock.is_paused = True
    clock.seek(2.0)
    while clock.advance(0.01):
        pass  # a simulation may need several frames
    clock.on_state = lambda: history.add(simulated.data)
    assert clock.advance(0.01)
    times, (measured, *_) = history.of(1)
    assert times[0] == pytest.approx(-2.0, abs=0.01)
    assert np.diff(times).max() < 0.08
    torques = simulated.data.userdata[simulated.world.slots["lwr.torques"]]
    assert measured[-1] == pytest.approx(torques[1])
    assert not clock.advance(0.01)  # once


def test_play_key_at_the_end_restarts(simulated: Mirror) -> None:
    clock = Clock(simulated)
    clock.seek(5.0)
    while not clock.is_at_end or simulated.data.time < 5.0:
        clock.advance(0.01)  # a simulation may need several frames
    assert clock.pause() == "from the start"
    assert (clock.time, clock.is_paused) == (0.0, False)
    assert clock.pause() == "paused"
    assert clock.pause() == "continues"


def test_speeds_have_ends(simulated: Mirror) -> None:
    clock = Clock(simulated)
    for _ in range(20):
        clock.faster(1)
    assert clock.speed == SPEEDS[-1]
    for _ in range(20):
        clock.faster(-1)
    assert clock.speed == SPEEDS[0]


def test_live_clock_has_no_past_before_the_first_data() -> None:
    mirror = Mirror(load_scene("lwr_udp"))  # never opened: no port is taken
    clock = Clock(mirror)
    assert clock.is_live
    assert clock.end is None
    assert clock.faster(1) == "the speed of live sources cannot be changed"
    clock.seek(5.0)
    assert clock.time == 0.0 and not clock.is_past
    assert clock_text(clock) == ("live", "plain")  # whether all is well, the sources say
    clock.pause()
    assert clock_text(clock) == ("PAUSED", "bad")


class Live:
    """A live mirror of one robot whose first angle is the time, rad."""

    is_live = has_states = True
    routes: tuple[()] = ()

    def __init__(self) -> None:
        self.world = World(Scene(robots=[SerialRobot.from_model("lwr")]))
        self.data = self.world.make_data()
        self.sources = {"robot": SimpleNamespace(end=None, step=None)}
        self.now = 0.0

    def advance(self, now: float | None = None) -> bool:
        # A source sets what it has anew; what nobody sets stays.
        assert self.data.qpos[1] == pytest.approx(0.01 * self.data.time)
        self.data.time = self.data.qpos[0] = self.now
        self.data.qpos[1] = 0.01 * self.now
        mujoco.mj_kinematics(self.world.model, self.data)
        return True

    def goes_on(self, clock: Clock, seconds: float, frames: int = 60) -> None:
        for _ in range(frames):
            self.now += seconds / frames
            clock.advance(seconds / frames)


def test_last_minute_of_live_data_can_be_replayed_meanwhile() -> None:
    mirror = Live()
    clock = Clock(mirror)  # type: ignore[arg-type]
    mirror.goes_on(clock, 90.0, 9000)
    assert (clock.begin, clock.end) == pytest.approx((30.0, 90.0), abs=0.05)
    assert mirror.data.qpos[0] == clock.time == clock.end
    clock.seek(50.0)
    mirror.goes_on(clock, 1.0)  # from there on, as fast as it was
    assert mirror.data.qpos[0] == pytest.approx(51.0, abs=0.04)
    link = mirror.world.frame(mirror.data, "lwr/link1")[:3, :3]
    assert link[1, 0] == pytest.approx(np.sin(mirror.data.qpos[0]), abs=1e-9)
    assert clock_text(clock) == ("NOT LIVE  40.00 s ago  x1", "quiet")
    assert clock.faster(1) == "speed 2"
    mirror.goes_on(clock, 1.0)
    assert clock.time == pytest.approx(53.0)
    clock.pause()
    mirror.goes_on(clock, 1.0)
    assert clock_text(clock) == ("PAUSED  40.00 s ago", "bad")
    clock.seek(10.0)
    assert clock.time == pytest.approx(33.0, abs=0.05)  # what is older is gone
    assert clock.go_live() == "live"
    mirror.goes_on(clock, 0.1)
    assert mirror.data.qpos[0] == clock.end == pytest.approx(93.1)
    # What came meanwhile was not missed.
    clock.seek(92.0)
    mirror.goes_on(clock, 0.0, 1)
    assert mirror.data.qpos[0] == pytest.approx(92.0, abs=0.04)
    mirror.goes_on(clock, 0.5)
    assert clock.is_past
    clock.speed = 10.0
    mirror.goes_on(clock, 0.5)  # catches up
    assert not clock.is_past and clock_text(clock) == ("live", "plain")


def test_paused_live_view_stays_at_its_time() -> None:
    mirror = Live()
    clock = Clock(mirror)  # type: ignore[arg-type]
    mirror.goes_on(clock, 2.0, 333)
    assert clock.pause() == "paused"
    mirror.goes_on(clock, 3.0)
    assert mirror.data.qpos[0] == clock.time == pytest.approx(2.0)
    assert clock.step(-1) == "3.02 s ago"
    mirror.goes_on(clock, 0.0, 1)
    assert mirror.data.qpos[0] == pytest.approx(2.0 - 1 / 60, abs=0.04)
    clock.seek(5.0)
    assert clock.step() == "paused; shows the latest packet"
    assert mirror.data.qpos[0] == pytest.approx(5.0)
    mirror.goes_on(clock, 1.0)
    assert mirror.data.qpos[0] == pytest.approx(5.0)
    assert clock.pause() == "live"
    mirror.goes_on(clock, 0.1)
    assert mirror.data.qpos[0] == pytest.approx(6.1)


# ---- bookmarks


def bare(mirror: Any, clock: Any) -> Shown:
    """What bookmarks work in: nothing is drawn."""
    return Shown(mirror, clock=clock, toggles=SimpleNamespace(), decor=SimpleNamespace())


def test_faults_of_what_is_live_and_marks_are_found_again() -> None:
    mirror = Live()
    world, robot = mirror.world, mirror.world.scene.robots["lwr"]
    slots = world.slots
    mirror.world = SimpleNamespace(  # type: ignore[assignment]
        **{name: getattr(world, name) for name in ("model", "joints", "owners", "state", "frame")},
        slots={**slots, "sources.robot": slice(slots["lwr.torques"].start, None)},
    )
    mirror.sources.clear()
    clock = Clock(mirror)  # type: ignore[arg-type]
    clock.is_live = True
    bookmarks = Bookmarks(bare(mirror, clock))
    clock.on_state = bookmarks.watch
    mirror.goes_on(clock, 1.0)
    assert bookmarks.all() == []
    assert bookmarks.go(1) == "no marks or faults after this time"
    world.set_input(mirror.data, "lwr.torques", [0, 1.1 * robot.torque_limits[1], 0, 0, 0, 0, 0])
    mirror.goes_on(clock, 1.0)  # beyond its limit all along: found once
    world.set_input(mirror.data, "lwr.torques", np.zeros(7))
    error = 0.2 * robot.torque_limits[5]
    world.set_input(mirror.data, "lwr.commanded_torques", [0, 0, 0, 0, 0, error, 0])
    mirror.goes_on(clock, 0.9)  # until the first joint is beyond its limit, of 2.97 rad
    limit = 1.1 * robot.torque_limits[1]
    assert [bookmark.text for bookmark in bookmarks.all()] == [
        f"lwr/A2: torque {limit:.3g} Nm, above its limit", f"lwr/A5: torque error {error:.3g} Nm",
    ]  # fmt: skip
    assert [bookmark.time for bookmark in bookmarks.all()] == pytest.approx([1.0, 2.0], abs=0.03)
    mirror.goes_on(clock, 0.2)
    assert bookmarks.all()[-1].text == "lwr/A1: angle 2.97 beyond its limit of 2.97 rad"
    assert bookmarks.mark().startswith("marked 3.10 s")
    assert [tick.is_mark for tick in sorted(bookmarks.ticks())] == [False, False, False, True]
    assert bookmarks.go(-1).startswith("2.97 s: lwr/A1: angle")
    assert clock.is_past and clock.is_paused
    assert bookmarks.go(-1).endswith(f"lwr/A5: torque error {error:.3g} Nm")
    assert clock.time == pytest.approx(2.0, abs=0.03)
    mirror.goes_on(clock, 0.0, 1)
    assert mirror.data.qpos[0] == pytest.approx(clock.time, abs=0.04)
    bookmarks.go(1)
    assert bookmarks.go(1) == "3.10 s: mark"


def test_lost_packets_are_marked_once(lwr: SerialRobot) -> None:
    scene = Scene(
        robots=[lwr], sources={"arm": {"kind": "udp", "structure": "7F1I"}},
        routes={"lwr.joint_angles": "arm.values0"},
    )  # fmt: skip
    world = World(scene)
    data = world.make_data()
    mirror: Any = SimpleNamespace(world=world, data=data, sources={"arm": None})
    clock: Any = SimpleNamespace(begin=0.0, is_live=True)
    bookmarks = Bookmarks(bare(mirror, clock))
    counts = {"age": 0.0, "lost": 0, "malformed": 0}
    for step in range(400):
        data.time = 0.01 * step
        counts["lost"] += 100 <= step < 150 or step == 320
        counts["malformed"] += step == 200
        set_source(data, world, "arm", **counts)
        bookmarks.watch()
    assert [(bookmark.time, bookmark.text) for bookmark in bookmarks.all()] == [
        (1.0, "arm: packets lost"), (2.0, "arm: packets not applied"), (3.2, "arm: packets lost"),
    ]  # fmt: skip


def test_bookmarks_seek_findings_of_a_monitor() -> None:
    with Mirror(load_scene("sensor_fault")) as mirror:
        clock = Clock(mirror)
        bookmarks = Bookmarks(bare(mirror, clock))
        (source,) = mirror.sources.values()
        source.run.advance(source.run.steps)  # type: ignore[attr-defined]
        findings = source.run.findings()  # type: ignore[attr-defined]
        said = bookmarks.go(1)
        assert said.endswith(str(findings[0]).split("  ", 1)[1].replace("  ", " "))
        assert clock.time == findings[0].time and clock.is_paused


# ---- time line and status line


def test_timeline_pauses_steps_seeks_and_shows_marks(simulated: Mirror) -> None:
    clock = Clock(simulated)

    def does(label: str, value: Any = True) -> ScriptedWidgets:
        ui = ScriptedWidgets({label: value})
        ticks = [Tick(1.0, "mark", is_mark=True), Tick(2.0, "A2: too much", is_mark=False)]
        build_timeline(ui, clock, ticks)
        return ui

    does("##time", 2.0)  # goes to what happened, and stays there
    assert (clock.time, clock.is_paused) == (2.0, True)
    clock.is_paused = False
    ui = does("##time", 2.5)
    assert (clock.time, clock.is_paused) == (2.5, False)
    assert ui.ticks == [(1.0, "title", "1.00 s: mark"), (2.0, "bad", "2.00 s: A2: too much")]
    does("pause###pause")
    assert clock.is_paused
    does(">")
    assert clock.time == pytest.approx(2.5 + clock.step_size)
    does("<")
    assert clock.time == pytest.approx(2.5)
    does("##speed", "x 0.25")
    assert clock.speed == 0.25
    does("|<")
    assert clock.time == 0.0
    does("play###pause")
    assert not clock.is_paused
    narrow = ScriptedWidgets(size=(20.0, 2.0))
    build_timeline(narrow, clock, [])
    assert ("slide", "##time") in narrow.built
    assert ("choose", "##speed") not in narrow.built


@pytest.mark.parametrize(
    ("width", "shown"),
    [(60.0, ["live", "arm: 99/s", "60 frames/s", "H help"]),
     (13.0, ["live", "arm: 99/s", "H help"]),
     (9.0, ["live", "arm: 99/s"]), (3.0, ["live"]), (1.0, [])],
)  # fmt: skip
def test_status_line_omits_items_that_do_not_fit(width: float, shown: list[str]) -> None:
    pieces: Any = [("live", "plain"), ("arm: 99/s", "good"), ("60 frames/s", "plain")]
    ui = ScriptedWidgets(size=(width, 1.0))
    build_status_line(ui, pieces, "H help")
    assert ui.texts() == shown


def test_text_counter_shows_its_text() -> None:
    source = UdpReceiver(name="udp", structure="7F")
    source.counters.last_fault = "found 9 bytes"
    ui = ScriptedWidgets()
    with Mirror(load_scene("lwr")) as mirror:
        SourcesPanel().build(ui, Clock(mirror), [source], is_open=True)
    assert {"received: 0", "last fault: found 9 bytes"} <= {text.strip() for text in ui.texts()}


@pytest.mark.parametrize(
    ("time", "text"),
    [(0, "0.00 s"), (59.5, "59.50 s"), (61.25, "1:01.2"), (3723, "1:02:03")],
)
def test_times_are_formatted(time: float, text: str) -> None:
    assert time_text(time) == text


def found(**values: Any) -> dict[str, Any]:
    nothing = dict.fromkeys(("lost", "dropped", "malformed", "received"), 0)
    now = {"source": "udp", "age": 0.003, "receiving": True, "rate": 999.6, "fault_age": None}
    return {**now, "clock": None, **nothing, **values}


@pytest.mark.parametrize(
    ("values", "text", "mood"),
    [
        ({}, "udp: 1000/s, 3 ms old", "good"),
        ({"lost": 50, "received": 950}, "udp: 1000/s, 3 ms old, 5.0 % lost", "good"),
        ({"lost": 1, "received": 10**6}, "udp: 1000/s, 3 ms old, 1 lost", "good"),
        ({"malformed": 7, "fault_age": 1}, "udp: 1000/s, 3 ms old, 7 not applied", "bad"),
        ({"malformed": 7, "fault_age": 9}, "udp: 1000/s, 3 ms old, 7 not applied", "good"),
        (
            {"receiving": False, "age": 2.5, "malformed": 7, "fault_age": 0.1},
            "udp: no valid packet for 2.5 s, 7 not applied",
            "bad",
        ),
        ({"receiving": False, "age": 2.5}, "udp: quiet for 2.5 s", "bad"),
        ({"age": None}, "udp: no data yet", "quiet"),
        ({"age": None, "malformed": 3}, "udp: no data yet, 3 not applied", "bad"),
    ],
)
def test_source_state_is_described(values: dict[str, Any], text: str, mood: str) -> None:
    assert source_text(found(**values), is_live=True) == (text, mood)


def test_status_line_has_time_sources_and_frame_rate(simulated: Mirror) -> None:
    clock = Clock(simulated)
    texts = [text for text, _ in status_pieces(simulated.sources.values(), clock, 59.7)]
    assert texts == ["0.00 s / 5.00 s  x1", "simulation of impedance_push, 5 s", "60 frames/s"]


# ---- mouse


def test_press_without_motion_is_a_click() -> None:
    mouse = Mouse()
    assert mouse.take(Event("press", 10, 20, 1.0, LEFT, shift=True)) is None
    assert mouse.take(Event("move", 12, 21, 1.1)) is None
    assert mouse.take(Event("release", 12, 21, 1.2, LEFT)) == Clicked(10, 20, 1.0, shift=True)


@pytest.mark.parametrize(
    ("button", "shift", "how"),
    [(LEFT, False, "orbit"), (LEFT, True, "pan"), (RIGHT, False, "pan"), (MIDDLE, False, "pan")],
)
def test_press_with_motion_is_a_drag(button: int, shift: bool, how: Any) -> None:
    mouse = Mouse()
    mouse.take(Event("press", 10, 20, 1.0, button, shift=shift))
    assert mouse.take(Event("move", 13, 20, 1.1)) is None
    # What was held back until it was a drag is not lost.
    assert mouse.take(Event("move", 20, 14, 1.2)) == Moved(how, 10, 6)
    assert mouse.take(Event("move", 25, 14, 1.3)) == Moved(how, 5, 0)
    assert mouse.is_down
    assert mouse.take(Event("release", 25, 14, 1.4, button)) is None
    assert mouse.take(Event("move", 30, 14, 1.5)) is None
    assert not mouse.is_down


def test_two_clicks_of_the_right_button_center_the_view() -> None:
    mouse = Mouse()

    def click(time: float, x: float = 50.0) -> Any:
        mouse.take(Event("press", x, 60, time, RIGHT))
        return mouse.take(Event("release", x, 60, time + 0.05, RIGHT))

    assert click(1.0) is None
    assert click(1.2) == Clicked(50, 60, 1.2, center=True)
    assert click(1.4) is None  # a third is a first
    assert click(3.0) is None  # too late
    assert click(3.2, x=90.0) is None  # too far


def test_wheel_zooms() -> None:
    assert Mouse().take(Event("scroll", 0.0, 2.0)) == Moved("zoom", 0.0, 2.0)


# ---- films, keys, help


def test_video_shows_real_time_at_any_frame_rate() -> None:
    sent = 0
    for seconds in (0.0, 0.2, 0.21, 1.0):
        sent += due_frames(seconds, sent)
        assert sent == int(seconds * 30) + 1


def test_files_get_unused_names(tmp_path: Path) -> None:
    now = datetime(2026, 5, 4, 17, 3, 12)
    first = unused_name(tmp_path, "two arms/1", ".png", now)
    assert first.name == "two_arms_1_2026-05-04_17-03-12.png"
    assert unused_name(tmp_path, "two arms/1", ".png", now).name.endswith("-12_2.png")
    (tmp_path / "two_arms_1_2026-05-04_17-03-12_3.png").touch()
    assert unused_name(tmp_path, "two arms/1", ".png", now).name.endswith("-12_4.png")


def test_two_screenshots_within_a_second_are_two_files(tmp_path: Path) -> None:
    capture = ImageWriter("lwr", tmp_path)
    with patch("sero_mj.viewer.session.capture.datetime") as clock:
        clock.now.return_value = datetime(2026, 5, 4, 17, 3, 12)
        for value in (0, 255):
            capture.save_screenshot(np.full((4, 4, 3), value, np.uint8))
    capture.close()
    found = {int(np.asarray(Image.open(file)).max()) for file in tmp_path.glob("*.png")}
    assert found == {0, 255}


def test_keys_have_unique_meanings_and_existing_actions() -> None:
    assert not set(KEYS) & {*VIEWER_KEYS, *MORE_KEYS}
    assert not set(VIEWER_KEYS) & set(MORE_KEYS)
    more = {key.action for key in MORE_KEYS.values() if not key.action.startswith("camera_")}
    assert more - {"last_joint"} <= {key.action for key in VIEWER_KEYS.values()}


class FakeClock:
    """Notes what it is asked for."""

    def __init__(self) -> None:
        self.time, self.asked = 5.0, []

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: self.asked.append((name, *arguments))


class Host(LiveHost):
    """Notes what it says and is asked for, and shows nothing."""

    is_open = is_due = True
    frame = image = close = request_close = None  # type: ignore[assignment]
    image_size = to_clipboard = None  # type: ignore[assignment]
    decor = SimpleNamespace(fixed="")  # type: ignore[assignment]

    def __init__(self, world: World) -> None:
        data = world.make_data()
        mirror = SimpleNamespace(world=world, data=data, is_live=False, sources={}, routes=[])
        super().__init__(mirror)  # type: ignore[arg-type]
        self.said: list[str] = []
        self.helped = 0
        self.actions.add({"help": self.help})

    def help(self) -> None:
        self.helped += 1

    def say(self, text: str, is_bad: bool = False) -> None:
        self.said.append(text)


def test_keys_do_what_the_tables_say_in_every_host(
    lwr_world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = FakeClock()
    monkeypatch.setattr("sero_mj.viewer.host.live.Clock", lambda mirror: clock)
    host = Host(lwr_world)
    for key in (" ", ".", ",", "-", "+", "backspace", "left", "right", "home", "_"):
        host.actions.press(key)
    assert clock.asked == [
        ("pause",), ("step",), ("step", -1), ("faster", -1), ("faster", 1), ("reset",),
        ("seek", 4.0), ("seek", 6.0), ("reset",), ("faster", -1),
    ]  # fmt: skip
    for key in ("3", "f", "h", "[", "]", "]", "l", "f2", "y", "escape"):
        host.actions.press(key)  # F2 is not of this host, y of none
    selected = [f"selected: lwr/{joint}" for joint in ("A6", "A1", "A2")]
    camera = "no camera 3: the scene has none"
    assert host.said == [camera, "follows nothing", *selected, "legend: off"]
    assert (host.joint, host.helped, host.toggles.legend) == (1, 1, False)
    clock.asked.clear()
    for key in (".", " ", "l"):
        host.actions.press(key, is_repeat=True)  # held down: only what goes on in steps does
    assert clock.asked == [("step",)] and host.toggles.legend is False


def test_help_contains_all_entries_of_the_key_tables() -> None:
    words = {meaning for column in help_columns(tool_keys()) for _, meaning in column}
    for table in (KEYS, CLICKS):
        for key, (meaning, _) in table.items():
            if key[0] != "shift" and key[1:] not in (("double",), ("check",)):
                assert meaning in words, key
    assert {key.text for key in VIEWER_KEYS.values()} <= words
    assert set(VIEWER_MOUSE.values()) <= words


@pytest.mark.parametrize("width", [70.0, 20.0])
def test_help_has_all_rows_at_any_width(width: float) -> None:
    columns = help_columns(tool_keys())
    ui = ScriptedWidgets(size=(width, 20.0))
    build_help(ui, columns)
    shown = [label for kind, label in ui.built if kind in ("title", "text")]
    assert shown == [words for column in columns for row in column for words in row if words]


@pytest.mark.parametrize("size", [(1280, 800), (640, 480), (320, 240)])
@pytest.mark.parametrize("has_area", [False, True])
def test_parts_of_a_window_do_not_overlap(size: tuple[int, int], has_area: bool) -> None:
    places = arrange(size, 18, has_status=True, has_time=True, has_area=has_area)
    covered = np.zeros(size[::-1], int)
    for rect in places:
        if rect is not None:
            assert rect.width > 0 and rect.height > 0
            upper, right = rect.bottom + rect.height, rect.left + rect.width
            covered[rect.bottom : upper, rect.left : right] += 1
    assert (covered == 1).all()
    assert places.image.bottom == 52 or (has_area and size[0] < 1000)
    bare = arrange(size, 18, has_status=False, has_time=False, has_area=False)
    assert bare.image == (0, 0, *size)


def test_missing_user_interface_package_is_reported(
    simulated: Mirror, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "sero_mj.viewer.window.chrome", None)
    with pytest.raises(RenderError, match=r"window\.chrome.*--web"):
        Window(simulated)


def test_clicks_during_a_hitch_are_no_double_click() -> None:
    presses = [Event(kind, x=5, y=5) for kind in ("press", "release", "press", "release")]
    for took, is_double in ((0.016, True), (1.5, False)):
        times = [each.time for each in spread_times(presses, 10.0, 10.0 + took)]
        assert times == sorted(times)
        assert times[0] > 10.0
        assert times[-1] == pytest.approx(10.0 + took)
        assert (times[2] - times[0] <= DOUBLE_CLICK_TIME) == is_double


def test_clock_without_sources_has_no_speed(lwr: SerialRobot) -> None:
    with Mirror(Scene(robots=[lwr])) as mirror:
        clock = Clock(mirror)
        for _ in range(50):
            clock.advance(0.4)  # a slow loop of the user's own
        assert "x1" not in clock_text(clock)[0]
        assert clock_text(clock)[1] == "plain"
        clock.pause()
        assert clock_text(clock)[1] == "bad"


# ---- quality


def test_moving_views_are_simplified_only_on_slow_machines() -> None:
    pace, now = Pace(), 0.0

    def frames(seconds: float, moves: bool, count: int = 10) -> list[bool]:
        nonlocal now
        found = []
        for _ in range(count):
            now += 0.1
            view = (now if moves else 1.0, 0.0, 0.0)
            found.append(pace.is_quick(view, now))
            if not found[-1]:
                pace.took(seconds)
        return found

    assert not any(frames(0.01, moves=True))
    assert not any(frames(0.2, moves=False)[4:])
    assert all(frames(0.2, moves=True))
    rests = frames(0.2, moves=False)
    assert rests[0] and not any(rests[4:])
    pace.act(now)  # a click
    clicked = frames(0.2, moves=False)
    assert clicked[0] and not any(clicked[4:])
    pace = Pace()
    pace.act(now)
    assert not any(frames(0.2 if k == 3 else 0.01, moves=True, count=1)[0] for k in range(9)), (
        "one late frame"
    )
