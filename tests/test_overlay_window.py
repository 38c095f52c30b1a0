"""`view(overlay)`: our window beside a loop that steps its own model."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import sampled
from foreign_models import arm
from window_tools import MISSING, screen

import sero_mj
from sero_mj.data.drive.mirror import Watch
from sero_mj.viewer.session.clock import Clock

SCRIPT = """
import sys
sys.path.insert(0, {folder!r})
import mujoco
import sero_mj
from foreign_models import arm
from sero_mj.data.drive.mirror import Watch
from sero_mj.viewer.window.host import Window

model, data = arm()
size = model.vis.global_.offwidth, model.vis.global_.offheight
overlay = sero_mj.overlay(model, data, doubles=[sero_mj.Double(name="goal", of="arm")])
overlay.set("goal.joint_angles", [1.5, 0.8, 0.5, 0.0])
watch = Watch(overlay.world)
with Window(watch, size=(640, 480)) as window:
    assert (model.vis.global_.offwidth, model.vis.global_.offheight) == size
    for _ in range(20):
        mujoco.mj_step(model, data)
    assert window.frame()
    assert watch.data.time == data.time > 0.03
    window.clock.pause()
    held = watch.data.qpos.copy()
    for _ in range(20):
        mujoco.mj_step(model, data)
    assert window.frame()
    assert (watch.data.qpos == held).all() and not (data.qpos == held).all()
    window.clock.pause()
    window.frame()
    assert (watch.data.qpos == data.qpos).all()
    at = window.decor.view.project(watch.data.geom("upper").xpos)[0]
    picked = window.decor.pick(watch.data, at)
    assert picked.owner in ("arm", "goal"), picked
    window.tools["plot"].shows_area = True
    window.frame()
    assert "follows" in window.navigator.follow(watch.data, "arm/fore")
    window.frame()
print("well")
"""


LOOP = """
import sys
sys.path.insert(0, {folder!r})
import mujoco, numpy as np
import sero_mj
from foreign_models import arm
from sero_mj.viewer.image.camera import find_camera

model, data = arm()
goal, twin = (sero_mj.Double(name=name, of="arm") for name in ("goal", "twin"))
overlay = sero_mj.overlay(model, data, doubles=[goal, twin])
camera = find_camera(overlay.world)  # that of the window, which stands still
with sero_mj.view(overlay, size=(640, 480)) as viewer:
    assert viewer.data is data
    first = viewer.image()
    size = first.shape[1::-1]
    assert np.abs(first.astype(int) - overlay.image(*size, camera)).mean() < 0.5
    viewer.set("goal.joint_angles", [1.5, 0.8, 0.5, 0.0])
    second = viewer.image()
    assert np.abs(second.astype(int) - first).mean() > 0.5
    data.ctrl[:] = 1.0
    for _ in range(200):
        mujoco.mj_step(model, data)
        assert viewer.sync()
    # Torques of the drives, a double that was set behind the viewer's back, the pose, and the time.
    overlay.set("twin.joint_angles", [-1.0, 0.4, 0.2, 0.0])
    third = viewer.image()
    mujoco.mj_forward(model, data)
    expected = overlay.image(*size, camera)
    assert np.abs(third.astype(int) - second).mean() > 0.5
    assert np.abs(third.astype(int) - expected).mean() < 0.5
print("well")
"""


PASSIVE = """
import os, sys, time
sys.path.insert(0, {folder!r})
import mujoco.viewer
import sero_mj
from foreign_models import arm

model, data = arm()
overlay = sero_mj.overlay(model, data)
with mujoco.viewer.launch_passive(model, data) as viewer:
    counts = set()
    for _ in range(5):
        mujoco.mj_step(model, data)
        assert overlay.draw(viewer) == 0
        counts.add(viewer.user_scn.ngeom)
        viewer.sync()
        time.sleep(0.05)
    assert min(counts) > 50 and max(counts) < 500, counts
    assert overlay.view.width > 100
    print("well", flush=True)
    os._exit(0)  # closed, MuJoCo's viewer ends some processes here, with and without us (4.0.0)
"""


PAGE = """
import sys
sys.path.insert(0, {folder!r})
import mujoco
import sero_mj
from foreign_models import arm

model, data = arm()
overlay = sero_mj.overlay(model, data, doubles=[sero_mj.Double(name="goal", of="arm")])
with sero_mj.view(overlay, web=True) as viewer:
    for _ in range(5):
        mujoco.mj_step(model, data)
        assert viewer.sync()
    shown = viewer.image()
    viewer.set("goal.joint_angles", [1.5, 0.8, 0.5, 0.0])
    assert not (viewer.image() == shown).all()
print("well")
"""


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
@pytest.mark.parametrize(
    "text", sampled([SCRIPT, PASSIVE, LOOP, PAGE], 2), ids=["window", "MuJoCo's", "loop", "page"]
)
def test_window_or_page_shows_a_user_loop(tmp_path: Path, text: str) -> None:
    script = tmp_path / "loop.py"
    script.write_text(text.format(folder=str(Path(__file__).parent)))
    with screen() as display:
        environment = {**os.environ, "DISPLAY": display}
        environment.pop("MUJOCO_GL", None)
        done = subprocess.run(
            [sys.executable, str(script)],
            env=environment, capture_output=True, text=True, timeout=90, check=False,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("well\n")
    assert "double" not in done.stderr


def test_watched_data_is_a_copy_that_a_pause_freezes() -> None:
    model, data = arm()
    overlay = sero_mj.overlay(model, data)
    watch = Watch(overlay.world)
    clock = Clock(watch)
    assert clock.is_live and clock.end is None
    data.qpos[:4] = (0.1, 0.2, 0.3, 0.01)
    data.time = 3.0
    clock.advance(0.1)
    assert np.array_equal(watch.data.qpos, data.qpos) and watch.data.time == 3.0
    clock.pause()
    data.qpos[:4] = 0.0
    clock.advance(0.1)
    assert watch.data.qpos[:4] == pytest.approx([0.1, 0.2, 0.3, 0.01])
    clock.step()
    assert np.array_equal(watch.data.qpos, data.qpos)
    clock.reset()
    assert data.time == 3.0
