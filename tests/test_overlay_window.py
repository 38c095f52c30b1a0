"""`view(overlay)`: our window beside a loop that steps a model of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from foreign_models import arm
from window_tools import MISSING, screen

import sero_mj
from sero_mj.drive.mirror import Watch
from sero_mj.show.clock import Clock

SCRIPT = """
import sys
sys.path.insert(0, {folder!r})
import mujoco, numpy as np
import sero_mj
from foreign_models import arm

model, data = arm()
size = model.vis.global_.offwidth, model.vis.global_.offheight
overlay = sero_mj.overlay(model, data, doubles=[sero_mj.Double(name="goal", of="arm")])
with sero_mj.view(overlay, size=(640, 480)) as viewer:
    assert (model.vis.global_.offwidth, model.vis.global_.offheight) == size
    clicks = []
    viewer.on_click(lambda picked, gesture: clicks.append(picked))
    first = viewer.picture()
    viewer.set("goal.joint_angles", [1.5, 0.8, 0.5, 0.0])
    for _ in range(200):
        mujoco.mj_step(model, data)
        assert viewer.sync()
    assert viewer.host.frame()
    assert data.time > 0.3 and viewer.data.time == data.time
    assert np.abs(viewer.picture().astype(int) - first).mean() > 0.5
    window = viewer.host
    window.clock.pause()
    held = viewer.data.qpos.copy()
    for _ in range(20):
        mujoco.mj_step(model, data)
    assert window.frame()
    assert (viewer.data.qpos == held).all() and not (data.qpos == held).all()
    window.clock.pause()
    window.frame()
    assert (viewer.data.qpos == data.qpos).all()
    at = window.decor.view.project(viewer.data.geom("upper").xpos)[0]
    picked = window.decor.pick(viewer.data, at)
    assert picked.owner in ("arm", "goal"), picked
    window.shows_plot = True
    window.frame()
    assert "follows" in window.navigator.follow(viewer.data, "arm/fore")
    window.frame()
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
    assert not viewer.host.toggles.doubles.any()
    for _ in range(5):
        mujoco.mj_step(model, data)
        assert viewer.host.frame()
    assert viewer.data.time == data.time > 0
    assert viewer.host.decor.count > 50
print("well")
"""


@pytest.mark.gl
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
@pytest.mark.parametrize("text", [SCRIPT, PASSIVE, PAGE], ids=["ours", "MuJoCo's", "page"])
def test_a_host_shows_a_loop_of_the_users_own(tmp_path: Path, text: str) -> None:
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
    assert ("a page shows no doubles of an overlay" in done.stderr) == (text is PAGE)


def test_what_is_watched_is_a_copy_that_a_pause_holds_still() -> None:
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
