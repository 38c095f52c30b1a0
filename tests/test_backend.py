"""`MUJOCO_GL`: the error for backends that are unavailable, and what works without one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import raises_with

from sero_mj.base.errors import RenderError
from sero_mj.viewer.image import backend

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="MUJOCO_GL is chosen on Linux")


@pytest.fixture
def nothing_installed(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    for name in ("has_egl", "has_osmesa", "has_display"):
        monkeypatch.setattr(backend, name, lambda: False)
    return monkeypatch


@pytest.mark.parametrize(
    ("chosen", "there", "problem"),
    [
        ("osmesa", "has_egl", "MUJOCO_GL=osmesa needs libOSMesa, which is not installed; "
                              "MUJOCO_GL=egl works here"),
        ("Disable", "has_osmesa", "MUJOCO_GL=Disable turns OpenGL off; "
                                  "MUJOCO_GL=osmesa works here"),
        ("glfw", "has_egl", "MUJOCO_GL=glfw needs a display, but there is none; "
                            "MUJOCO_GL=egl works here"),
        ("1", "has_egl", "MUJOCO_GL=1 needs a display, but there is none; "
                         "MUJOCO_GL=egl works here"),
        ("egl", "", "MUJOCO_GL=egl needs EGL, OpenGL and a driver, of which at least one is not "
                    "installed; install libegl1 libgl1 libgl1-mesa-dri"),
        ("egl", "has_egl", ""),
        ("osmesa", "has_osmesa", ""),
        ("glfw", "has_display", ""),
    ],
)  # fmt: skip
def test_unavailable_backend_is_reported_with_an_available_one(
    nothing_installed: pytest.MonkeyPatch, chosen: str, there: str, problem: str
) -> None:
    nothing_installed.setenv("MUJOCO_GL", chosen)
    if there:
        nothing_installed.setattr(backend, there, lambda: True)
    assert backend.backend_problem() == problem


def test_unknown_mujoco_gl_value_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    for known in ("", "EGL ", "osmesa", "disabled", "on", "glx"):
        monkeypatch.setenv("MUJOCO_GL", known)
        backend.check_backend()
    monkeypatch.setenv("MUJOCO_GL", "eglx")
    with raises_with(RenderError, key="MUJOCO_GL", found="eglx"):
        backend.check_backend()


@pytest.mark.slow
@pytest.mark.skipif(backend.has_osmesa(), reason="libOSMesa is installed")
def test_only_commands_that_render_report_a_missing_backend(
    tmp_path: Path,
) -> None:
    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "sero_mj", *words]
        environment = {**os.environ, "MUJOCO_GL": "osmesa"}
        environment.pop("PYOPENGL_PLATFORM", None)
        return subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=60
        )

    assert run("check", "lwr").returncode == 0
    drawn = run("render", "lwr", "-o", str(tmp_path / "lwr.png"))
    assert drawn.returncode == 2
    (line,) = drawn.stderr.splitlines()
    assert "MUJOCO_GL=osmesa needs libOSMesa, which is not installed" in line
