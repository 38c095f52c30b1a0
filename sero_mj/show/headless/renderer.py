"""`HeadlessRenderer`: renders pictures with decor without a window, by `mujoco.Renderer`."""

from __future__ import annotations

import logging
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assemble.world_view import WorldView
from ...decor.font import Font, font_scale
from ...decor.picture_view import PictureView
from ...decor.toggles import Toggles
from ...errors import RenderError
from ..camera import find_camera
from ..interaction import Gesture, click, hover
from ..picking import Picked
from ..scene_decor import SceneDecor
from ._offscreen import check_size, offscreen_size
from .backend import adopt_backend
from .film import Picture

log = logging.getLogger(__name__)

DEFAULT_SIZE = (1280, 800)


class HeadlessRenderer:
    """Renders a world into arrays.

    Args:
        world: what to render.
        width: of the picture, pixels.
        height: of the picture, pixels.
        camera: see `find_camera`.

    Attributes:
        world: the world.
        decor: of the last frame.
        camera: can be changed between frames.
        size: width and height, pixels.

    Raises:
        RenderError: no OpenGL, or the size is out of range.
        UnknownName: no camera of that name.
    """

    def __init__(
        self,
        world: WorldView,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera: str | None = None,
    ) -> None:
        check_size("picture", width, height)
        self.world = world
        self.camera = find_camera(world, camera)
        self.size = (width, height)
        self.decor = SceneDecor(world)
        self._renderer = _make_renderer(world, width, height)
        self._font = Font.of_context(self._renderer._mjr_context)

    @property
    def toggles(self) -> Toggles:
        """What is shown; can be set to the toggles of another host."""
        return self.decor.toggles

    @toggles.setter
    def toggles(self, toggles: Toggles) -> None:
        self.decor.toggles = toggles

    def render(
        self, data: mujoco.MjData, out: NDArray[np.uint8] | None = None
    ) -> NDArray[np.uint8]:
        """Renders one frame.

        Args:
            data: the world's state, with frames up to date (`drive.place.follow`).
            out: output array, (height, width, 3), uint8; None for a new one.

        Returns:
            picture (height, width, 3), uint8; a notebook displays it.
        """
        view = self._look(data)
        self.decor.draw(data, view, self._renderer.scene)
        pixels: NDArray[np.uint8] = self._renderer.render(out=out)
        return pixels if out is not None else pixels.view(Picture)

    def _look(self, data: mujoco.MjData) -> PictureView:
        renderer = self._renderer
        renderer.update_scene(data, self.camera)
        return PictureView.of_scene(renderer.scene, renderer.width, renderer.height, self._font)

    def pick(
        self, data: mujoco.MjData, x: float, y: float, tolerance: float = 0.0
    ) -> Picked | None:
        """Returns the item at a pixel, counted from the upper left corner; None for no item.

        Args:
            data: the world's state, with frames up to date.
            x: to the right, 0 to width.
            y: down, 0 to height.
            tolerance: see `picking.pick`.
        """
        self.decor.lay_out(data, self._look(data))
        return self.decor.pick(data, self._from_below(x, y), tolerance)

    def click(
        self,
        data: mujoco.MjData,
        x: float,
        y: float,
        gesture: Gesture = "click",
        tolerance: float = 0.0,
    ) -> Picked | None:
        """Clicks on a pixel, counted from the upper left corner, and returns the item there.

        Args:
            data: the world's state, with frames up to date.
            x: to the right, 0 to width.
            y: down, 0 to height.
            gesture: a click, one with Shift held, or a double click.
            tolerance: see `picking.pick`.
        """
        picked = self.pick(data, x, y, tolerance)
        click(self.world, self.toggles, picked, gesture)
        return picked

    def hover(self, data: mujoco.MjData, x: float, y: float) -> Picked | None:
        """Moves the pointer to a pixel; the next frames show the name of the item there.

        Args:
            data: the world's state, with frames up to date.
            x: to the right from the left edge, pixels.
            y: down from the upper edge, pixels.
        """
        picked = self.pick(data, x, y)
        hover(self.toggles, picked, self._from_below(x, y))
        return picked

    def _from_below(self, x: float, y: float) -> tuple[float, float]:
        """Returns the centre of a pixel, y up, of a pixel counted from the upper left corner."""
        return x + 0.5, self.size[1] - y - 0.5

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._renderer.close()

    def __enter__(self) -> HeadlessRenderer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _make_renderer(world: WorldView, width: int, height: int) -> Any:
    model = world.model
    font = getattr(mujoco.mjtFontScale, f"mjFONTSCALE_{font_scale(world, height)}")
    adopt_backend()
    try:
        with offscreen_size(model, width, height):
            return mujoco.Renderer(model, height, width, font_scale=font)
    except Exception as error:  # every GL backend raises errors of its own
        raise RenderError(
            f"no picture of {width}x{height} can be made: {error or type(error).__name__}; "
            "`sero-mj doctor` lists what is missing"
        ) from error
