"""Labels with the names of coordinate frames (section 2.5)."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.world_view import WorldView
from .feature import Feature, Frame
from .panels import Panels, labels_at
from .pen import Kind
from .picture_view import PictureView
from .toggles import Bools

_SPACED = 1.05  # vertical distance of two labels over their height


class FrameNames(Feature):
    """Shows the names of frames whose name is switched on, by a click for example."""

    order = 60

    def lay_out(self, frame: Frame) -> None:
        """Adds a label below the origin of every frame whose name is shown."""
        panels = name_panels(self.world, frame.data, frame.shown.frame_names, frame.view)
        if panels is not None:
            frame.panels.append(panels)


def name_panels(
    world: WorldView, data: mujoco.MjData, named: Bools, view: PictureView
) -> Panels | None:
    """Returns labels below the origins of frames, or None if there are none.

    Args:
        world: the compiled scene.
        data: its state.
        named: whether a frame's name is shown, (M,) bool.
        view: of the picture.
    """
    shown = named.nonzero()[0]
    if not len(shown):
        return None
    origins, depth = view.project(data.site_xpos[world.frames.site[shown]])
    inside = view.sees(origins, depth)
    shown, origins = shown[inside], origins[inside]
    if not len(shown):
        return None
    texts = [world.frames.names[i].encode("ascii", "replace")[:99] for i in shown]
    lines = [[text] for text in texts]
    below = origins - [0.0, view.font.height]
    centres, sizes = labels_at(view, below, lines)
    move_apart(centres, sizes)
    return Panels(centres, sizes, lines, kind=Kind.NAME, items=shown)


def move_apart(centres: NDArray[np.float64], sizes: NDArray[np.float64]) -> None:
    """Moves labels below those of earlier frames that they overlap, in place.

    Args:
        centres: (k, 2), pixels.
        sizes: (k, 2), pixels.
    """
    for k in range(1, len(centres)):
        beside = np.abs(centres[:k, 0] - centres[k, 0]) < (sizes[:k, 0] + sizes[k, 0]) / 2
        apart = (sizes[:k, 1] + sizes[k, 1]) / 2 * _SPACED
        # From the highest down: the label moves below each one that it overlaps.
        for other in np.argsort(-centres[:k, 1]):
            if beside[other] and abs(centres[other, 1] - centres[k, 1]) < apart[other]:
                centres[k, 1] = centres[other, 1] - apart[other]
