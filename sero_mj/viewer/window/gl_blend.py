"""Draws pixels into the current OpenGL context."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import glfw

from ..image.image_files import Pixels
from ..image.typesetting import PlacedPanel

# The file gl.h defines these constants.
_ALL_ATTRIBUTES = 0x000FFFFF
_BLEND, _ONE, _ONE_MINUS_ALPHA = 0x0BE2, 1, 0x0303
# Depth test, 2D texture, fog, alpha test and scissor test.
_OFF = (0x0B71, 0x0DE1, 0x0B60, 0x0BC0, 0x0C11)
_RGB, _RGBA, _UNSIGNED_BYTE = 0x1907, 0x1908, 0x1401
_UNPACK_ALIGNMENT = 0x0CF5
_TEXTURE, _MIN_FILTER, _MAG_FILTER, _LINEAR = 0x0DE1, 0x2801, 0x2800, 0x2601


class Blender:
    """Draws text panels over the image of a window, or replaces the red channel of the image.

    The OpenGL functions come from GLFW, which provides them on every platform.
    """

    def __init__(self) -> None:
        integer, pointer = ctypes.c_int, ctypes.c_void_p
        self._push = _function("glPushAttrib", ctypes.c_uint)
        self._pop = _function("glPopAttrib")
        self._enable = _function("glEnable", ctypes.c_uint)
        self._disable = _function("glDisable", ctypes.c_uint)
        self._blend = _function("glBlendFunc", ctypes.c_uint, ctypes.c_uint)
        self._zoom = _function("glPixelZoom", ctypes.c_float, ctypes.c_float)
        self._mask = _function("glColorMask", *[ctypes.c_ubyte] * 4)
        self._store = _function("glPixelStorei", ctypes.c_uint, integer)
        self._go_to = _function("glWindowPos2i", integer, integer)
        self._draw = _function(
            "glDrawPixels", integer, integer, ctypes.c_uint, ctypes.c_uint, pointer
        )

    def draw_red(self, pixels: Pixels, left: int, bottom: int) -> None:
        """Replaces the red channel of the image in the window."""
        self._push(_ALL_ATTRIBUTES)
        for name in (*_OFF, _BLEND):
            self._disable(name)
        self._mask(True, False, False, False)
        self._store(_UNPACK_ALIGNMENT, 1)
        self._zoom(1.0, 1.0)
        self._go_to(left, bottom)
        self._draw(pixels.shape[1], pixels.shape[0], _RGB, _UNSIGNED_BYTE, pixels.ctypes.data)
        self._store(_UNPACK_ALIGNMENT, 4)
        self._pop()

    def draw(self, panels: Sequence[PlacedPanel], left: int = 0, bottom: int = 0) -> None:
        """Draws text panels over the image in the window."""
        self._push(_ALL_ATTRIBUTES)
        for name in _OFF:
            self._disable(name)
        self._enable(_BLEND)
        self._blend(_ONE, _ONE_MINUS_ALPHA)  # The colors are premultiplied by alpha.
        self._zoom(1.0, -1.0)  # The pixels begin with the top row.
        for placed in panels:
            height, width = placed.pixels.shape[:2]
            self._go_to(left + placed.left, bottom + placed.bottom + height)
            self._draw(width, height, _RGBA, _UNSIGNED_BYTE, placed.pixels.ctypes.data)
        self._pop()


def make_texture(pixels: Pixels) -> int:
    """Creates an OpenGL texture from pixels, shape (height, width, 3), uint8. Returns its name."""
    integer, unsigned = ctypes.c_int, ctypes.c_uint
    name = unsigned()
    _function("glGenTextures", integer, ctypes.c_void_p)(1, ctypes.addressof(name))
    _function("glBindTexture", unsigned, unsigned)(_TEXTURE, name)
    for filter_of in (_MIN_FILTER, _MAG_FILTER):
        _function("glTexParameteri", unsigned, unsigned, integer)(_TEXTURE, filter_of, _LINEAR)
    _function("glPixelStorei", unsigned, integer)(_UNPACK_ALIGNMENT, 1)
    height, width = pixels.shape[:2]
    upload = _function(
        "glTexImage2D", unsigned, *[integer] * 5, unsigned, unsigned, ctypes.c_void_p
    )
    upload(_TEXTURE, 0, _RGB, width, height, 0, _RGB, _UNSIGNED_BYTE, pixels.ctypes.data)
    _function("glPixelStorei", unsigned, integer)(_UNPACK_ALIGNMENT, 4)
    _function("glBindTexture", unsigned, unsigned)(_TEXTURE, 0)
    return int(name.value)


def _function(name: str, *arguments: Any) -> Callable[..., None]:
    address = ctypes.cast(glfw.get_proc_address(name), ctypes.c_void_p).value
    assert address is not None  # The functions belong to OpenGL 1.4, and MuJoCo needs 2.1.
    return ctypes.CFUNCTYPE(None, *arguments)(address)
