"""Our decor as Studio's extra geoms, within what a browser takes."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui
from numpy.typing import NDArray

from ...assemble.mjcf_double import OUT_OF_SIGHT
from ...assemble.world_view import WorldView
from ...decor.font import Font
from ...decor.pen import MAX_GEOMS
from ...decor.picture_view import PictureView
from ...decor.toggles import Toggles
from ..scene_decor import SceneDecor
from .studio import StudioViewer

log = logging.getLogger(__name__)

_LINE = 1.25  # height of our lines over that of Studio's text
_MAX_SEGMENTS = 26  # boxes of a round arrow; each is 15 kB/s on the way to every browser
_PANEL_ALPHA = 0.92  # Studio's panels shine through more than those of the classic renderer


def studio_font() -> Font:
    """The font of the page's labels: that of Studio's user interface.

    Studio centres a label below its position.
    """
    text = imgui.GetTextLineHeight()
    widths = np.zeros(128)
    widths[32:127] = [imgui.CalcTextSize(chr(code)).x for code in range(32, 127)]
    return Font(round(_LINE * text), widths, anchor=(0.5, (1.0 + 1.0 / _LINE) / 2))


class WebDecor(SceneDecor):
    """Lays out the decor for the browser that has control, and hands it to Studio.

    Args:
        world: the compiled scene.
        toggles: what is shown.

    Attributes:
        count: geoms of the last picture.
        grey: which geoms of the model are to be grey, (ngeom,); None for none.
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
        """Gives the viewer the decor of this moment.

        Args:
            viewer: has the camera, and gets the geoms.
            data: the world's state, with frames up to date.
            inset: what the page's own windows cover, see `PictureView`.
        """
        if viewer.has_ui:  # outside of its frames Studio knows neither the page nor its text
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
        """Takes doubles that are switched off out of the picture: of a pose, not of the model."""
        for double, on in zip(self.world.doubles.values(), self.toggles.doubles, strict=True):
            if not on:
                data.mocap_pos[double.mocap] = OUT_OF_SIGHT
