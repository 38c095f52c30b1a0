"""The panel in a window, worked with mouse and keys, and what it leaves as it was."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from window_tools import MISSING, SIZE, Driven, screen

pytestmark = [
    pytest.mark.gl,
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]

_SETTINGS = ("lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0", "lwr.torques=20,60,-30,40,-9,5,3",
             "lwr.show_axes=true")  # fmt: skip


@pytest.fixture(scope="module")
def window(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driven]:
    folder = tmp_path_factory.mktemp("panel")
    with screen() as display, Driven(display, folder, "lwr", settings=_SETTINGS) as window:
        window.folder = folder  # type: ignore[attr-defined]
        yield window


def screenshot(window: Driven) -> np.ndarray:
    folder: Path = window.folder  # type: ignore[attr-defined]
    before = set(folder.glob("*.png"))
    window.ask("setattr(w, 'notice', type(w.notice)())")
    window.key("F2")
    window.until("'screenshot saved' in w.notice.text")
    (made,) = set(folder.glob("*.png")) - before
    return np.asarray(Image.open(made))


@pytest.mark.thorough
def test_faults_begin_beside_the_button_of_the_panel(window: Driven) -> None:
    window.settle()
    beside = window.ask("w._chrome.covered") + 0.5 * window.ask("w.decor.view.font.height")
    assert beside >= window.ask("places['panel'][2]")


@pytest.mark.thorough
def test_panel_opens_switches_and_leaves_images_unchanged(window: Driven) -> None:
    window.tool("mousemove", SIZE[0] - 5, 5)
    window.settle()
    before = screenshot(window)
    window.click(*window.middle("panel"))
    window.until("w.shows_panel")
    window.until("w.decor.view.inset[0] > 150")  # numbers stay beside it
    assert np.array_equal(screenshot(window), before)
    window.click(*window.middle("Move lwr"))  # folded, so that all the others are seen
    window.until("w.folds == {'Move lwr/Move lwr': False}")
    window.click(*window.middle("axes"))
    window.until("not w.toggles.axes.any()")
    assert not np.array_equal(screenshot(window), before)
    window.click(*window.middle("axes"))
    window.until("w.toggles.axes.all()")
    camera = (
        "[w.navigator.camera.azimuth, w.navigator.camera.distance, "
        "w.world.joints.arrow_radius.max()]"
    )
    was = window.ask(camera)
    window.click(*window.middle("sizes"))
    x, y = window.middle("arrow radius")
    left, _, right, _ = window.ask("places['arrow radius']")
    assert right - left > 100
    window.tool("mousemove", round(left) + 20, round(y), "mousedown", 1)
    window.settle()
    window.tool("mousemove", round(left) + 10, round(y) + 60, "mousemove", round(left) + 20, 445)
    window.settle()
    window.tool("mouseup", 1, "click", 4)
    window.settle()
    azimuth, _, radius = window.ask(camera)
    assert radius < 0.6 * was[2]
    assert azimuth == was[0]  # the drag was the slider's, also beyond the panel
    window.tool("mousemove", round(x), round(y), "click", 4)
    window.settle()
    assert window.ask("w.navigator.camera.distance") == pytest.approx(was[1] * 0.9)  # not twice
    was_below = window.ask("places['axes'][1]")
    window.ask("w.show_layout({**w.layout, 'section Move lwr/Move lwr': True})")
    window.until(f"places['axes'][1] > {was_below} + 50")  # as it is restored
    window.click(*window.middle("Move lwr"))
    window.until(f"places['axes'][1] == {was_below}")
    window.key("Tab")
    window.until("not w.shows_panel")
    window.ask("w._robots._reset()")
    window.ask("w.navigator.choose(0)[:0]")
    window.settle()
    assert np.array_equal(screenshot(window), before)
    window.key("Tab")
    window.until("w.shows_panel")
    # Keys that are no text are actions as ever, and the rest of the window turns the view.
    window.key("a")
    window.until("w.toggles.arrows.all()")
    window.tool("mousemove", SIZE[0] - 80, 240, "mousedown", 1, "mousemove", SIZE[0] - 150, 240)
    window.tool("mousemove", SIZE[0] - 200, 240, "mouseup", 1)
    window.until(f"w.navigator.camera.azimuth != {was[0]}")


@pytest.mark.thorough
def test_images_and_videos_without_a_window_load_no_panel() -> None:
    code = "import sys, sero_mj.cli, sero_mj.viewer.image.render, sero_mj.viewer.window.host\n"
    code += "print('imgui_bundle' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "False"
