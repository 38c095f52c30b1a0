"""`Decor`: everything that is drawn over a world, as one function of data, toggles and view."""

from __future__ import annotations

import mujoco

from ..assemble.world import World
from .axes import draw_axes
from .billboards import Billboards
from .frame_names import name_panels
from .legend import Legend
from .panels import draw_panels
from .pen import Pen
from .quantities import arrow_values, joint_values
from .round_arrows import RoundArrows
from .staleness import Staleness
from .status import Status
from .toggles import Toggles
from .view import View


class Decor:
    """The decor of one world.

    Attributes:
        pen: the geoms of the frame that was drawn last.
    """

    def __init__(self, world: World) -> None:
        self.pen = Pen()
        self._world = world
        self._arrows = RoundArrows(world)
        self._billboards = Billboards(world)
        self._legend = Legend(world)
        self._status = Status(world)
        self._staleness = Staleness(world)

    def draw(self, data: mujoco.MjData, toggles: Toggles, view: View) -> Pen:
        """Lays out one frame and returns the pen that holds it.

        Args:
            data: the world's state, with frames up to date (`drive.follow`).
            toggles: what is shown.
            view: from where, and how large the picture is.
        """
        pen = self.pen
        pen.clear()
        values = joint_values(self._world, data)
        shown, limit = arrow_values(self._world, data, values, toggles.arrow_quantity)
        draw_axes(pen, self._world, data, toggles)
        self._arrows.draw(pen, data, toggles, shown, limit)
        panels = [
            self._billboards.draw(pen, data, toggles, view, values),
            name_panels(self._world, data, toggles, view),
            self._legend.panels(toggles, view, limit),
            self._status.panels(data, toggles, view),
            self._staleness.panels(pen, data, view),
        ]
        draw_panels(pen, view, [group for group in panels if group is not None])
        return pen
