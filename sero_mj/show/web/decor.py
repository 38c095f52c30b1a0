"""Our decor as Studio's extra geoms, within what a browser takes."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui
from numpy.typing import NDArray

from ...assemble.mjcf_double import OUT_OF_SIGHT
from ...assemble.world_view import WorldView
from ...decor.draw import Decor
from ...decor.font import Font
from ...decor.pen import MAX_GEOMS, Host
from ...decor.toggles import Toggles
from ...decor.view import View
from ..picking import Picked, pick, point_at
from .studio import StudioViewer

log = logging.getLogger(__name__)

_LINE = 1.25  # height of our lines over that of Studio's text
_FINEST = 26  # boxes of a round arrow; each is 15 kB/s on the way to every browser
_PANEL_ALPHA = 0.92  # Studio's panels shine through more than those of the classic renderer


def studio_font() -> Font:
    """The font of the page's labels: that of Studio's user interface.

    Studio centres a label below its position.
    """
    text = imgui.GetTextLineHeight()
    widths = np.zeros(128)
    widths[32:127] = [imgui.CalcTextSize(chr(code)).x for code in range(32, 127)]
    return Font(round(_LINE * text), widths, anchor=(0.5, (1.0 + 1.0 / _LINE) / 2))


class WebDecor:
    """Lays out the decor for the browser that has control, and hands it to Studio.

    Args:
        world: the compiled scene.
        toggles: what is shown.

    Attributes:
        view: of the last picture; None before the first.
        count: geoms of the last picture.
        left_out: how many more found no room.
        grey: which geoms of the model are to be grey, (ngeom,); None for none.
    """

    def __init__(self, world: WorldView, toggles: Toggles) -> None:
        self.view: View | None = None
        self.count = self.left_out = 0
        self.grey: NDArray[np.bool_] | None = None
        self._world, self._toggles = world, toggles
        self._decor = Decor(world, MAX_GEOMS, _FINEST)
        self._buffer = mujoco.MjvScene(world.model, maxgeom=MAX_GEOMS)
        self._geoms = list(self._buffer.geoms)
        self._host = Host(self._buffer)
        self._camera = mujoco.MjvScene(world.model, maxgeom=0)
        self._font: Font | None = None
        self._size = 0, 0  # of the page, pixels
        self._has_complained = False

    def lay_out(
        self,
        data: mujoco.MjData,
        viewer: StudioViewer,
        inset: tuple[float, float, float, float],
    ) -> None:
        """Gives the viewer the decor of this moment.

        Args:
            data: the world's state, with frames up to date.
            viewer: has the camera, and gets the geoms.
            inset: what the page's own windows cover, see `View`.
        """
        if viewer.has_ui:  # outside of its frames Studio knows neither the page nor its text
            size = imgui.GetIO().DisplaySize
            self._size = int(size.x), int(size.y)
            if self._font is None:
                self._font = studio_font()
        width, height = self._size
        if self._font is None or width < 1 or height < 1:
            return
        mujoco.mjv_updateCamera(self._world.model, data, viewer.camera, self._camera)
        self.view = View.of_scene(self._camera, width, height, self._font, inset, _PANEL_ALPHA)
        pen = self._decor.draw(data, self._toggles, self.view)
        self._buffer.ngeom = 0
        self.grey = pen.grey
        self.left_out = pen.left_out + self._host.add(pen)
        self.count = self._buffer.ngeom
        viewer.extra_geoms[:] = self._geoms[: self.count]
        self._hide_doubles(viewer.data)
        if self.left_out and not self._has_complained:
            self._has_complained = True
            log.warning(
                "%d decor geoms found no room and are not shown: a browser takes %d",
                self.left_out, MAX_GEOMS,
            )  # fmt: skip

    def _hide_doubles(self, data: mujoco.MjData) -> None:
        """Takes doubles that are switched off out of the picture: of a pose, not of the model."""
        for double, on in zip(self._world.doubles.values(), self._toggles.doubles, strict=True):
            if not on:
                data.mocap_pos[double.mocap] = OUT_OF_SIGHT

    def point_at(self, data: mujoco.MjData, x: float, y: float) -> NDArray[np.float64] | None:
        """The point of the world (3,), m, at a pixel, y up: of the floor too."""
        if self.view is None:
            return None
        return point_at(self._world, data, self._decor.pen, self.view, (x, y))

    def pick(self, data: mujoco.MjData, x: float, y: float) -> Picked | None:
        """What is seen at a pixel, y up.

        Args:
            data: the world's state, with frames up to date.
            x: from the left.
            y: from below.
        """
        if self.view is None:
            return None
        return pick(self._world, data, self._decor.pen, self.view, (x, y))
