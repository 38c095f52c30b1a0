"""`PhotoViewport`: shows images of a camera with arrows, axes and billboards in a window."""

from __future__ import annotations

import mujoco
import numpy as np
from PIL import Image

from ...robots.assemble.world_view import WorldView
from ...viewer.decor.toggles import Toggles
from ...viewer.image.image_files import Pixels
from ...viewer.session.status_line import Piece
from ...viewer.window.glfw_window import GlWindow
from ...viewer.window.viewport import Pane, Viewport
from .camera_feed import CameraFeed, VideoFeed
from .over_photo import PhotoPainter

_BESIDE = (0.07, 0.08, 0.09, 1.0)  # color of the window beside the image


class PhotoViewport(Viewport):
    """A viewport that shows the images of a camera or video, scaled to fit into it."""

    def __init__(
        self,
        world: WorldView,
        toggles: Toggles,
        context: mujoco.MjrContext,
        feed: CameraFeed | VideoFeed,
    ) -> None:
        super().__init__(world, toggles, context)
        self._feed = feed
        self._painter: PhotoPainter | None = None
        self._whole = self.rect
        self._photo: Pixels | None = None
        self._number = 0

    @property
    def fixed(self) -> str:
        return f"the view is fixed to {self._feed.name}"

    @property
    def pieces(self) -> list[Piece]:
        return [self._feed.piece]

    def update(self, data: mujoco.MjData, camera: mujoco.MjvCamera, pane: Pane) -> None:
        """Prepares a frame with the view of the feed. The argument `camera` is ignored."""
        rect, typesetter, covered = pane
        of = self._feed.camera
        scale = min(rect.width / of.width, rect.height / of.height)
        size = max(round(of.width * scale), 1), max(round(of.height * scale), 1)
        self._whole = rect
        self.rect = mujoco.MjrRect(
            rect.left + (rect.width - size[0]) // 2,
            rect.bottom + (rect.height - size[1]) // 2,
            *size,
        )
        self.width = size[0]
        painter = self._painter
        if painter is None or (painter.camera.width, painter.camera.height) != size:
            # The undistorted image must fit into the buffer of the window.
            largest = rect.left + rect.width, rect.bottom + rect.height
            self._painter = painter = PhotoPainter(self.world, of.resized(*size), largest)
            self._photo = None
        number, pixels = self._feed.latest(float(data.time))
        if self._photo is None or number != self._number:
            self._number = number
            self._photo = np.asarray(
                Image.fromarray(pixels).resize(size, Image.Resampling.BILINEAR)
            )
        scene = self._scene
        self.fill(data, mujoco.MjvCamera(), scene)  # `painter` replaces the camera
        self._typesetter = typesetter
        beside = self.rect.left - rect.left
        inset = (min(max(covered - beside, 0.0), 0.6 * size[0]), 0.0, 0.0, 0.0)
        self.draw(data, painter.look(scene, typesetter.font, inset), scene)

    def render(self, gl: GlWindow, *, quickly: bool = False) -> None:
        painter, photo, rect = self._painter, self._photo, self.rect
        if painter is None or photo is None:
            return
        drawn = mujoco.MjrRect(0, 0, *painter.size)

        def draw() -> Pixels:
            mujoco.mjr_render(drawn, self._scene, gl.context)
            return gl.read(drawn)

        over = painter.over(photo, self._scene, draw)
        mujoco.mjr_rectangle(mujoco.MjrRect(0, 0, *gl.size), *_BESIDE)
        mujoco.mjr_drawPixels(over[::-1].ravel(), None, rect, gl.context)
        self._draw_panels(gl, int(rect.left))
