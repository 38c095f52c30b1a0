"""What is wrong with the sources, written into the corner of the picture."""

from __future__ import annotations

import mujoco
import numpy as np

from ..assemble.world import World
from .panels import draw_panels, panel_sizes
from .pen import Pen
from .toggles import Toggles
from .view import View

FAULT_RGBA = (0.32, 0.03, 0.03, 0.88)
_MARGIN = 0.5  # of a line's height


class Status:
    """Draws one line for every source that is silent or sends what cannot be used."""

    def __init__(self, world: World) -> None:
        self._slots = [
            (name, world.slots[f"sources.{name}"])
            for name in world.scene.sources
            if any(event.partition(".")[0] == name for event in world.scene.routes.values())
        ]

    def draw(self, pen: Pen, data: mujoco.MjData, toggles: Toggles, view: View) -> None:
        """Draws the panel in the upper left corner, if there is anything to say."""
        lines = []
        for name, slot in self._slots:
            received, malformed, dropped, age = data.userdata[slot]
            if age < 0:
                lines.append(f"{name}: no data yet")
            if malformed:
                lines.append(
                    f"{name}: {malformed:.0f} of {received:.0f} packets malformed, not applied"
                )
            if dropped:
                lines.append(f"{name}: {dropped:.0f} packets dropped by the kernel")
        if not lines or not toggles.status:
            return
        texts = [line.encode("ascii", "replace")[:99] for line in lines]
        widest = max(view.font.width(text) for text in texts)
        size = panel_sizes(np.array([widest]), len(texts), view)
        margin = _MARGIN * view.font.height
        corner = np.array([margin, view.height - margin])
        draw_panels(pen, view, corner + size * (0.5, -0.5), size, [texts], FAULT_RGBA)
