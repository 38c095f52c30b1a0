"""What Studio shows of a world: decor within the limit of a browser, stale robots grey."""

from __future__ import annotations

import copy
import time
import zlib

import mujoco
import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.web import state_payload

from ...base.frames import Bools
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT
from ..decor.font import Font
from ..decor.geom_buffer import GREY, MAX_GEOMS
from ..decor.picture_view import PictureView
from ..decor.scene_writer import GREYNESS
from ..decor.toggles import Toggles
from ..session.scene_decor import SceneDecor
from .browsers import Size
from .studio import StudioViewer

_LINE = 1.25  # height of decor text over that of Studio's text
_ARROW_GEOMS = 34  # of a round arrow; each adds 15 kB/s for every browser
_REPEATS = 64  # of a character that is measured, for Studio rounds up to pixels
_PANEL_ALPHA = 0.92  # Studio draws panels more transparent than the classic renderer
# Studio 4.0's client clips labels that are closer to the left and upper edge of the page.
CUT_OFF = 68.0, 64.0  # pixels
_MOST_SIZES = 4  # of pages that have a layout of their own; each takes 1 to 2 ms of a picture
_FETCHING = 1.0  # time for browsers to fetch a model, and minimum time between two changes, s
_DEFAULT_RGBA = 0.5, 0.5, 0.5, 1.0  # rgba of a geom that has the colour of its material


def studio_font() -> Font:
    """Returns the font of the page's labels: that of Studio's user interface.

    Studio centres a label below its position.
    """
    text = imgui.GetTextLineHeight()
    widths = np.zeros(128)
    widths[32:127] = [
        imgui.CalcTextSize(_REPEATS * chr(code)).x / _REPEATS for code in range(32, 127)
    ]
    return Font(round(_LINE * text), widths, anchor=(0.5, (1.0 + 1.0 / _LINE) / 2))


class WebDecor(SceneDecor):
    """Lays out the decor for the browser that has control, and passes it to Studio.

    Args:
        world: the compiled scene.
        toggles: what is shown.

    Attributes:
        count: number of geoms of the last picture.
    """

    def __init__(self, world: WorldView, toggles: Toggles) -> None:
        self.count = 0
        super().__init__(world, toggles, MAX_GEOMS, _ARROW_GEOMS)
        self._buffer = mujoco.MjvScene(world.model, maxgeom=MAX_GEOMS)
        self._geoms = list(self._buffer.geoms)
        self._camera = mujoco.MjvScene(world.model, maxgeom=0)
        self._font: Font | None = None
        self.size = 0, 0  # of the page, pixels
        self._others: dict[Size, WebDecor] = {}  # for other browsers, by the size of their page

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
            self.size = int(size.x), int(size.y)
            if self._font is None:
                self._font = studio_font()
        width, height = self.size
        if self._font is None or width < 1 or height < 1:
            return
        viewer.extra_geoms[:] = self.geoms(data, viewer.camera, self.size, self._font, inset)
        self._hide_doubles(viewer.data)
        if viewer.has_ui:
            self._show_to_others(viewer, data)

    def geoms(
        self,
        data: mujoco.MjData,
        camera: mujoco.MjvCamera,
        size: Size,
        font: Font,
        inset: tuple[float, float, float, float],
    ) -> list[mujoco.MjvGeom]:
        """Returns the current decor for a page.

        Args:
            data: the world's state, with frames up to date.
            camera: of the page.
            size: of the page.
            font: of its labels.
            inset: see `PictureView`.
        """
        mujoco.mjv_updateCamera(self.world.model, data, camera, self._camera)
        view = PictureView.of_scene(self._camera, *size, font, inset, _PANEL_ALPHA)
        self._buffer.ngeom = 0
        self.draw(data, view, self._buffer)
        self.count = self._buffer.ngeom
        return self._geoms[: self.count]

    def _show_to_others(self, viewer: StudioViewer, data: mujoco.MjData) -> None:
        """Lays the decor out for browsers whose pages have another size."""
        assert self._font is not None
        browsers, toggles = viewer.server.browsers, self.toggles
        sizes = browsers.sizes_beside(self.size, _MOST_SIZES)
        self._others = {
            size: self._others.get(size) or WebDecor(self.world, toggles) for size in sizes
        }
        hover, toggles.hover = toggles.hover, None  # the pointer is that of the one in control
        inset = (CUT_OFF[0], 0.0, 0.0, CUT_OFF[1])
        browsers.states = {
            size: viewer.payload(decor.geoms(data, viewer.camera, size, self._font, inset))
            for size, decor in self._others.items()
        }
        toggles.hover = hover

    def _hide_doubles(self, data: mujoco.MjData) -> None:
        """Moves doubles that are switched off out of sight."""
        for double, on in zip(self.world.doubles.values(), self.toggles.doubles, strict=True):
            if not on:
                data.mocap_pos[double.mocap] = OUT_OF_SIGHT


def greyed(model: mujoco.MjModel, grey: Bools) -> mujoco.MjModel:
    """Returns a copy of a model in which the geoms `grey`, (ngeom,) bool, are grey."""
    model = copy.deepcopy(model)
    rgba = model.geom_rgba
    of_material = (rgba == np.array(_DEFAULT_RGBA, rgba.dtype)).all(axis=1)
    of_material &= model.geom_matid >= 0
    rgba[of_material] = model.mat_rgba[model.geom_matid[of_material]]
    rgba[grey, :3] += GREYNESS * (np.array(GREY) - rgba[grey, :3])
    return model


class Greying:
    """Shows robots without fresh data grey, by switching browsers between models.

    Studio 4.0 sends colours only with a model. So a model with other colours is announced in
    advance; browsers fetch it in the background and switch to it within one or two frames (45 ms
    for the LWR).

    Args:
        viewer: of the page.
    """

    def __init__(self, viewer: StudioViewer) -> None:
        self._viewer = viewer
        self._shown = b""
        self._changed = time.monotonic() - _FETCHING
        self._announced: dict[bytes, tuple[int, float]] = {}  # crc32, and time of the announcement
        self._is_first = True

    def show(self, grey: Bools | None) -> None:
        """Switches to a model with these grey geoms once browsers have had time to fetch it.

        Changes that revert faster are not shown; the label of the robot shows them.

        Args:
            grey: geoms, (ngeom,) bool; None for none.
        """
        key = b"" if grey is None or not grey.any() else grey.tobytes()
        if key == self._shown:
            self._is_first = False
            return
        now = time.monotonic()
        server = self._viewer.server
        if key not in self._announced or server.cached_model(self._announced[key][0]) is None:
            self._announced[key] = self._announce(grey if key else None), now
        crc32, since = self._announced[key]
        if not self._is_first and now - max(since, self._changed) < _FETCHING:
            return
        self._shown, self._changed, self._is_first = key, now, False
        bundle = server.cached_model(crc32)
        assert bundle is not None  # just announced, or found above
        self._viewer.change_model(bundle, crc32)

    def _announce(self, grey: Bools | None) -> int:
        model = self._viewer.model
        bundle = state_payload.serialize_model_bundle(
            model if grey is None else greyed(model, grey)
        )
        self._viewer.server.add_model(bundle)
        return zlib.crc32(bundle)
