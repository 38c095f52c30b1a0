"""Pictures without a window: `mujoco.Renderer` with the decor added."""

from __future__ import annotations

import logging
import os
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...assemble.world import World
from ...decor.draw import Decor
from ...decor.font import Font
from ...decor.pen import Host, Pen
from ...decor.toggles import Toggles
from ...decor.view import View
from ...errors import RenderError
from ..camera import find_camera
from ..font_scale import font_scale
from ..interaction import Gesture, click, hover
from ..picking import Picked, pick
from .offscreen import check_size, offscreen_size
from .picture import Picture

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
        toggles: what is shown.
        camera: may be moved between frames.
        view: of the frame laid out last.
        pen: its decor.
        left_out: how many geoms found no room in it.
        size: width and height, pixels.

    Raises:
        RenderError: no OpenGL, or the size is out of range.
        UnknownName: no camera of that name.
    """

    def __init__(
        self,
        world: World,
        width: int = DEFAULT_SIZE[0],
        height: int = DEFAULT_SIZE[1],
        camera: str | None = None,
    ) -> None:
        check_size("picture", width, height)
        self.world = world
        self.toggles = Toggles(world)
        self.camera = find_camera(world, camera)
        self.size = (width, height)
        self.view: View | None = None
        self.pen: Pen | None = None
        self.left_out = 0
        self._decor = Decor(world)
        self._renderer = _make_renderer(world, width, height)
        self._font = Font.of_context(self._renderer._mjr_context)
        self._host = Host(self._renderer.scene)
        self._complained = False

    def render(
        self, data: mujoco.MjData, out: NDArray[np.uint8] | None = None
    ) -> NDArray[np.uint8]:
        """Renders one frame.

        Args:
            data: the world's state, with frames up to date (`drive.follow`).
            out: (height, width, 3), written to when given.

        Returns:
            (height, width, 3), 0 to 255; a notebook shows it.
        """
        _, pen = self._lay_out(data)
        self.left_out = pen.left_out + self._host.add(pen)
        if self.left_out and not self._complained:
            self._complained = True
            log.warning("%d decor geoms found no room and are not shown", self.left_out)
        pixels: NDArray[np.uint8] = self._renderer.render(out=out)
        return pixels if out is not None else pixels.view(Picture)

    def _lay_out(self, data: mujoco.MjData) -> tuple[View, Pen]:
        renderer = self._renderer
        renderer.update_scene(data, self.camera)
        self.view = View.of_scene(renderer.scene, renderer.width, renderer.height, self._font)
        self.pen = self._decor.draw(data, self.toggles, self.view)
        return self.view, self.pen

    def pick(
        self, data: mujoco.MjData, x: float, y: float, tolerance: float = 0.0
    ) -> Picked | None:
        """Returns what is seen at a pixel, counted from the upper left corner of the picture.

        Args:
            data: the world's state, with frames up to date.
            x: to the right, 0 to width.
            y: down, 0 to height.
            tolerance: see `picking.pick`.
        """
        view, pen = self._lay_out(data)
        return pick(self.world, data, pen, view, _from_below(view, x, y), tolerance)

    def click(
        self,
        data: mujoco.MjData,
        x: float,
        y: float,
        gesture: Gesture = "click",
        tolerance: float = 0.0,
    ) -> Picked | None:
        """Clicks on a pixel, counted from the upper left corner, and returns what was hit.

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
        """Holds the pointer over a pixel, counted from the upper left corner.

        The name of what is there is written beside it in the frames that follow.
        """
        picked = self.pick(data, x, y)
        assert self.view is not None  # pick has laid it out
        hover(self.toggles, picked, _from_below(self.view, x, y))
        return picked

    def close(self) -> None:
        """Frees the OpenGL context."""
        self._renderer.close()

    def __enter__(self) -> HeadlessRenderer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _from_below(view: View, x: float, y: float) -> tuple[float, float]:
    """The middle of a pixel, y up, from one that is counted from the upper left corner."""
    return x + 0.5, view.height - y - 0.5


def _make_renderer(world: World, width: int, height: int) -> Any:
    model = world.model
    font = getattr(mujoco.mjtFontScale, f"mjFONTSCALE_{font_scale(world, height)}")
    try:
        with offscreen_size(model, width, height):
            return mujoco.Renderer(model, height, width, font_scale=font)
    except Exception as error:  # every GL backend raises its own
        advice = "`sero-mj doctor` says what is missing"
        if not os.environ.get("MUJOCO_GL"):
            advice = (
                "mujoco chose its OpenGL backend when it was imported: import sero_mj before it, "
                "or set MUJOCO_GL=egl"
            )
        raise RenderError(
            f"no picture of {width}x{height} can be made: {error or type(error).__name__}; {advice}"
        ) from error
