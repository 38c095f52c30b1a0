"""Whether there is a screen; a module of its own, for MuJoCo may not be imported to find out."""

from __future__ import annotations

import os
import sys


def has_display() -> bool:
    """Whether there is a screen to open a window on."""
    if sys.platform != "linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
