"""A simulated robot controlled in a window: handles, sliders, pushes, the simulate button."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from window_tools import MISSING, SIZE, Driven, screen

pytestmark = [
    pytest.mark.gl,
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]

_SETTINGS = ("lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0",)
_PLACE = "[*w.decor.view.project(np.array({0}))[0].tolist(), w.decor.rect.bottom]"


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    with screen() as name:
        yield name


def pixel(window: Driven, point: str) -> tuple[int, int]:
    x, y, bottom = window.ask(_PLACE.format(point))
    return round(x), round(SIZE[1] - bottom - y)


@pytest.mark.thorough
def test_dragged_handle_moves_the_target_and_the_robot_follows(
    display: str, tmp_path: Path
) -> None:
    options = {"settings": _SETTINGS, "control": "cartesian"}
    with Driven(display, tmp_path, "lwr", **options) as window:
        window.until("w.toggles.handles is not None and w.clock.time > 0.2")
        # The arrow along the flange's z axis, which points down.
        window.ask("globals().update(start=w.toggles.handles.pose.copy())")
        unit = "__import__('sero_mj.viewer.decor.handles', fromlist=['x']).handle_length"
        tip = f"start[:3, 3] + 5.5 * {unit}(start[:3, 3], w.decor.view) * start[:3, 2]"
        x, y = pixel(window, tip)
        camera = "[w.navigator.camera.azimuth, w.navigator.camera.elevation]"
        seen = window.ask(camera)
        window.tool("mousemove", x, y)
        window.until("w.toggles.handles.lit == 2")
        to = pixel(window, f"{tip} - 0.06 * start[:3, 2]")
        window.tool("mousedown", 1)
        window.settle()
        window.tool("mousemove", (x + to[0]) // 2, (y + to[1]) // 2, "mousemove", *to)
        window.until(
            "abs(w.tools['steering'].goals['lwr'].flange(np.eye(4))[2, 3] - start[2, 3]) > 0.04"
        )
        window.settle()
        window.tool("mouseup", 1)
        moved = "(w.tools['steering'].goals['lwr'].flange(np.eye(4)) - start)[:3, 3]"
        way = np.array(window.ask(moved))
        along = np.array(window.ask("start[:3, 2]"))
        assert way @ along == pytest.approx(-0.06, abs=0.01)  # of a pixel or two
        assert np.linalg.norm(way - (way @ along) * along) < 3e-3
        assert window.ask(camera) == seen
        error = (
            "np.abs(w.world.frame(w.data, 'lwr/flange')[:3, 3]"
            " - w.tools['steering'].goals['lwr'].flange(np.eye(4))[:3, 3]).max()"
        )
        window.until(f"{error} < 2e-3")
        # While holding its target it is pulled and yields like its springs.
        window.tool("mousemove", *pixel(window, "w.data.xpos[w.world.robots['lwr'].bodies[4]]"))
        window.tool("keydown", "ctrl", "mousedown", 1, "mousemove_relative", 50, 20)
        window.until("w.tools['pulling'].is_on")
        window.until("np.linalg.norm(w.tools['pulling']._force.force) > 10")
        window.tool("mouseup", 1, "keyup", "ctrl")
        window.until("not w.tools['pulling'].is_on")
        # The panel changes the controller; End returns from the past.
        window.key("Tab")
        window.until("w.shows_panel")
        assert window.ask("w.tools['steering']._toggles.handles is not None")
        left, *_ = window.until("places.get('rotational')")
        _, y = window.middle("rotational")
        before = window.ask("w.tools['steering'].robots['lwr'].controller.stiffness[3, 3]")
        window.tool("mousemove", round(left) + 12, round(y), "mousedown", 1)
        window.settle()
        window.tool("mouseup", 1)
        window.until(
            f"w.tools['steering'].robots['lwr'].controller.stiffness[3, 3] < {before} - 20"
        )
        window.ask("w.clock.seek(0.1)")
        window.until("w.tools['steering'].is_past and w.toggles.handles is None")
        window.key("End")
        window.until("not w.tools['steering'].is_past")
        assert window.ask("w.tools['steering'].error") == ""


@pytest.mark.thorough
def test_simulate_button_starts_from_the_shown_pose(display: str, tmp_path: Path) -> None:
    environment = {**os.environ, "DISPLAY": display, "PYTHONPATH": str(ROOT)}
    environment.pop("WAYLAND_DISPLAY", None)
    program = """
import sys
import numpy as np
from sero_mj.cli import main
from sero_mj.viewer.window import host
shown = []
frame = host.Window.frame
def framed(window, **options):
    frames = window.frames = getattr(window, "frames", 0) + 1
    if frames == 1:
        shown.append(window)
        print(len(shown), [*window.others.offers], window.data.qpos.round(3).tolist(), flush=True)
    if frames == 2 and len(shown) == 1:
        window.tools['jogging'].goals["lwr"].set_all(np.array([0.5, 0.5, 0, -1, 0, 0.5, 0]))
    if frames > 3 and len(shown) == 1 and abs(window.data.qpos[0] - 0.5) < 1e-9:
        window.navigator.camera.distance = 1.25
        window.toggles.billboards[:7] = True
        window.others.take("simulate")
    if frames == 12 and len(shown) == 2:
        print(window.navigator.camera.distance, window.tools['steering'].robots["lwr"].control,
              window.toggles.arrows[:7].all(), window.toggles.billboards[:7].all(), flush=True)
        window.others.take("end the simulation")
    if frames == 3 and len(shown) == 3:
        window.gl.request_close()
    return frame(window, **options)
host.Window.frame = framed
sys.exit(main(["view", "lwr", "--window", "--size", "320x240"]))
"""
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, cwd=tmp_path, timeout=60,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "1 ['start page', 'simulate'] [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]",
        "2 ['start page', 'end the simulation'] [0.5, 0.5, 0.0, -1.0, 0.0, 0.5, 0.0]",
        "1.25 joint_impedance True True",
        "3 ['start page', 'simulate'] [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]",
    ]
