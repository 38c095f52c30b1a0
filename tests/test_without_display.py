"""A server: no display, no MUJOCO_GL, and possibly no dm_control."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

_LOADED = """
def loaded():
    with open("/proc/self/maps") as maps:
        names = {line.split("/")[-1].strip() for line in maps if "/" in line}
    return sorted(name for name in names if "LLVM" in name or "gallium" in name)
"""
_PICTURE = """
import sero_mj
world = sero_mj.World(sero_mj.Scene(robots=[sero_mj.SerialRobot(dh_convention="craig")]))
with sero_mj.HeadlessRenderer(world, 64, 48) as renderer:
    assert renderer.render(world.make_data()).std() > 1
"""
_OWN_RENDERER = """
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 2'/><geom size='.2' rgba='1 0 0 1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 48, 64) as renderer:
    renderer.update_scene(data)
    assert renderer.render()[24, 32, 0] > 40
"""


def run_on_server(code: str, folder: Path) -> str:
    """Runs Python like a user on a server and returns its output."""
    unset = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL", "PYOPENGL_PLATFORM")
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={key: value for key, value in os.environ.items() if key not in unset},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.parametrize(
    "code",
    [
        _PICTURE,
        f"import mujoco\n{_PICTURE}",
        f"import sero_mj\nimport mujoco\n{_OWN_RENDERER}",
        f"import sero_mj.robots.kinematics.dh\nimport mujoco\n{_OWN_RENDERER}",
    ],
    ids=["sero_mj alone", "mujoco first", "sero_mj first, own renderer", "a module of sero_mj"],
)
def test_images_are_rendered_regardless_of_the_import_order(code: str, tmp_path: Path) -> None:
    run_on_server(code, tmp_path)


@pytest.mark.gl
def test_user_renderer_works_with_an_overlay_if_mujoco_is_imported_first(
    tmp_path: Path,
) -> None:
    overlay = """
over = sero_mj.overlay(mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><body><joint/><geom size='.2'/></body></worldbody></mujoco>"))
"""
    run_on_server(f"import mujoco\nimport sero_mj\n{overlay}{_OWN_RENDERER}", tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_no_graphics_driver_is_loaded_before_an_image(tmp_path: Path) -> None:
    # Mesa includes an LLVM; a process that also loads torch's LLVM crashes.
    code = f"""{_LOADED}
import sero_mj
environment = sero_mj.make_environment("lwr/reach")
environment.reset()
print(loaded())
"""
    assert run_on_server(code, tmp_path) == "[]\n"


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.slow
def test_demo_simulation_and_environment_need_no_dm_control(tmp_path: Path) -> None:
    code = """
import sys
sys.modules["dm_control"] = sys.modules["labmaze"] = None  # as where they are not installed
from sero_mj.cli import main
def run(*arguments):
    try:
        main(arguments)
    except SystemExit as end:
        assert not end.code, (arguments, end.code)
run("demo", "--duration", "0.3", "--size", "320x200")
run("simulate", "hand_guiding")
import sero_mj
environment = sero_mj.make_environment("lwr/reach")
environment.reset()
assert environment.step(environment.action_spec().generate_value()).observation
assert not [name for name in sys.modules if name.startswith("dm_control.")]
"""
    run_on_server(code, tmp_path)
    assert (tmp_path / "out" / "lwr.mp4").stat().st_size > 3000


@pytest.mark.thorough
@pytest.mark.gl
def test_image_after_a_failed_mujoco_renderer_is_rejected(tmp_path: Path) -> None:
    """MuJoCo itself would end the process (134)."""
    code = """
import warnings
warnings.simplefilter("ignore")
import mujoco
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><body><joint/><geom size='.2'/></body></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
try:
    mujoco.Renderer(model)
except mujoco.FatalError:
    print("failed")
import sero_mj
from sero_mj.base.errors import RenderError
for _ in range(2):
    try:
        sero_mj.overlay(model, data).image()
    except RenderError as error:
        print(error)
"""
    failed, first, second = run_on_server(code, tmp_path).splitlines()
    assert failed == "failed" and first == second
    assert "import sero_mj before mujoco, or set MUJOCO_GL=egl" in first
