"""`sero_mj.view`: what it is given, before anything is opened."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import pytest

import sero_mj
from sero_mj import Scene, SerialRobot
from sero_mj.base.errors import SeroError, UsageError
from sero_mj.viewer.program.viewer import Viewer, _to_show


@pytest.mark.parametrize(
    ("scene", "options", "message"),
    [
        (5, {}, "scene: found int; expected a Scene, an overlay, a file, or the name of a scene"),
        (None, {}, "scene: found NoneType; expected a Scene"),
        ("lwr_upd", {}, "no scene or robot 'lwr_upd'; did you mean 'lwr_udp'?"),
        ("lwr", {"look": "drak"}, "look: found 'drak'; did you mean 'dark'?"),
        ("lwr", {"size": (9, 9)}, "size: found [9, 9]; it is for a window, and this is a page"),
        ("lwr", {"full_screen": True}, "full_screen: found true; it is for a window"),
        ("lwr", {"port": "80"}, "port '80': expected 1 to 65535"),
        ("lwr", {"camera": 5}, "camera: found 5; expected the name of a camera, or azimuth,"),
        ("lwr", {"web": False, "port": 8080}, "port: found 8080; only web pages have"),
        ("lwr", {"web": False, "host": "::"}, "host: found '::'; only web pages have"),
    ],
)
def test_unsupported_options_are_rejected(
    scene: Any, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(SeroError) as caught:
        sero_mj.view(scene, **{"web": True, **options})
    assert message in str(caught.value)


def test_robot_alone_is_rejected_as_scene() -> None:
    with pytest.raises(UsageError, match=r"found SerialRobot; .*; use Scene\(robots="):
        sero_mj.view(SerialRobot.from_model("lwr"), web=True)  # type: ignore[arg-type]


def test_look_option_does_not_change_the_user_scene() -> None:
    scene = Scene(robots=[SerialRobot.from_model("lwr")])
    for given in (scene, "lwr"):
        shown = _to_show(given, "dark")
        assert isinstance(shown, Scene) and shown.view.look == "dark"
    assert scene.view.look == "light"


def test_overlay_has_the_look_of_its_model() -> None:
    joint = '<body><joint axis="0 0 1"/><geom size=".1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{joint}</worldbody></mujoco>")
    overlay = sero_mj.overlay(model, mujoco.MjData(model))
    with pytest.raises(
        UsageError, match="look: found 'dark'; an overlay always has the look of its model"
    ):
        sero_mj.view(overlay, web=True, look="dark")


def test_callback_must_be_callable() -> None:
    with pytest.raises(UsageError, match=r"on_click: found int; expected callback\(picked, gest"):
        Viewer.on_click(None, 5)  # type: ignore[arg-type]


def test_interrupt_while_loading_prints_no_traceback(tmp_path: Path) -> None:
    # As if Ctrl+C came while a library is being imported.
    (tmp_path / "numpy.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    root = Path(sero_mj.__file__).parent.parent
    done = subprocess.run(
        [sys.executable, "-m", "sero_mj", "list"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}:{root}"},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert done.returncode == 130
    assert done.stderr == "sero-mj: interrupted\n"
