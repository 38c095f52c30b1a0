"""`PageView`: the camera of a page, which the browser in control moves."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from ...robots.assemble.world_view import WorldView
from ..decor.font import DEFAULT_FONT, Font
from ..decor.image_view import ImageView
from ..image.camera import Navigator
from ..image.framing import stand_back
from .sections import Sections

_SIZE = (1280, 800)  # size of the image in pixels before a browser sends its own size
_LINE = 20  # height of a line of text in `page.css`, pixels
_FONT = Font(_LINE, DEFAULT_FONT.widths * _LINE / DEFAULT_FONT.height)
_FREE = int(mujoco.mjtCamera.mjCAMERA_FREE)
_FIXED = int(mujoco.mjtCamera.mjCAMERA_FIXED)
_MAX_LENGTH = 1e6  # m


class PageView:
    """The camera of a page, and the size of the image in the browser in control."""

    def __init__(self, world: WorldView, navigator: Navigator) -> None:
        self._world = world
        self.navigator = navigator
        self.size = _SIZE
        self._scene = mujoco.MjvScene(world.model, maxgeom=0)  # Only its camera is needed.
        self._last: tuple[object, ...] = ()  # camera parameters that browsers have received
        self._serial = 0  # number of camera motions by the server

    def of_data(self, data: mujoco.MjData) -> ImageView:
        scene, camera, (width, height) = self._scene, self.navigator.camera, self.size
        mujoco.mjv_updateCamera(self._world.model, data, camera, scene)
        stand_back(scene, camera, width, height, self.navigator.needed)
        return ImageView.of_scene(scene, width, height, _FONT)

    def take(self, fixed: int, look_at: Sequence[float], numbers: Sequence[float]) -> None:
        """Sets the camera to the parameters that the browser in control has sent.

        Args:
            fixed: index of a scene camera; -1 for a free camera.
            look_at: look-at point, shape (3,), m; ignored while the camera follows a frame.
            numbers: distance in m, azimuth in degrees and elevation in degrees.

        Raises:
            ValueError: the camera does not exist, or a number is not finite.
        """
        every = np.array([*look_at, *numbers], float)
        is_valid = every.shape == (6,) and np.isfinite(every).all() and every[3] > 0
        if not (is_valid and np.abs(every).max() < _MAX_LENGTH):
            raise ValueError(
                "the camera parameters are invalid; expected finite numbers and a distance above 0"
            )
        if not -1 <= fixed < self._world.model.ncam:
            raise ValueError(f"found camera {fixed}; expected -1 to {self._world.model.ncam - 1}")
        camera = self.navigator.camera
        if self.navigator.following is None:
            camera.lookat[:] = every[:3]
        camera.distance, camera.azimuth, camera.elevation = every[3:]
        camera.type, camera.fixedcamid = (_FREE, -1) if fixed < 0 else (_FIXED, fixed)
        self._last = self._key()

    def _key(self) -> tuple[object, ...]:
        camera = self.navigator.camera
        looks_at = () if self.navigator.following is not None else tuple(camera.lookat)
        return (int(camera.type), int(camera.fixedcamid), camera.distance, camera.azimuth,
                camera.elevation, *looks_at)  # fmt: skip

    def put(self, sections: Sections, holder: int | None) -> None:
        """Writes the camera. The browser in control ignores it unless the server has moved it."""
        camera, key, by = self.navigator.camera, self._key(), holder
        if key != self._last:
            self._last, by = key, None
            self._serial += 1
        found = {
            "by": by,
            "serial": self._serial,
            "fixed": int(camera.fixedcamid) if int(camera.type) == _FIXED else -1,
            "lookAt": [round(float(each), 5) for each in camera.lookat],
            "distance": round(float(camera.distance), 5),
            "azimuth": round(float(camera.azimuth), 4),
            "elevation": round(float(camera.elevation), 4),
        }
        sections.put("camera", found)
        sections.put("lookAt", found["lookAt"] if self.navigator.following is not None else None)
