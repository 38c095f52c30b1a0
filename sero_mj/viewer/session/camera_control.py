"""`CameraControl`: moves the camera of a window or page."""

from __future__ import annotations

from collections.abc import Callable

import mujoco

from ...base.frames import Array
from ..image.camera import Navigator
from ..image.framing import standing_back
from ..image.scene_decor import SceneDecor


class CameraControl:
    """Moves the camera of a window or page, unless a background photo fixes it.

    Args:
        decor: function that returns the decor of the last frame.
    """

    def __init__(
        self,
        navigator: Navigator,
        data: mujoco.MjData,
        decor: Callable[[], SceneDecor],
        say: Callable[[str], None],
    ) -> None:
        self._navigator, self._data, self._decor, self._say = navigator, data, decor, say

    def choose(self, number: int) -> str:
        """Selects a camera by number. The first camera is 1, and the initial view is 0."""
        return self._decor().fixed or self._navigator.choose(number)

    def follow(self, frame: str | None) -> str:
        """Follows a coordinate frame, or stops if it is None. Returns a message for the user."""
        return self._decor().fixed or self._navigator.follow(self._data, frame)

    def center(self, point: Array) -> None:
        """Sets the look-at point of the camera, shape (3,), m."""
        decor = self._decor()
        assert decor.view is not None  # The point was picked in an image.
        if decor.fixed:
            self._say(decor.fixed)
            return
        self._navigator.free(decor.view.position, decor.view.forward)
        self._navigator.camera.lookat = point

    def move(self, how: str, right: float, down: float) -> None:
        """Rotates, pans or zooms the camera.

        Args:
            how: kind of motion: `orbit`, `pan` or `zoom`.
            right: motion of the pointer to the right, relative to the image height.
            down: downward motion of the pointer, relative to the image height, or the number of
                wheel notches for `zoom`.
        """
        view, navigator = self._decor().view, self._navigator
        if view is None or self._decor().fixed:
            return
        navigator.free(view.position, view.forward)
        if how == "zoom":
            navigator.zoom(down)
        elif how == "pan":
            back = standing_back(view.width, view.height, navigator.needed)
            depth = navigator.camera.distance * back
            navigator.pan(right, down, view.tan_half_fovy, depth)
        else:
            navigator.orbit(right, down)
