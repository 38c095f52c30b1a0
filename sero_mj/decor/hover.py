"""What is under the pointer, written beside it."""

from __future__ import annotations

import numpy as np

from .panels import Panels, labels_at, panel_sizes
from .picture_view import PictureView
from .toggles import Toggles

_BESIDE = 0.6  # of a line's height
# Below to the right, where pointers do not cover it; else above, else on the left.
_CORNERS = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, -1.0], [-1.0, 1.0]])
_RGBA = (0.20, 0.20, 0.16, 0.90)


def hover_panel(toggles: Toggles, view: PictureView, others: list[Panels]) -> list[Panels]:
    """Returns the panel beside the pointer; none when nothing is under it.

    Args:
        toggles: have what is under the pointer.
        view: of the picture.
        others: all panels of the frame; it stands where it covers least of them.
    """
    if toggles.hover is None:
        return []
    text, pixel = toggles.hover
    lines = [[text.encode("ascii", "replace")[:99]]]
    width = np.array([view.font.width(lines[0][0])])
    size = panel_sizes(width, 1, view)[0]
    centres = np.array(pixel) + (size / 2 + _BESIDE * view.font.height) * _CORNERS
    centres, sizes = labels_at(view, centres, lines * len(_CORNERS))
    covered = np.zeros(len(_CORNERS))
    for panels in others:
        overlap = (sizes[0] + panels.sizes) / 2 - np.abs(centres[:, None] - panels.centres)
        covered += np.maximum(overlap, 0.0).prod(axis=2).sum(axis=1)
    best = covered.argmin()  # the first of equals
    return [Panels(centres[best : best + 1], sizes[:1], lines, _RGBA, in_front=True)]
