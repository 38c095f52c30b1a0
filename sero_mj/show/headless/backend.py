"""Chooses the OpenGL backend for pictures without a window.

MuJoCo takes the backend from `MUJOCO_GL` when it is imported. Nothing here loads a graphics
driver: Mesa's brings its own LLVM, and a process in which torch has loaded another one ends.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

BACKENDS = ("egl", "osmesa", "glfw")
# What a Debian or Ubuntu machine needs for software rendering with each backend.
PACKAGES = {
    "egl": "libegl1 libgl1 libgl1-mesa-dri",
    "osmesa": "libosmesa6",
    "glfw": "libgl1 libgl1-mesa-dri, and a display (xvfb has one)",
}
# Where drivers tell libglvnd's EGL of themselves.
_EGL_DRIVERS = (Path("/etc/glvnd/egl_vendor.d"), Path("/usr/share/glvnd/egl_vendor.d"))


def choose_backend() -> str | None:
    """Sets `MUJOCO_GL` to what should work here, unless the user has set it.

    Returns:
        the backend in force; None where MuJoCo's own choice is right (macOS, Windows).
    """
    if os.environ.get("MUJOCO_GL") or "mujoco" in sys.modules or sys.platform != "linux":
        return os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = backend = _headless_backend()
    return backend


def adopt_backend() -> None:
    """Gives MuJoCo a backend that needs no display, where it was imported without one.

    To be called before the first picture. A user who imports mujoco before sero_mj on a server
    has GLFW's backend, which cannot work there; `MUJOCO_GL` that the user has set is respected.
    """
    if os.environ.get("MUJOCO_GL") or has_display() or _headless_backend() != "egl":
        return
    from mujoco.egl import GLContext
    from mujoco.rendering.classic import gl_context

    # MuJoCo 4.0.0 has no public way to change it; `Renderer` reads this name for every context.
    gl_context.GLContext = GLContext


def has_display() -> bool:
    """Whether there is a screen to open a window on."""
    if sys.platform != "linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _headless_backend() -> str:
    # EGL is also what the error should be about when neither is there.
    return "osmesa" if not egl_is_there() and osmesa_is_there() else "egl"


def egl_is_there() -> bool:
    """Whether EGL, OpenGL and a driver for them are installed; `doctor` tries whether they work."""
    libraries = _libraries()
    # PyOpenGL looks GL's own functions up in one of these two, beside EGL.
    has_gl = "libOpenGL.so.0" in libraries or "libGL.so.1" in libraries
    named = os.environ.get("__EGL_VENDOR_LIBRARY_FILENAMES")
    has_driver = bool(named) or any(any(folder.glob("*.json")) for folder in _EGL_DRIVERS)
    return "libEGL.so.1" in libraries and has_gl and has_driver


def osmesa_is_there() -> bool:
    """Whether the off-screen Mesa library is installed."""
    return any(name.startswith("libOSMesa.so") for name in _libraries())


@cache
def _libraries() -> frozenset[str]:
    """File names of the shared libraries that the loader knows; empty where it does not say."""
    try:
        listing = subprocess.run(
            ["ldconfig", "-p"],
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PATH": f"{os.environ.get('PATH', '')}:/sbin:/usr/sbin"},
        ).stdout
    except OSError:
        return frozenset()
    return frozenset(line.split()[0] for line in listing.splitlines()[1:] if line.strip())
