"""The state of a view: as text, undone, and copied as a command."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import ROOT, examples, raises_with
from decor_tools import view_at, world_of
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from window_tools import MISSING, Driven, screen

from sero_mj import World
from sero_mj.base.errors import SeroError, UnknownName, UsageError
from sero_mj.cli import view
from sero_mj.load import load_scene
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.handles import SEGMENTS
from sero_mj.viewer.decor.toggles import PART_NAMES, Toggles
from sero_mj.viewer.image.camera import find_camera
from sero_mj.viewer.image.switches import SWITCH_NAMES, apply_switches, switches_text
from sero_mj.viewer.session.recent_views import file_of, load_view, save_view
from sero_mj.viewer.session.view_state import (
    ViewSnapshot,
    ViewState,
    apply_state,
    camera_text,
)
from sero_mj.viewer.tools.undo import Undo

SET = ("lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0", "lwr.torques=20,60,-30,40,-9,5,3")


@pytest.fixture(scope="module")
def world() -> World:
    return World(load_scene("impedance_push"))


@given(seed=st.integers(0, 10_000))
@settings(max_examples=examples(40))
def test_toggles_round_trip_through_text(world: World, seed: int) -> None:
    rng = np.random.default_rng(seed)
    toggles, again = Toggles(world), Toggles(world)
    for name in SWITCH_NAMES:
        now = getattr(toggles, name)
        if isinstance(now, bool):
            setattr(toggles, name, bool(rng.integers(2)))
        elif isinstance(now, int):
            setattr(toggles, name, int(rng.integers(len(PART_NAMES))))
        elif rng.random() < 0.5:
            now[:] = rng.integers(2)
        else:
            now[:] = rng.integers(0, 4 if name == "arrow_quantity" else 2, len(now))
    apply_switches(world, again, switches_text(world, toggles))
    assert switches_text(world, Toggles(world)) == {}
    for name in SWITCH_NAMES:
        assert np.array_equal(getattr(toggles, name), getattr(again, name)), name


def test_states_round_trip_through_text(world: World) -> None:
    state = ViewState("150,-15,2.2,0.1,0,0.5", {"arrows": "10101010101010"}, "lwr/A2", 1.25)
    assert ViewState.from_text(state.to_text()) == state
    assert ViewState().to_text() == "{}"
    toggles = Toggles(world)
    camera, joint, wrong = apply_state(world, toggles, state)
    assert camera is not None and camera_text(world, camera) == state.camera
    assert (joint, toggles.selected, wrong) == (1, 1, [])
    assert toggles.arrows.tolist()[:7] == [True, False] * 3 + [True]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "view: '' is not a valid view: "),
        ("[1]", "view: '[1]' is not a valid view: "),
        ('{"colour":1}', "colour: "),
        ('{"time":"x"}', "time: "),
        ('{"switches":3}', "switches: "),
    ],
)
def test_invalid_states_are_rejected(text: str, expected: str) -> None:
    with pytest.raises(UsageError) as caught:
        ViewState.from_text(text)
    assert expected in str(caught.value)


def test_state_of_another_scene_is_applied_as_far_as_it_fits(world: World) -> None:
    state = ViewState("there", {"arrow": "1", "legend": "0", "axes": "01"}, "kuka/A9")
    toggles = Toggles(world)
    camera, joint, wrong = apply_state(world, toggles, state)
    assert (camera, joint, toggles.legend) == (None, None, False)
    frames = len(toggles.axes)
    assert wrong[0] == "there is no switch 'arrow'; did you mean 'arrows'?"
    assert wrong[1] == f"axes: found 2 digits; expected one digit, or {frames} (one for each item)"
    assert wrong[2].startswith("no camera 'there'")
    assert wrong[3].startswith("no joint 'kuka/A9'")


def test_invalid_toggles_and_cameras_are_rejected(world: World) -> None:
    toggles = Toggles(world)
    with pytest.raises(UsageError, match="legend: found '2'; expected digits from 0 to 1"):
        apply_switches(world, toggles, {"legend": "2"})
    with pytest.raises(UsageError, match="arrow_quantity: found '9'"):
        apply_switches(world, toggles, {"arrow_quantity": "9"})
    with raises_with(UnknownName, kind="joint", name="lwr/A7", near="lwr/A6"):
        apply_switches(world, toggles, {}, "lwr/A7")
    for wrong in ("1,2", "1,2,3,4", "1,2,0,0,0,0", "1,2,3,4,5,nan"):
        with pytest.raises(UsageError, match="the look-at point ,x,y,z"):
            find_camera(world, wrong)


def test_undo_restores_a_view_bit_for_bit(world: World) -> None:
    camera, toggles = find_camera(world), Toggles(world)
    before = ViewSnapshot.of(camera, toggles, follows=False)
    camera.azimuth += 1e-13 * camera.azimuth
    assert ViewSnapshot.of(camera, toggles, follows=False) != before
    camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
    camera.lookat = [1.0, 2.0, 3.0]
    toggles.arrows[2], toggles.legend, toggles.selected = True, False, 3
    before.show(camera, toggles)
    assert ViewSnapshot.of(camera, toggles, follows=False) == before
    assert ViewSnapshot.of(camera, toggles, follows=True).lookat is None


def test_view_is_saved_for_its_scene(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    scene = world.scene
    assert load_view(scene) is None
    state = ViewState("150,-15,2.2,0.1,0,0.5", {"legend": "0"}, "lwr/A2", 1.25)
    save_view(scene, state, {"plot": True}, {"plot": [1]})
    (file,) = (tmp_path / "sero-mj" / "views").iterdir()
    assert file == file_of(scene) and file.name.startswith("impedance_push-")
    assert load_view(scene) == (state._replace(time=None), {"plot": True}, {"plot": [1]})
    assert load_view(load_scene("lwr")) is None
    for text in ("", "{}", '{"view": "[]", "layout": {}}', '{"view": "{}", "layout": 3}', "\0"):
        file.write_text(text)
        with pytest.raises(UsageError, match=r"not a valid view \(.*use --fresh to ignore"):
            load_view(scene)
    long = state._replace(switches={"axes": "01" * 50_000}, time=None)
    save_view(scene, long, {"plot": True}, {"plot": ["x" * 500_000]})
    assert load_view(scene) == (long, {"plot": True}, {"plot": ["x" * 500_000]})
    save_view(scene, long, {"plot": True}, {"plot": ["x" * 2_000_000]})
    assert load_view(scene) == (long, {"plot": True}, {})
    file.unlink()
    file.parent.rmdir()
    file.parent.write_text("a file where the folder should be")
    save_view(scene, state, {}, {})  # this must not raise


def test_continuous_changes_are_one_undo_step() -> None:
    state = [0]
    undo = Undo(lambda: state[0], lambda value: state.__setitem__(0, value))
    now = 0.0

    def go(values: list[int], seconds: float = 1.0) -> None:
        nonlocal now
        for value in values:
            state[0] = value
            now += 0.05
            undo.watch(now)
        undo.watch(now + seconds)
        now += seconds

    assert undo.undo() == "nothing to undo"
    go([1, 2, 3])
    go([4, 5])
    go([6], seconds=0.0)  # not yet settled
    assert undo.undo() == "undone; Ctrl+Y redoes it"
    assert state == [5]
    undo.undo()
    assert state == [3]
    assert undo.redo() == "redone"
    assert state == [5]
    go([9])
    assert undo.redo() == "nothing to redo"
    undo.undo()
    undo.undo()
    undo.undo()
    assert state == [0]
    assert undo.undo() == "nothing to undo"


def blocks(picture: np.ndarray) -> np.ndarray:
    """Returns means of 8 x 8 pixels, because screens without multisampling have other edges."""
    high, wide = (size // 8 * 8 for size in picture.shape[:2])
    cut = picture[:high, :wide].astype(float)
    return cut.reshape(high // 8, 8, wide // 8, 8, 3).mean(axis=(1, 3))


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driven]:
    folder = tmp_path_factory.mktemp("state")
    monkeypatch = pytest.MonkeyPatch()
    monkeypatch.setenv("XDG_STATE_HOME", str(folder))
    with (
        monkeypatch.context(),
        screen() as display,
        Driven(display, folder, "lwr", settings=SET) as opened,
    ):
        opened.folder = folder  # type: ignore[attr-defined]
        yield opened


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.live
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_keys_undo_and_redo_and_the_copied_command_renders_the_image(
    window: Driven,
) -> None:
    picture = "w.image().tobytes().hex()"
    window.tool("mousemove", 5, 200)
    window.key("space")  # paused, so that its arrows do not move
    window.settle()
    first = window.ask(picture)
    window.key("a")
    window.key("bracketright")
    window.until("w.tools['undo'].undo.count > 0")
    window.tool("mousemove", 500, 60, "mousedown", 1)
    for x in range(490, 420, -10):
        window.tool("mousemove", x, 66)
    window.tool("mouseup", 1, "mousemove", 5, 200)
    window.until("w.tools['undo'].undo.is_settled")
    assert window.ask("w.toggles.selected") == 1
    window.ask("setattr(w, 'command', ['lwr'])")
    window.key("ctrl+c")
    assert window.ask("w.notice.text") == "copied the command that renders this image"
    command = window.ask("w.gl.clipboard")
    words = shlex.split(command)
    assert words[:3] == ["sero-mj", "render", "lwr"]
    assert words[words.index("--select") + 1] == "lwr/A2"
    out = window.folder / "copied.png"  # type: ignore[attr-defined]
    words[words.index("-o") + 1] = str(out)
    for setting in SET:
        words[3:3] = ["--set", setting]
    subprocess.run([sys.executable, "-m", *("sero_mj", *words[1:])], cwd=ROOT, check=True,
                   capture_output=True)  # fmt: skip
    width, height = window.ask("w.image_size")
    shown = np.frombuffer(bytes.fromhex(window.ask(picture)), np.uint8).reshape(height, width, 3)
    rendered = np.array(Image.open(out).convert("RGB"))
    assert shown.shape == rendered.shape
    assert np.abs(blocks(shown) - blocks(rendered)).max() < 45
    for _ in range(window.ask("w.tools['undo'].undo.count")):
        window.key("ctrl+z")
    assert window.ask("w.notice.text") == "undone; Ctrl+Y redoes it"
    window.until("not w.toggles.arrows.any()")
    assert window.ask(picture) == first
    window.key("ctrl+y")
    window.until("w.toggles.arrows.all()")
    before = window.ask("[w.view_state().to_text(), w.layout]")
    window.ask("w.toggle('shows_panel') or w.actions.perform('plot')")
    window.ask("save(w)")
    window.ask(
        "w.toggles.reset() or w.camera_control.choose(0) and w.toggle('shows_panel')"
        " or w.actions.perform('plot')"
    )
    window.ask("restore(w)")
    assert window.ask("w.view_state().camera") in before[0]
    assert window.ask("[w.layout['panel'], w.layout['plot']]") == [True, True]
    window.until("w.toggles.arrows.all()")


def test_selected_joint_has_a_ring_about_its_axis() -> None:
    world = world_of(joint_angles=[0.3, 0.6, 0.0, -1.2, 0.0, 0.8, 0.0])
    data, toggles, decor = world.make_data(), Toggles(world), Decor(world)
    without = decor.draw(data, toggles, view_at()).count
    toggles.selected = 3
    buffer = decor.draw(data, toggles, view_at())
    rows = buffer.rows[: buffer.count][-(buffer.count - without) :]
    rows = rows[np.abs(rows["emission"] - 0.9) < 1e-6]
    assert len(rows) == SEGMENTS == buffer.count - without
    T = world.scene.robots["lwr"].kinematics.frames(data.qpos[:7])[4]  # by NumPy
    away = rows["pos"] - data.site_xpos[world.joints.centre_site[3]]
    axis = data.site_xmat[world.joints.centre_site[3]].reshape(3, 3)[:, 2]
    assert np.abs(away @ axis).max() < 1e-6
    radius = np.linalg.norm(away, axis=1)
    assert radius == pytest.approx(1.3 * world.joints.arrow_radius[3], rel=1e-5)
    assert np.linalg.norm(np.cross(rows["pos"].mean(axis=0) - T[:3, 3], axis)) < 0.2


# ---- files that are dropped


def test_dropped_file_is_opened_and_an_invalid_one_changes_nothing(tmp_path: Path) -> None:
    options = view.ViewOptions(scene="lwr_udp")
    session = view.Session(options, on_page=False)
    for name, text, expected in (
        ("notes.txt", "", "notes.txt"),
        ("scene.toml", "[robots.lwr]\nmodle = 'lwr'\n", "did you mean 'model'"),
        ("robot.urdf", "<robot/>", "robot has no <link>"),
        ("run.mcap", "no recording", "run.mcap"),
    ):
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(SeroError) as caught:
            session.open(tmp_path / name)
        assert expected in str(caught.value)
        assert session.options is options
    urdf = tmp_path / "two.urdf"
    urdf.write_text(
        '<robot name="two"><link name="a"/><link name="b"/><joint name="j" type="revolute">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="5" velocity="1"/></joint></robot>',
        encoding="utf-8",
    )
    urdf_text = urdf.read_text()
    mesh = '<visual><geometry><mesh filename="gone.stl"/></geometry></visual>'
    urdf.write_text(urdf_text.replace('<link name="b"/>', f'<link name="b">{mesh}</link>'))
    session.open(urdf)
    warning, *_ = session._warnings
    assert "gone.stl" in warning  # which the window or page then shows, too
    urdf.write_text(urdf_text)
    scene = session.open(urdf).world.scene
    assert not any("gone" in each for each in session._warnings)
    assert list(scene.robots) == ["two"]
    assert (session.options.scene, session.plain) == (str(urdf), scene)


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.live
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_file_dropped_on_a_window_opens_another_scene(window: Driven) -> None:
    drop = "w.gl._on_drop(None, ['/tmp/there.toml'])"  # xdotool drops no files
    window.ask(drop)
    window.until("w.notice.text == 'there.toml: only `sero-mj view` opens dropped files'")
    window.ask("globals().update(load=__import__('sero_mj.load', fromlist=['x']).load_scene)")
    window.ask("setattr(w.others, 'opener', lambda path: load('no such scene'))")
    window.ask(drop)
    window.until("\"no scene or robot 'no such scene'\" in w.notice.text and w.notice.is_bad")
    assert window.ask("w.is_open and w.others.chosen is None")
    window.ask("setattr(w.others, 'opener', lambda path: Mirror(load('justin')))")
    window.ask("setattr(w.others, '_close', lambda: None)")  # otherwise it cannot be queried
    window.ask(drop)
    assert (
        window.until("w.others.chosen is not None and w.others.chosen.world.scene.name") == "justin"
    )
