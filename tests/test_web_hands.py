"""Robots that are moved on a page, in a real browser: by sliders, links and handles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from polling import until
from web_tools import MISSING, POSE, Served, Visitor

pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(300),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]
CAMERA = "w.view_state().camera"


@pytest.mark.thorough
def test_sliders_links_and_the_clipboard(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr", settings=(POSE,)) as served:
        visitor = Visitor(browser, served, size=(1000, 640))
        page = visitor.page
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        slider = page.get_by_role("slider", name="A2", exact=True)
        slider.fill("-24")
        served.until("abs(w.data.qpos[1] - np.deg2rad(-24)) < 1e-3")
        page.get_by_role("button", name="home").click()
        served.until("abs(w.data.qpos[1] - 0.6) < 1e-9")
        field = page.get_by_role("textbox", name="A2 typed")
        field.fill("30")
        field.press("Enter")
        served.until("abs(w.data.qpos[1] - np.deg2rad(30)) < 1e-9")
        page.get_by_role("button", name="home").click()
        page.get_by_text("copy the pose").click()
        page.get_by_role("button", name="command").click()
        wanted = "sero-mj view lwr --set lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0\n"
        assert until(lambda: page.evaluate("navigator.clipboard.readText()") == wanted)
        seen = served.ask(CAMERA)
        x, y = visitor.joint(3)
        page.mouse.move(x, y)
        page.keyboard.down("Control")
        page.mouse.down()
        page.mouse.move(x + 30, y + 10, steps=3)
        served.until("w.tools['jogging'].is_on")
        served.until("np.abs(w.data.qpos - [0, 0.6, 0, -1.2, 0, 0.8, 0]).max() > 0.05")
        page.mouse.up()
        page.keyboard.up("Control")
        served.until("not w.tools['jogging'].is_on")
        assert served.ask(CAMERA) == seen
        visitor.close()


@pytest.mark.thorough
def test_handle_moves_the_target_and_the_robot_follows(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr", settings=(POSE,), control="joint") as served:
        visitor = Visitor(browser, served)
        page = visitor.page
        served.until("w.toggles.handles is not None and w.clock.time > 0.2")
        seen = served.ask(CAMERA)
        served.ask("globals().update(start=w.toggles.handles.pose.copy())")
        x, y, height = served.ask(
            "[*w.decor.view.project(start[:3, 3])[0].tolist(), w.decor.view.height]"
        )
        y = height - y
        page.mouse.move(x, y)  # the cube
        served.until("w.toggles.handles.lit == 6")
        page.wait_for_function("() => player.now.onHandle")
        page.mouse.down()
        page.mouse.move(x + 30, y - 20, steps=4)
        goal = "w.tools['steering'].goals['lwr'].flange(np.eye(4))"
        served.until(f"np.abs({goal} - start)[:3, 3].max() > 0.03")
        page.mouse.up()
        served.until("not w.tools['steering'].is_on")
        served.until(f"np.abs(w.world.frame(w.data, 'lwr/flange') - {goal}).max() < 5e-3")
        assert served.ask(CAMERA) == seen
        visitor.close()


@pytest.mark.thorough
def test_long_press_pulls_and_two_fingers_zoom(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "impedance_push", settings=("run.duration=100",)) as served:
        visitor = Visitor(browser, served, has_touch=True)
        served.until("w.clock.time > 0.1")
        seen = served.ask(CAMERA)
        touch = visitor.finger(*visitor.joint(3))
        touch("touchStart", 0)
        served.until("w.notice.text == 'drag to pull lwr/link4'")
        for by in (10, 20, 45):
            touch("touchMove", by)
        served.until("w.tools['pulling'].is_on")
        touch("touchEnd")
        served.until("not w.tools['pulling'].is_on and len(w.tools['pulling']._force.pulls) == 1")
        assert served.ask(CAMERA) == seen
        assert served.ask("clicks") == []
        visitor.until("!player.now.dragging")
        far = served.ask("w.navigator.camera.distance")
        touch("touchStart", -30)
        touch("touchStart", -30, 30)
        for half in (36, 42, 48, 54, 60):
            touch("touchMove", -half, half)
        touch("touchEnd")
        served.until(f"w.navigator.camera.distance < {0.8 * far}")
        assert served.ask("clicks") == []
        touch = visitor.finger(*visitor.joint(1))
        touch("touchStart", 0)
        touch("touchEnd")
        served.until("clicks")
        assert [gesture for gesture, _ in served.ask("clicks")] == ["click"]
        assert np.isfinite(served.ask("w.navigator.camera.distance"))
        visitor.close()
