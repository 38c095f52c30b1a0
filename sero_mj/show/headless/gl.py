"""Chooses the OpenGL backend for pictures without a window, before `import mujoco` fixes it."""

from __future__ import annotations

import ctypes
import os
import sys

BACKENDS = ("egl", "osmesa", "glfw")
# What a Debian or Ubuntu machine needs for software rendering with each backend.
PACKAGES = {
    "egl": "libegl1 libgl1 libgl1-mesa-dri",
    "osmesa": "libosmesa6",
    "glfw": "libgl1 libgl1-mesa-dri, and a display (xvfb has one)",
}
_OSMESA_NAMES = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
_EGL_PLATFORM_DEVICE = 0x313F


def choose_backend() -> str | None:
    """Sets `MUJOCO_GL` to what works here, unless the user has set it.

    Returns:
        the backend in force; None where MuJoCo's own choice is right (macOS, Windows).
    """
    if os.environ.get("MUJOCO_GL") or "mujoco" in sys.modules or sys.platform != "linux":
        return os.environ.get("MUJOCO_GL")
    # EGL is also what the error should be about when neither is there.
    backend = "osmesa" if not egl_works() and osmesa_is_there() else "egl"
    os.environ["MUJOCO_GL"] = backend
    return backend


def egl_works() -> bool:
    """Whether an EGL device, hardware or software, can be initialised."""
    # PyOpenGL looks GL's own functions up in one of these two, beside EGL.
    if not (_can_load("libEGL.so.1") and (_can_load("libOpenGL.so.0") or _can_load("libGL.so.1"))):
        return False
    egl = ctypes.CDLL("libEGL.so.1")
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    egl.eglGetProcAddress.restype = pointer
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    query = egl.eglGetProcAddress(b"eglQueryDevicesEXT")
    display_of = egl.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not query or not display_of:
        return False
    devices, count = (pointer * 16)(), integer()
    query_devices = ctypes.CFUNCTYPE(ctypes.c_uint, integer, ctypes.POINTER(pointer), pointer)(
        query
    )
    if not query_devices(16, devices, ctypes.byref(count)):
        return False
    get_display = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(display_of)
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    for device in devices[: count.value]:
        display = get_display(_EGL_PLATFORM_DEVICE, device, None)
        if display and egl.eglInitialize(display, None, None):
            return True
    return False


def osmesa_is_there() -> bool:
    """Whether the off-screen Mesa library can be loaded."""
    return any(_can_load(name) for name in _OSMESA_NAMES)


def _can_load(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
