"""How large pictures and windows may be, and the buffer for pictures without a window is made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

from ...errors import RenderError

MAX_SIDE = 16384  # pixels; what the software GL of Mesa allows


def check_size(what: str, width: int, height: int) -> None:
    """Raises RenderError where a picture or a window of that size, pixels, cannot be."""
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise RenderError(f"{what} size {width}x{height}: expected 1 to {MAX_SIDE} a side")


@contextmanager
def offscreen_size(model: mujoco.MjModel, width: int, height: int) -> Iterator[None]:
    """Has OpenGL contexts that are made meanwhile draw pictures of that size (pixels).

    MuJoCo reads the size from the model; afterwards the model is what it was, for it may be the
    user's.
    """
    size = model.vis.global_
    before = size.offwidth, size.offheight
    size.offwidth, size.offheight = width, height
    try:
        yield
    finally:
        size.offwidth, size.offheight = before
