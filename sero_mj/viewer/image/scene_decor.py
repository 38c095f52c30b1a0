"""`SceneDecor`: adds visual features to an `MjvScene`, and handles clicks on them."""

from __future__ import annotations

import logging

import mujoco

from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ..decor.draw import Decor
from ..decor.feature import Drawn
from ..decor.geom_buffer import CAPACITY, GeomBuffer
from ..decor.image_view import ImageView
from ..decor.model_drawing import ModelDrawing
from ..decor.panels import Panels
from ..decor.scene_writer import SceneWriter
from ..decor.toggles import Toggles
from .clicks import Gesture, click, hover
from .picking import Picked, Pixel, handle_at, link_at, pick, point_at

log = logging.getLogger(__name__)


class SceneDecor:
    """The visual features of a world in a window, page or image.

    Args:
        toggles: switches of the visual features (default: the switches that the scene declares).
        with_text: whether panels and labels are added to scenes. Otherwise, the caller draws
            `panels`.

    Attributes:
        view: view of the last frame; None before the first frame.
        dropped: number of geoms of the last frame that exceeded the capacity of the scene.
        first_shape: `dataid` of the first mesh of arrows in scenes, as in `SceneWriter`.
    """

    def __init__(
        self,
        world: WorldView,
        toggles: Toggles | None = None,
        capacity: int = CAPACITY,
        *,
        with_text: bool = True,
    ) -> None:
        self.world = world
        self.toggles = Toggles(world) if toggles is None else toggles
        self.view: ImageView | None = None
        self.dropped = 0
        self.first_shape: int | None = None
        self.drawing = ModelDrawing(world)
        self._decor = Decor(world, capacity)
        self.buffer: GeomBuffer = self._decor.buffer
        self._host: tuple[mujoco.MjvScene, SceneWriter] | None = None
        self._has_warned = False
        self._with_text = with_text

    def add(self, feature: Drawn) -> None:
        self._decor.features.append(feature)

    @property
    def fixed(self) -> str:
        """Reason why the user cannot move the camera; empty if the user can move it."""
        return ""

    @property
    def panels(self) -> list[Panels]:
        return self._decor.panels

    def fill(self, data: mujoco.MjData, camera: mujoco.MjvCamera, scene: mujoco.MjvScene) -> None:
        self.drawing.fill(data, self.toggles, camera, scene)

    def lay_out(self, data: mujoco.MjData, view: ImageView) -> None:
        self.view = view
        self._decor.draw(data, self.toggles, view)

    def draw(self, data: mujoco.MjData, view: ImageView, scene: mujoco.MjvScene) -> int:
        """Adds one frame to a scene filled by MuJoCo, and returns the number of dropped geoms."""
        self.lay_out(data, view)
        if self._host is None or self._host[0] is not scene:
            self._host = (scene, SceneWriter(scene, self.first_shape))
        dropped = self._host[1].add(self.buffer, with_text=self._with_text)
        self.dropped = self.buffer.dropped + dropped
        if self.dropped and not self._has_warned:
            self._has_warned = True
            log.warning(
                "%d geoms of arrows, axes or panels are not drawn: the scene has room for %d geoms",
                self.dropped,
                scene.maxgeom,
            )
        return self.dropped

    def from_above(self, x: float, y: float) -> Pixel:
        """Converts a pixel from coordinates with y down, as in image files, to y up."""
        assert self.view is not None
        return x + 0.5, self.view.height - y - 0.5

    def pick(self, data: mujoco.MjData, pixel: Pixel, tolerance: float = 0.0) -> Picked | None:
        """Returns the item at a pixel of the last frame, or None.

        The pixel is counted from the lower left corner, x to the right and y up.
        """
        if self.view is None:
            return None
        return pick(self.world, data, self.buffer, self.view, pixel, tolerance)

    def point_at(self, data: mujoco.MjData, pixel: Pixel) -> Array | None:
        if self.view is None:
            return None
        return point_at(self.world, data, self.buffer, self.view, pixel)

    def link_at(self, data: mujoco.MjData, pixel: Pixel) -> tuple[str, Array] | None:
        if self.view is None:
            return None
        return link_at(self.world, data, self.buffer, self.view, pixel)

    def handle_at(self, pixel: Pixel, tolerance: float = 0.0) -> int | None:
        if self.view is None:
            return None
        return handle_at(self.buffer, self.view, pixel, tolerance)

    def click(
        self,
        data: mujoco.MjData,
        pixel: Pixel,
        gesture: Gesture = "click",
        tolerance: float = 0.0,
    ) -> Picked | None:
        picked = self.pick(data, pixel, tolerance)
        click(self.world, self.toggles, picked, gesture)
        return picked

    def hover(self, data: mujoco.MjData, pixel: Pixel) -> Picked | None:
        picked = self.pick(data, pixel)
        hover(self.toggles, picked, pixel)
        return picked
