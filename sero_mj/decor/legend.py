"""The legend: what the arrows show, which way is positive, and what full width means."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..assemble.tables import ARROW_QUANTITIES
from ..assemble.world import World
from .panels import draw_panels, panel_sizes
from .pen import Pen
from .toggles import Toggles
from .view import View

Array = NDArray[np.float64]

_RGBA = (0.09, 0.11, 0.14, 0.6)
# The colours of `round_arrows`, in words; a test holds the two together.
_SIGNS = b"orange: + about z, blue: -"
_MARGIN = 0.5  # of a line's height
_WORDS = {
    "torques": ("joint torque", "full width: torque limit"),
    "torque_error": ("torque error, commanded - measured", "full width: torque limit"),
    "joint_accelerations": ("joint acceleration", "full width: acceleration limit"),
    "singularity": ("towards the singularity", "full width: at it"),
}
_UNLIMITED = "width grows with the value"


class Legend:
    """Draws one panel for every quantity that arrows show, in the lower left corner."""

    def __init__(self, world: World) -> None:
        self._world = world

    def draw(self, pen: Pen, toggles: Toggles, view: View, limit: Array) -> None:
        """Draws it, if any arrow is toggled on and the legend is wanted.

        Args:
            pen: where to.
            toggles: what is shown.
            view: of the picture.
            limit: at which value an arrow is at full width, (N,).
        """
        if not toggles.legend or not toggles.arrows.any():
            return
        line = view.font.height
        margin = _MARGIN * line
        base = margin
        for code in np.unique(toggles.arrow_quantity[toggles.arrows]):
            shown = toggles.arrows & (toggles.arrow_quantity == code)
            what, width = _WORDS[ARROW_QUANTITIES[code]]
            if not np.isfinite(limit[shown]).any():
                width = _UNLIMITED
            texts = [f"arrows: {what}".encode(), _SIGNS, width.encode()]
            widest = max(view.font.width(text) for text in texts)
            size = panel_sizes(np.array([widest]), len(texts), view)
            corner = np.array([margin, base])
            draw_panels(pen, view, corner + size / 2, size, [texts], _RGBA)
            base += float(size[0, 1]) + margin
