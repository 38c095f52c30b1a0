"""Robots that are moved on a page, in a real browser: by sliders, by their links."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from web_tools import MISSING, POSE, Served, Visitor

pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(300),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]


@pytest.mark.thorough
def test_sliders_links_and_the_clipboard(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr", settings=(POSE,)) as served:
        visitor = Visitor(browser, served, size=(560, 640))
        visitor.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        visitor.hears("First remote draw frame applied")
        left, top, right, bottom = served.until("places.get('##A2')")
        y = (top + bottom) / 2
        visitor.move(left + 0.6 * (right - left), y)
        visitor.hold()
        visitor.move(left + 0.4 * (right - left), y)
        served.until("w.data.qpos[1] < -0.3")
        assert served.ask("w.data.qpos[1]") == pytest.approx(np.deg2rad(-24), abs=0.15)
        visitor.release()
        visitor.click(*served.middle("home"))
        served.until("abs(w.data.qpos[1] - 0.6) < 1e-9")
        visitor.click(*served.middle("copy the pose"))
        visitor.click(*served.middle("command"))
        visitor.page.wait_for_function(
            "async () => (await navigator.clipboard.readText()).startsWith('sero-mj view lwr --')"
        )
        copied = visitor.page.evaluate("navigator.clipboard.readText()")
        assert copied == "sero-mj view lwr --set lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0\n"
        served.ask("setattr(w, 'shows_status', False)")  # it would cover the robot
        served.settle()
        camera = "[w.viewer.camera.azimuth, w.viewer.camera.distance]"
        seen = served.ask(camera)
        x, y = served.joint(3)
        visitor.move(x, y)
        visitor.page.keyboard.down("Control")
        served.settle()
        visitor.hold()
        visitor.page.mouse.move(x + 30, y + 10, steps=3)
        served.until("w.tools['jogging'].is_on")
        served.until("np.abs(w.data.qpos - [0, 0.6, 0, -1.2, 0, 0.8, 0]).max() > 0.05")
        visitor.release()
        visitor.page.keyboard.up("Control")
        served.until("not w.tools['jogging'].is_on")
        assert served.ask(camera) == seen
        visitor.close()


def test_a_handle_moves_the_target_and_the_robot_follows(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr", settings=(POSE,), control="joint") as served:
        served.ask("setattr(w, 'shows_status', False)")  # it would cover the robot
        visitor = Visitor(browser, served)
        visitor.hears("First remote draw frame applied")
        served.until("w.toggles.handles is not None and w.clock.time > 0.2")
        served.settle()
        camera = "[w.viewer.camera.azimuth, w.viewer.camera.elevation]"
        seen = served.ask(camera)
        served.ask("globals().update(start=w.toggles.handles.pose.copy())")
        x, y, height = served.ask(
            "[*w.decor.view.project(start[:3, 3])[0].tolist(), w.decor.view.height]"
        )
        y = height - y
        visitor.move(x, y)  # the cube
        served.until("w.toggles.handles.lit == 6")
        visitor.hold()
        visitor.page.mouse.move(x + 30, y - 20, steps=4)
        goal = "w.tools['steering'].goals['lwr'].flange(np.eye(4))"
        served.until(f"np.abs({goal} - start)[:3, 3].max() > 0.03")
        visitor.release()
        served.until("not w.tools['steering'].is_on")
        served.until(f"np.abs(w.world.frame(w.data, 'lwr/flange') - {goal}).max() < 5e-3")
        assert served.ask(camera) == seen
        visitor.close()
