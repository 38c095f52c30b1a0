"""Limits of picture sizes, and the size of the offscreen buffer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

from ...errors import RenderError

MAX_SIDE = 16384  # pixels; the limit of Mesa's software renderer


def check_size(what: str, width: int, height: int) -> None:
    """Checks the size of a picture or window.

    Args:
        what: of what it is the size, for messages.
        width: pixels.
        height: pixels.

    Raises:
        RenderError: the size is out of range.
    """
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise RenderError(f"{what} size {width}x{height}: expected 1 to {MAX_SIDE} a side")


@contextmanager
def offscreen_size(model: mujoco.MjModel, width: int, height: int) -> Iterator[None]:
    """Sets the offscreen buffer size of the OpenGL contexts that are created in this context.

    MuJoCo reads the size from the model. The model is restored afterwards, since it may be the
    user's.

    Args:
        model: changed temporarily.
        width: pixels.
        height: pixels.
    """
    size = model.vis.global_
    before = size.offwidth, size.offheight
    size.offwidth, size.offheight = width, height
    try:
        yield
    finally:
        size.offwidth, size.offheight = before
