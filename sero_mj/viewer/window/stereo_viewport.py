"""`StereoViewport`: the picture of a world in a window, for two eyes."""

from __future__ import annotations

import mujoco
import numpy as np

from ...robots.assemble.world_view import WorldView
from ..decor.toggles import Toggles
from ..image.framing import bounding_sphere
from ..image.picture_options import EYE_DISTANCE, Stereo
from ..image.stereo import check_stereo, each_eye, looked_at
from ..image.typesetting import Typesetter
from .glfw_window import GlWindow
from .host import Viewport


class StereoViewport(Viewport):
    """See `Viewport`; it is always drawn in full.

    Args:
        stereo: `side-by-side` for a half of the picture for each eye, or `anaglyph` for red-cyan
            glasses.
        eye_distance: between the eyes, m.

    Raises:
        RenderError: no such stereo, or the distance is out of range.
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
        self._distance = 1.0  # m, of what the camera looks at

    @property
    def width(self) -> int:
        return super().width // (1 if self._is_anaglyph else 2)

    def update(
        self,
        data: mujoco.MjData,
        camera: mujoco.MjvCamera,
        rect: mujoco.MjrRect,
        typesetter: Typesetter,
        covered: float = 0.0,
    ) -> None:
        super().update(data, camera, rect, typesetter, covered)
        self._distance = looked_at(self._scene, camera, self._centre)

    def render(self, gl: GlWindow, *, quickly: bool = False) -> None:
        rect, scene = self.rect, self._scene
        left = int(rect.left)
        starts = [left, left if self._is_anaglyph else left + self.width]
        for eye, _ in enumerate(each_eye(scene, self._eye_distance, self._distance)):
            half = mujoco.MjrRect(starts[eye], rect.bottom, self.width, rect.height)
            mujoco.mjr_render(half, scene, gl.context)
            # MuJoCo sets all colours where something is reflected, so no mask holds meanwhile.
            if self._is_anaglyph and eye == 0:
                red = gl.read(rect)
        if self._is_anaglyph:
            gl.blender.draw_red(np.ascontiguousarray(red[::-1]), rect.left, rect.bottom)
        for start in dict.fromkeys(starts):
            self._draw_panels(gl, start)
