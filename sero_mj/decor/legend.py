"""The legend: what the arrows show, which way is positive, and what full width means."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..assemble.tables import ARROW_QUANTITIES
from ..assemble.world import World
from .panels import Panels, panel_sizes
from .toggles import Toggles
from .view import View

Array = NDArray[np.float64]

_RGBA = (0.09, 0.11, 0.14, 0.6)
# The colours of `round_arrows`, in words; a test holds the two together.
_SIGNS = b"orange: + about z, blue: -"
_LARGEST_SHARE = 0.08  # of the picture
_MARGIN = 0.5  # of a line's height
_WORDS = {
    "torques": ("joint torque", "full width: torque limit"),
    "torque_error": ("torque error, commanded - measured", "full width: torque limit"),
    "joint_accelerations": ("joint acceleration", "full width: acceleration limit"),
    "singularity": ("towards the singularity", "full width: at it"),
}
_TORQUES = 2  # the first two quantities are torques, and forces of sliding joints
_UNLIMITED = "width grows with the value"


class Legend:
    """One panel for every quantity that arrows show, in the lower left corner."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._key: object = None
        self._panels: Panels | None = None

    def panels(self, toggles: Toggles, view: View, limit: Array) -> Panels | None:
        """Returns the panels, or None when no arrow is on or no legend is wanted.

        Args:
            toggles: what is shown.
            view: of the picture.
            limit: at which value an arrow is at full width, (N,).
        """
        if not toggles.legend or not toggles.arrows.any():
            return None
        key = (toggles.arrows.tobytes(), toggles.arrow_quantity.tobytes(), view.font.height)
        if key != self._key:  # it stands in a corner and changes only when toggles do
            self._key, self._panels = key, self._laid_out(toggles, view, limit)
        assert self._panels is not None
        # In a small picture it would hide more than it explains.
        room = _LARGEST_SHARE * view.width * view.height
        return self._panels if float(self._panels.sizes.prod(axis=1).sum()) < room else None

    def _laid_out(self, toggles: Toggles, view: View, limit: Array) -> Panels:
        margin = _MARGIN * view.font.height
        corner = np.array([margin, margin])
        centres, sizes, texts = [], [], []
        for code in sorted(set(toggles.arrow_quantity[toggles.arrows].tolist())):
            shown = toggles.arrows & (toggles.arrow_quantity == code)
            what, width = _WORDS[ARROW_QUANTITIES[code]]
            if not np.isfinite(limit[shown]).any():
                width = _UNLIMITED
            if not self._world.joints.revolute[shown].all() and code < _TORQUES:
                what += ", or force"
            lines = [f"arrows: {what}".encode(), _SIGNS, width.encode()]
            widest = max(view.font.width(line) for line in lines)
            size = panel_sizes(np.array([widest]), len(lines), view)[0]
            centres.append(corner + size / 2)
            sizes.append(size)
            texts.append(lines)
            corner = corner + np.array([0.0, size[1] + margin])
        return Panels(np.array(centres), np.array(sizes), texts, _RGBA)
