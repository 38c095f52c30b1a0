"""`Decor`: everything that is drawn over a world, as one function of data, toggles and view."""

from __future__ import annotations

import logging

import mujoco

from ..assemble.world_view import WorldView
from .cards import LEADER_RGBA, lay_out
from .feature import Feature, Frame, make_features
from .hover import hover_panel
from .panels import draw_panels
from .pen import CAPACITY, Pen
from .picture_view import PictureView
from .quantities import arrow_values, joint_values
from .round_arrows import MAX_SEGMENTS
from .staleness import Staleness
from .toggles import Toggles

log = logging.getLogger(__name__)


class Decor:
    """The decor of one world.

    Args:
        world: the compiled scene.
        capacity: how many geoms the host takes.
        max_segments: how many of them a round arrow has at most.

    Attributes:
        pen: the geoms of the frame that was drawn last.
        features: what is drawn, in order.
    """

    def __init__(
        self, world: WorldView, capacity: int = CAPACITY, max_segments: int = MAX_SEGMENTS
    ) -> None:
        self.pen = Pen(capacity)
        self.features = make_features(world)
        self._world = world
        self._max_segments = max_segments
        self._staleness = Staleness(world)

    def draw(self, data: mujoco.MjData, toggles: Toggles, view: PictureView) -> Pen:
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
        pen.hidden = toggles.hidden_geoms()
        pen.ghosts = world.drawn_doubles(data, toggles.doubles)
        stale = self._staleness.find(data)
        for name, on in zip(world.doubles, toggles.doubles, strict=True):
            if not on:
                stale.pop(name, None)
        values = joint_values(world, data)
        arrows, limit = arrow_values(world, data, values, toggles.arrow_quantity)
        frame = Frame(
            pen=pen,
            data=data,
            view=view,
            toggles=toggles,
            shown=toggles.shown(data),
            values=values,
            arrow_values=arrows,
            arrow_limit=limit,
            stale=stale,
            stale_joints=self._staleness.joints(stale),
            max_segments=self._max_segments,
        )
        self._each("lay_out", frame)
        points = data.site_xpos[world.joints.centre_site[frame.shown.joints]]
        leaders = LEADER_RGBA[world.scene.view.look]
        panels = [
            *frame.corners,
            *lay_out(pen, view, frame.cards, points, frame.corners, leaders),
            *frame.panels,
            *self._staleness.panels(pen, data, view, stale),
        ]
        # Numbers first: what finds no room are boxes of arrows, and no text.
        draw_panels(pen, view, [*panels, *hover_panel(toggles, view, panels)])
        self._each("draw", frame)
        return pen

    def _each(self, step: str, frame: Frame) -> None:
        """Has all features do a step; one that fails is taken out, the others go on."""
        for feature in [*self.features]:
            try:
                getattr(feature, step)(frame)
            except Exception:
                if _is_own(feature):
                    raise
                log.exception("%s cannot be drawn and is left out from now on", type(feature))
                self.features.remove(feature)


def _is_own(feature: Feature) -> bool:
    return type(feature).__module__.startswith(__package__)
