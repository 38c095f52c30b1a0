"""Selects the OpenGL backend for rendering without a window.

MuJoCo reads the backend from `MUJOCO_GL` when it is imported. The graphics driver is loaded only
for the first image, because the Mesa driver loads LLVM. If PyTorch loads another version of LLVM,
the process ends.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import os
import subprocess
import sys
import types
from functools import cache, partial
from pathlib import Path
from typing import Any

from ...base.errors import Problem, RenderError

BACKENDS = ("egl", "osmesa", "glfw")
# Other values of `MUJOCO_GL` that MuJoCo accepts on Linux.
_DISABLED = ("disable", "disabled", "off", "false", "0")
_DEFAULT = ("enable", "enabled", "on", "true", "1", "glx")
# Debian and Ubuntu packages for software rendering with each backend.
PACKAGES = {
    "egl": "libegl1 libgl1 libgl1-mesa-dri",
    "osmesa": "libosmesa6",
    "glfw": "libgl1 libgl1-mesa-dri, and a display (xvfb has one)",
}
_NEEDS = {
    "egl": "needs EGL, OpenGL and a driver, of which at least one is not installed",
    "osmesa": "needs libOSMesa, which is not installed",
}
_LAZY = ("egl", "osmesa")
# Folders in which drivers are registered for the EGL library of libglvnd.
_EGL_DRIVERS = (Path("/etc/glvnd/egl_vendor.d"), Path("/usr/share/glvnd/egl_vendor.d"))


def choose_backend() -> str | None:
    """Sets `MUJOCO_GL` to a backend that should work, unless the user has set it.

    Returns:
        name of the backend, or None for the default of MuJoCo (macOS and Windows).
    """
    backend = os.environ.get("MUJOCO_GL")
    if "mujoco" in sys.modules or sys.platform != "linux":
        return backend
    os.environ["MUJOCO_GL"] = backend = backend or _headless_backend()
    name = backend.lower().strip()
    if name in _LAZY:
        sys.meta_path.insert(0, _LazyFinder(f"mujoco.{name}"))
    return backend


def check_backend() -> None:
    """Raises RenderError if MuJoCo cannot be imported with the value of `MUJOCO_GL`."""
    chosen = os.environ.get("MUJOCO_GL", "")
    known = ("", *BACKENDS, *_DISABLED, *_DEFAULT)
    if sys.platform == "linux" and chosen.lower().strip() not in known:
        expected = f"{', '.join(BACKENDS)} or disable"
        raise RenderError(Problem("MUJOCO_GL", found=chosen, expected=expected))


def backend_problem() -> str:
    """Returns why the selected backend cannot render, with a remedy; empty if it can render."""
    chosen = os.environ.get("MUJOCO_GL", "")
    name = chosen.lower().strip()
    if sys.platform != "linux" or not name:  # without a name, `adopt_backend` selects the backend
        return ""
    usable = {"egl": has_egl(), "osmesa": has_osmesa(), "glfw": has_display()}
    if name in _DISABLED:
        why = "turns OpenGL off"
    elif usable.get(name, name in _DEFAULT and has_display()):
        return ""
    else:
        why = _NEEDS.get(name, "needs a display, but there is none")
    other = next((each for each, is_usable in usable.items() if is_usable), None)
    hint = f"MUJOCO_GL={other} works here" if other else f"install {PACKAGES['egl']}"
    return f"MUJOCO_GL={chosen} {why}; {hint}"


class _LazyBackend(types.ModuleType):
    """Placeholder for the module `mujoco.egl` or `mujoco.osmesa` until a context is created.

    MuJoCo 4.0.0 imports one of these modules together with `mujoco`. The import of `mujoco.egl`
    queries the EGL devices, and Mesa 25 (Debian 13) then loads the driver. If libOSMesa is missing,
    `mujoco.osmesa` cannot be imported, so that even commands that draw nothing would fail.
    """

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # requested by the import system
            raise AttributeError(name)
        if name == "GLContext":
            return partial(_make_context, self.__name__)
        return getattr(_real(self.__name__), name)


class _LazyFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def __init__(self, name: str) -> None:
        self._name = name

    def find_spec(
        self, fullname: str, path: object, target: object = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self._name:
            return None
        sys.meta_path.remove(self)
        return importlib.machinery.ModuleSpec(fullname, self)

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> types.ModuleType:
        return _LazyBackend(spec.name)

    def exec_module(self, module: types.ModuleType) -> None: ...


def _real(name: str) -> Any:
    import mujoco

    if isinstance(sys.modules.get(name), _LazyBackend):
        del sys.modules[name]
        delattr(mujoco, name.removeprefix("mujoco."))
    if name == "mujoco.egl":
        from mujoco import egl

        return egl
    from mujoco import osmesa

    return osmesa


def _make_context(module: str, *size: int) -> Any:
    return _real(module).GLContext(*size)


def adopt_backend() -> None:
    """Changes the backend of MuJoCo to one that needs no display, if there is no display.

    Call this before the first image. If mujoco is imported before sero_mj on a server, it selects
    the GLFW backend, which needs a display. If the user has set `MUJOCO_GL`, nothing changes.

    If an image with the GLFW backend has already failed, MuJoCo 4.0.0 would end the process (status
    134) at the next image. In this case, each image raises a RenderError instead.
    """
    if os.environ.get("MUJOCO_GL") or has_display() or _headless_backend() != "egl":
        return
    from mujoco.rendering.classic import gl_context

    # MuJoCo 4.0.0 has no public function for this. `Renderer` reads this name for each context.
    if gl_context.GLContext is not _refuse_context:
        make = partial(_make_context, "mujoco.egl")
        gl_context.GLContext = _refuse_context if _has_glfw_failed() else make


def _has_glfw_failed() -> bool:
    if "glfw" not in sys.modules:
        return False
    import glfw

    return bool(glfw.get_error()[0] == glfw.NOT_INITIALIZED)


def _refuse_context(*_: int) -> None:
    raise RenderError(
        "a mujoco.Renderer has failed in this process because there is no display, and MuJoCo "
        "would end the process: import sero_mj before mujoco, or set MUJOCO_GL=egl"
    )


def has_display() -> bool:
    """Returns whether a display is available, so that windows can be opened."""
    if sys.platform != "linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _headless_backend() -> str:
    # EGL is the default if no backend is installed, so that errors refer to EGL.
    return "osmesa" if not has_egl() and has_osmesa() else "egl"


def has_egl() -> bool:
    """Returns whether EGL, OpenGL and a driver are installed, without testing whether they work."""
    libraries = _libraries()
    # PyOpenGL loads GL functions from one of these two libraries.
    has_gl = "libOpenGL.so.0" in libraries or "libGL.so.1" in libraries
    named = os.environ.get("__EGL_VENDOR_LIBRARY_FILENAMES")
    has_driver = bool(named) or any(any(folder.glob("*.json")) for folder in _EGL_DRIVERS)
    return "libEGL.so.1" in libraries and has_gl and has_driver


def has_osmesa() -> bool:
    """Returns whether the off-screen Mesa library is installed."""
    return any(name.startswith("libOSMesa.so") for name in _libraries())


def library_files(name: str) -> list[str]:
    """Returns the paths of installed shared libraries whose file names start with `name`."""
    return sorted(path for file, path in _libraries().items() if file.startswith(name))


@cache
def _libraries() -> dict[str, str]:
    try:
        listing = subprocess.run(
            ["ldconfig", "-p"],
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "PATH": f"{os.environ.get('PATH', '')}:/sbin:/usr/sbin"},
        ).stdout
    except OSError:
        return {}
    lines = [line.split() for line in listing.splitlines()[1:] if line.strip()]
    return {words[0]: words[-1] for words in reversed(lines)}  # first entry if a name is repeated
