"""`Decor`: everything that is drawn over a world, as one function of data, toggles and view."""

from __future__ import annotations

import mujoco
import numpy as np

from ..assemble.world_view import WorldView
from .axes import draw_axes
from .billboards import Billboards
from .cards import LEADER_RGBA, below, lay_out
from .flange_check import FlangeCheck
from .frame_names import name_panels
from .hover import hover_panel
from .legend import Legend
from .panels import Panels, draw_panels
from .pen import CAPACITY, Pen
from .quantities import arrow_values, beyond_belief, joint_values
from .round_arrows import MAX_SEGMENTS, RoundArrows
from .smart_arrows import arrow_vectors, draw_smart_arrows, drawn_sizes
from .staleness import Staleness, among
from .status import Status
from .toggles import Toggles
from .vector_cards import VectorCards
from .view import View


class Decor:
    """The decor of one world.

    Args:
        world: the compiled scene.
        capacity: how many geoms the host takes.
        max_segments: how many of them a round arrow has at most.

    Attributes:
        pen: the geoms of the frame that was drawn last.
    """

    def __init__(
        self, world: WorldView, capacity: int = CAPACITY, max_segments: int = MAX_SEGMENTS
    ) -> None:
        self.pen = Pen(capacity)
        self._world = world
        self._arrows = RoundArrows(world, max_segments)
        self._billboards = Billboards(world)
        self._vector_cards = VectorCards(world)
        self._flange_check = FlangeCheck(world)
        self._legend = Legend(world)
        self._status = Status(world)
        self._staleness = Staleness(world)

    def draw(self, data: mujoco.MjData, toggles: Toggles, view: View) -> Pen:
        """Lays out one frame and returns the pen that holds it.

        Args:
            data: the world's state, with frames up to date (`drive.Placer`).
            toggles: what is shown; those that packets switch are switched.
            view: from where, and how large the picture is.
        """
        pen, world = self.pen, self._world
        data = world.state(data)
        pen.clear()
        toggles.follow(data)
        shown = toggles.shown(data)
        pen.hidden = toggles.hidden_geoms()
        pen.ghosts = world.drawn_doubles(data, toggles.doubles)
        stale = self._staleness.find(data)
        for name, on in zip(world.doubles, toggles.doubles, strict=True):
            if not on:
                stale.pop(name, None)
        grey = self._staleness.joints(stale)
        values = joint_values(world, data)
        arrows, limit = arrow_values(world, data, values, toggles.arrow_quantity)
        cards = [self._billboards.cards(data, toggles, shown, view, values, grey)]
        if shown.vectors.any():
            components, vectors = arrow_vectors(world, data)
            names = world.arrows.names
            draw_smart_arrows(pen, world, data, shown.vectors, vectors, among(names, stale))
            ages = [stale.get(name, "") for name in names]
            reach = drawn_sizes(world, vectors)
            cards.append(self._vector_cards.cards(data, shown.cards, view, components, reach, ages))
        right: Panels | None = None
        if toggles.flange_checks:
            off, right = self._flange_check.draw(pen, data, view)
            cards.append(off)
        groups = [group for group in cards if group is not None]
        legend = self._legend.panels(toggles, view, limit)
        wrong = beyond_belief(world, values)
        faults = below(right, self._status.panels(data, toggles, view, wrong))
        corners = [panels for panels in (right, legend, faults) if panels is not None]
        points = data.site_xpos[world.joints.centre_site[shown.joints]]
        found = [
            right,
            legend,
            *lay_out(pen, view, groups, points, corners, LEADER_RGBA[world.scene.view.look]),
            name_panels(world, data, shown.frame_names, view),
            faults,
            self._staleness.panels(pen, data, view, stale),
        ]
        panels = [group for group in found if group is not None]
        label = hover_panel(toggles, view, panels)
        # Numbers first: what finds no room are boxes of arrows, and no text.
        draw_panels(pen, view, panels if label is None else [*panels, label])
        draw_axes(pen, world, data, shown.axes, among(world.frames.names, stale))
        of_cards = sum(2 + len(lines) for group in groups for lines in group.texts)
        others = 3 * int(np.count_nonzero(shown.axes)) + of_cards
        self._arrows.draw(pen, data, shown, arrows, limit, others, grey)
        return pen
