"""How large the buffer for pictures without a window is made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco


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
