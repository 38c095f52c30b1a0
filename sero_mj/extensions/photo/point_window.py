"""`PointWindow`: a window in which the user clicks points of the robot in a photo."""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ...viewer.image.camera import find_camera
from ...viewer.session.input import Clicked, Event, Mouse, Moved
from ...viewer.window.glfw_window import GlWindow
from .point_board import PointBoard

_MORE = 100  # additional capacity for geoms that are not part of the model
_DOT = 0.03  # radius of the selected point in the sketch, fraction of the model extent
_DOT_RGBA = np.array([1.0, 0.55, 0.1, 1.0], np.float32)
_PAUSE = 0.03  # time between queries of events, s


class PointWindow:
    """Context manager that shows a `PointBoard` in a window.

    Args:
        data: state of the world in the photo.
        points: world positions of the points of the board, shape (k, 3), m.
        size: width and height of the window in screen coordinates.

    Attributes:
        is_done: whether the user has accepted the result.

    Raises:
        RenderError: there is no display.
    """

    def __init__(
        self,
        world: WorldView,
        data: mujoco.MjData,
        points: Array,
        board: PointBoard,
        title: str,
        size: tuple[int, int] = (1280, 800),
    ) -> None:
        self.gl = GlWindow(world, size, title)
        self.board, self.is_done = board, False
        self._world, self._data, self._points = world, data, points
        self._mouse = Mouse()
        self._scene = mujoco.MjvScene(world.model, maxgeom=world.model.ngeom + _MORE)
        self._option = mujoco.MjvOption()
        self._option.flags[mujoco.mjtVisFlag.mjVIS_TRANSPARENT] = 1
        self._camera = find_camera(world)
        self._drawn: tuple[int, int] | None = None  # size of the current image; None if outdated

    def frame(self) -> bool:
        """Handles events, draws the board if needed, and returns whether the window is open."""
        for event in self.gl.events():
            self._take(event)
        width, height = self.gl.size
        if width and height and self._drawn != (width, height):
            self._draw(width, height)
            self._drawn = (width, height)
        self.gl.wait(_PAUSE)
        return not self.gl.is_closing

    def run(self) -> bool:
        while self.frame():
            pass
        return self.is_done

    def _take(self, event: Event) -> None:
        board, height = self.board, self.gl.size[1]
        self._drawn = self._drawn if event.kind == "move" else None
        if event.kind == "key":
            if event.key == "escape":
                self.gl.request_close()
            elif event.key == "enter" and board.found is not None:
                self.is_done = True
                self.gl.request_close()
            else:
                board.press(event.key)
            return
        found = self._mouse.take(event)
        if isinstance(found, Clicked) and not found.center:
            board.click(found.x, height - 1 - found.y)
        elif isinstance(found, Moved):
            self._drawn = None
            at = self._mouse.position
            if found.how != "zoom":
                board.pan(found.right, found.down)
            elif at is not None:
                board.zoom(found.down, at[0], height - 1 - at[1])

    def _draw(self, width: int, height: int) -> None:
        board, context = self.board, self.gl.context
        board.resize(width, height, int(self.gl.typesetter.font.height))
        whole = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_drawPixels(board.image()[::-1].ravel(), None, whole, context)
        left, top, wide, high = board.sketch()
        scene, every = self._scene, mujoco.mjtCatBit.mjCAT_ALL
        model = self._world.model
        mujoco.mjv_updateScene(model, self._data, self._option, None, self._camera, every, scene)
        dot = scene.geoms[scene.ngeom]
        radius = np.full(3, _DOT * model.stat.extent)
        mujoco.mjv_initGeom(
            dot, mujoco.mjtGeom.mjGEOM_SPHERE, radius, self._points[board.chosen],
            np.eye(3).ravel(), _DOT_RGBA,
        )  # fmt: skip
        dot.emission = 1.0
        scene.ngeom += 1
        if high > 40:
            mujoco.mjr_render(mujoco.MjrRect(left, height - top - high, wide, high), scene, context)
        self.gl.swap()

    def close(self) -> None:
        self.gl.close()

    def __enter__(self) -> PointWindow:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
