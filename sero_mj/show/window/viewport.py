"""`Viewport`: lays out, draws and picks from one picture of a window."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assemble.world_view import WorldView
from ...decor.font import Font
from ...decor.pen import CAPACITY
from ...decor.picture_view import PictureView
from ...decor.toggles import Toggles
from ..picking import Picked
from ..scene_decor import SceneDecor

log = logging.getLogger(__name__)

_MORE = 1000  # additional capacity for geoms that MuJoCo adds to those of the model


class Viewport:
    """The picture of a world in a rectangle of a window.

    Args:
        world: the compiled scene.
        toggles: what is shown.

    Attributes:
        decor: of the last picture.
        rect: of the last picture in the window.
    """

    def __init__(self, world: WorldView, toggles: Toggles) -> None:
        model = world.model
        self.rect = mujoco.MjrRect(0, 0, 1, 1)
        self.decor = SceneDecor(world, toggles)
        self._model = model
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + CAPACITY + _MORE)
        self._option = mujoco.MjvOption()

    def lay_out(
        self, data: mujoco.MjData, camera: mujoco.MjvCamera, rect: mujoco.MjrRect, font: Font
    ) -> None:
        """Lays out scene and decor.

        Args:
            data: the world's state, with frames up to date.
            camera: of the picture.
            rect: of the picture in the window.
            font: of its labels.
        """
        scene = self._scene
        mujoco.mjv_updateScene(
            self._model, data, self._option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene
        )
        self.rect = rect
        view = PictureView.of_scene(scene, rect.width, rect.height, font)
        self.decor.draw(data, view, scene)

    def draw(self, context: mujoco.MjrContext) -> None:
        """Renders the picture."""
        mujoco.mjr_render(self.rect, self._scene, context)

    def pixels(self, context: mujoco.MjrContext) -> NDArray[np.uint8]:
        """Returns the rendered picture, (height, width, 3), uint8, top row first."""
        rgb = np.empty((self.rect.height, self.rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(rgb, None, self.rect, context)
        return np.ascontiguousarray(rgb[::-1])

    def to_picture(self, x: float, y: float) -> tuple[float, float]:
        """Converts a pixel of the window to one of the picture."""
        return x - self.rect.left, y - self.rect.bottom

    def contains(self, x: float, y: float) -> bool:
        """Whether a pixel of the window is in the picture."""
        px, py = self.to_picture(x, y)
        return bool(0 <= px < self.rect.width and 0 <= py < self.rect.height)

    def pick(self, data: mujoco.MjData, x: float, y: float) -> Picked | None:
        """Returns the item at a pixel of the window.

        Args:
            data: the world's state, with frames up to date.
            x: to the right, pixels.
            y: up, pixels.
        """
        return self.decor.pick(data, self.to_picture(x, y)) if self.contains(x, y) else None

    def point_at(self, data: mujoco.MjData, x: float, y: float) -> NDArray[np.float64] | None:
        """Returns the world point (3,), m, at a pixel of the window; None for the sky.

        Args:
            data: the world's state, with frames up to date.
            x: to the right, pixels.
            y: up, pixels.
        """
        return self.decor.point_at(data, self.to_picture(x, y)) if self.contains(x, y) else None
