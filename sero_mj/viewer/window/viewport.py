"""`Viewport`: draws a world in a rectangle of a window, in mono or stereo."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from ...robots.assemble.world_view import WorldView
from ..decor.geom_buffer import CAPACITY
from ..decor.image_view import ImageView
from ..decor.toggles import Toggles
from ..image.added_surroundings import added_surroundings
from ..image.framing import bounding_sphere, stand_back
from ..image.image_options import EYE_DISTANCE, Stereo
from ..image.mujoco_private import lend_shapes
from ..image.scene_decor import SceneDecor
from ..image.stereo import check_stereo, each_eye, looked_at
from ..image.typesetting import Typesetter
from ..session.status_line import Piece
from .glfw_window import GlWindow

_MORE = 2000  # maximum number of geoms that MuJoCo draws in addition to those of the model


class Pane(NamedTuple):
    """The part of a window that shows the image.

    Attributes:
        covered: width in pixels that the panel covers at the left edge. Text must be beside it.
    """

    rect: mujoco.MjrRect
    typesetter: Typesetter
    covered: float = 0.0


class Viewport(SceneDecor):
    """Draws the image of a world in a rectangle of a window.

    Attributes:
        rect: rectangle of the image in the window.
        width: width of the image for one eye in pixels.
    """

    def __init__(self, world: WorldView, toggles: Toggles, context: mujoco.MjrContext) -> None:
        super().__init__(world, toggles, with_text=False)
        self.needed = 0.0
        self.first_shape = lend_shapes(context)
        self._surroundings = added_surroundings(world, context)
        self.rect, self.width = mujoco.MjrRect(0, 0, 1, 1), 1
        self._scene = mujoco.MjvScene(world.model, maxgeom=world.model.ngeom + CAPACITY + _MORE)
        self._typesetter: Typesetter | None = None

    @property
    def pieces(self) -> list[Piece]:
        return []

    def update(self, data: mujoco.MjData, camera: mujoco.MjvCamera, pane: Pane) -> None:
        """Prepares the scene and all overlays for `render`."""
        scene = self._scene
        self.fill(data, camera, scene)
        if self._surroundings is not None:
            self._surroundings.add(scene)
        rect, self._typesetter, covered = pane
        self.rect = rect
        self.width = self._width_of(rect)
        stand_back(scene, camera, self.width, rect.height, self.needed)
        inset = (min(covered, 0.6 * self.width), 0.0, 0.0, 0.0)
        view = ImageView.of_scene(scene, self.width, rect.height, pane.typesetter.font, inset)
        self.draw(data, view, scene)

    def _width_of(self, rect: mujoco.MjrRect) -> int:
        return int(rect.width)

    def render(self, gl: GlWindow, *, quickly: bool = False) -> None:
        if quickly:
            gl.render_quickly(self.rect, self._scene)
        else:
            mujoco.mjr_render(self.rect, self._scene, gl.context)
        self._draw_panels(gl, int(self.rect.left))

    def _draw_panels(self, gl: GlWindow, left: int) -> None:
        if self._typesetter is not None:
            gl.blender.draw(self._typesetter.place(self.panels), left, self.rect.bottom)


class StereoViewport(Viewport):
    """A viewport with one image per eye, which is always rendered in full quality.

    Args:
        stereo: stereo mode: `side-by-side` for two images beside each other, or `anaglyph` for
            red-cyan glasses.
        eye_distance: distance between the eyes in m.

    Raises:
        RenderError: the stereo mode is unknown, or the distance is out of range.
    """

    def __init__(
        self,
        world: WorldView,
        toggles: Toggles,
        context: mujoco.MjrContext,
        stereo: Stereo,
        eye_distance: float = EYE_DISTANCE,
    ) -> None:
        check_stereo(stereo, eye_distance)
        super().__init__(world, toggles, context)
        self._is_anaglyph, self._eye_distance = stereo == "anaglyph", eye_distance
        self._centre = bounding_sphere(world)[0]
        self._distance = 1.0  # distance of the look-at point, m

    def _width_of(self, rect: mujoco.MjrRect) -> int:
        return int(rect.width) // (1 if self._is_anaglyph else 2)

    def update(self, data: mujoco.MjData, camera: mujoco.MjvCamera, pane: Pane) -> None:
        super().update(data, camera, pane)
        self._distance = looked_at(self._scene, camera, self._centre)

    def render(self, gl: GlWindow, *, quickly: bool = False) -> None:
        rect, scene = self.rect, self._scene
        left = int(rect.left)
        starts = [left, left if self._is_anaglyph else left + self.width]
        for eye, _ in enumerate(each_eye(scene, self._eye_distance, self._distance)):
            half = mujoco.MjrRect(starts[eye], rect.bottom, self.width, rect.height)
            mujoco.mjr_render(half, scene, gl.context)
            # A color mask does not work, because MuJoCo resets it when it renders reflections.
            if self._is_anaglyph and eye == 0:
                red = gl.read(rect)
        if self._is_anaglyph:
            gl.blender.draw_red(np.ascontiguousarray(red[::-1]), rect.left, rect.bottom)
        for start in dict.fromkeys(starts):
            self._draw_panels(gl, start)
