"""What is under the pointer, written beside it."""

from __future__ import annotations

import numpy as np

from .panels import Panels, labels_at, panel_sizes
from .toggles import Toggles
from .view import View

_BESIDE = 0.6  # of a line's height
_RGBA = (0.20, 0.20, 0.16, 0.90)


def hover_panel(toggles: Toggles, view: View) -> Panels | None:
    """Returns the panel beside the pointer, or None when nothing is under it."""
    if toggles.hover is None:
        return None
    text, pixel = toggles.hover
    lines = [[text.encode("ascii", "replace")[:99]]]
    width = np.array([view.font.width(lines[0][0])])
    size = panel_sizes(width, 1, view)[0]
    below_right = np.array([1.0, -1.0])
    centre = np.array(pixel) + (size / 2 + _BESIDE * view.font.height) * below_right
    centres, sizes = labels_at(view, centre[None], lines)
    return Panels(centres, sizes, lines, _RGBA, in_front=True)
