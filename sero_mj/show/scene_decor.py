"""`SceneDecor`: decor laid out, added to an `MjvScene`, and picked from; the same in every host."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.world_view import WorldView
from ..decor.draw import Decor
from ..decor.pen import CAPACITY, Pen, SceneWriter
from ..decor.picture_view import PictureView
from ..decor.round_arrows import MAX_SEGMENTS
from ..decor.toggles import Toggles
from .picking import Picked, pick, point_at

log = logging.getLogger(__name__)

Pixel = tuple[float, float]


class SceneDecor:
    """The decor of a world, as a host shows it.

    Args:
        world: the compiled scene.
        toggles: what is shown; the scene's own when None.
        capacity: how many geoms the host takes.
        max_segments: how many of them a round arrow has at most.

    Attributes:
        world: the compiled scene.
        toggles: what is shown.
        view: of the frame that was laid out last; None before the first.
        dropped: how many geoms found no room in the last frame that was drawn.
    """

    def __init__(
        self,
        world: WorldView,
        toggles: Toggles | None = None,
        capacity: int = CAPACITY,
        max_segments: int = MAX_SEGMENTS,
    ) -> None:
        self.world = world
        self.toggles = Toggles(world) if toggles is None else toggles
        self.view: PictureView | None = None
        self.dropped = 0
        self._decor = Decor(world, capacity, max_segments)
        self._host: tuple[mujoco.MjvScene, SceneWriter] | None = None
        self._has_warned = False

    @property
    def pen(self) -> Pen:
        """The geoms of the frame that was laid out last."""
        return self._decor.pen

    def lay_out(self, data: mujoco.MjData, view: PictureView) -> None:
        """Lays out one frame.

        Args:
            data: the world's state, with frames up to date.
            view: from where, and how large the picture is.
        """
        self.view = view
        self._decor.draw(data, self.toggles, view)

    def draw(self, data: mujoco.MjData, view: PictureView, scene: mujoco.MjvScene) -> int:
        """Lays out one frame and adds it to a scene that MuJoCo has filled.

        Returns:
            how many geoms found no room; that some did not is logged once.
        """
        self.lay_out(data, view)
        if self._host is None or self._host[0] is not scene:
            self._host = (scene, SceneWriter(scene))
        self.dropped = self.pen.dropped + self._host[1].add(self.pen)
        if self.dropped and not self._has_warned:
            self._has_warned = True
            log.warning(
                "%d decor geoms found no room and are not shown: the scene has room for %d",
                self.dropped,
                scene.maxgeom,
            )
        return self.dropped

    def pick(self, data: mujoco.MjData, pixel: Pixel, tolerance: float = 0.0) -> Picked | None:
        """What is seen at a pixel of the frame that was laid out last, y up; see `picking.pick`."""
        if self.view is None:
            return None
        return pick(self.world, data, self.pen, self.view, pixel, tolerance)

    def point_at(self, data: mujoco.MjData, pixel: Pixel) -> NDArray[np.float64] | None:
        """The point of the world (3,), m, at a pixel, y up: of the floor too."""
        if self.view is None:
            return None
        return point_at(self.world, data, self.pen, self.view, pixel)
