"""`WebDecor`: decor as extra geoms of Studio, within the limit of a browser."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui
from numpy.typing import NDArray

from ...assemble.double import OUT_OF_SIGHT
from ...assemble.world_view import WorldView
from ...decor.font import Font
from ...decor.pen import MAX_GEOMS
from ...decor.picture_view import PictureView
from ...decor.toggles import Toggles
from ..scene_decor import SceneDecor
from .studio import StudioViewer

log = logging.getLogger(__name__)

_LINE = 1.25  # height of decor text over that of Studio's text
_MAX_SEGMENTS = 26  # boxes of a round arrow; each adds 15 kB/s for every browser
_PANEL_ALPHA = 0.92  # Studio draws panels more transparent than the classic renderer


def studio_font() -> Font:
    """Returns the font of the page's labels: that of Studio's user interface.

    Studio centres a label below its position.
    """
    text = imgui.GetTextLineHeight()
    widths = np.zeros(128)
    widths[32:127] = [imgui.CalcTextSize(chr(code)).x for code in range(32, 127)]
    return Font(round(_LINE * text), widths, anchor=(0.5, (1.0 + 1.0 / _LINE) / 2))


class WebDecor(SceneDecor):
    """Lays out the decor for the browser that has control, and passes it to Studio.

    Args:
        world: the compiled scene.
        toggles: what is shown.

    Attributes:
        count: number of geoms of the last picture.
        grey: geoms of the model to show grey, (ngeom,) bool; None for none.
    """

    def __init__(self, world: WorldView, toggles: Toggles) -> None:
        self.view: PictureView | None = None
        self.count = 0
        self.grey: NDArray[np.bool_] | None = None
        super().__init__(world, toggles, MAX_GEOMS, _MAX_SEGMENTS)
        self._buffer = mujoco.MjvScene(world.model, maxgeom=MAX_GEOMS)
        self._geoms = list(self._buffer.geoms)
        self._camera = mujoco.MjvScene(world.model, maxgeom=0)
        self._font: Font | None = None
        self._size = 0, 0  # of the page, pixels

    def show_in(
        self,
        viewer: StudioViewer,
        data: mujoco.MjData,
        inset: tuple[float, float, float, float],
    ) -> None:
        """Passes the current decor to the viewer.

        Args:
            viewer: provides the camera and takes the geoms.
            data: the world's state, with frames up to date.
            inset: margins that the page's own windows cover, see `PictureView`.
        """
        if viewer.has_ui:  # page size and text are only available during Studio's frames
            size = imgui.GetIO().DisplaySize
            self._size = int(size.x), int(size.y)
            if self._font is None:
                self._font = studio_font()
        width, height = self._size
        if self._font is None or width < 1 or height < 1:
            return
        mujoco.mjv_updateCamera(self.world.model, data, viewer.camera, self._camera)
        view = PictureView.of_scene(self._camera, width, height, self._font, inset, _PANEL_ALPHA)
        self._buffer.ngeom = 0
        self.draw(data, view, self._buffer)
        self.grey = self.pen.grey
        self.count = self._buffer.ngeom
        viewer.extra_geoms[:] = self._geoms[: self.count]
        self._hide_doubles(viewer.data)

    def _hide_doubles(self, data: mujoco.MjData) -> None:
        """Moves doubles that are switched off out of sight."""
        for double, on in zip(self.world.doubles.values(), self.toggles.doubles, strict=True):
            if not on:
                data.mocap_pos[double.mocap] = OUT_OF_SIGHT
