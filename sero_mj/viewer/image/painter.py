"""`Painter`: base class of renderers of a world, with or without a photo as background."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Self

import mujoco

from ...robots.assemble.world_view import WorldView
from ..decor.image_view import ImageView
from ..decor.toggles import Toggles
from .clicks import Gesture
from .image_files import Pixels
from .image_options import Click
from .picking import TOUCH_TOLERANCE, Picked, Pixel
from .scene_decor import SceneDecor

log = logging.getLogger(__name__)


class Painter(ABC):
    """Context manager that renders a world into images and handles clicks on these images.

    Attributes:
        decor: arrows, billboards and other visual features of the last frame.
        size: width and height of the images, pixels.
    """

    world: WorldView
    decor: SceneDecor
    size: tuple[int, int]
    _renderer: Any

    @property
    def toggles(self) -> Toggles:
        return self.decor.toggles

    @toggles.setter
    def toggles(self, toggles: Toggles) -> None:
        self.decor.toggles = toggles

    def pick(
        self, data: mujoco.MjData, x: float, y: float, tolerance: float = 0.0
    ) -> Picked | None:
        """Returns the item at a pixel, which is counted from the upper left corner, or None."""
        return self._lay_out(data).pick(data, self._pixel(x, y), tolerance)

    def click(
        self,
        data: mujoco.MjData,
        x: float,
        y: float,
        gesture: Gesture = "click",
        tolerance: float = 0.0,
    ) -> Picked | None:
        """Clicks on a pixel, and returns the item at this pixel as `pick` does."""
        return self._lay_out(data).click(data, self._pixel(x, y), gesture, tolerance)

    def hover(self, data: mujoco.MjData, x: float, y: float) -> Picked | None:
        """Moves the pointer to a pixel, and returns the item, whose name the next frames show."""
        return self._lay_out(data).hover(data, self._pixel(x, y))

    def _pixel(self, x: float, y: float) -> Pixel:
        return self.decor.from_above(x, y)

    def _lay_out(self, data: mujoco.MjData) -> SceneDecor:
        self.decor.lay_out(data, self._look(data))
        return self.decor

    @abstractmethod
    def render(self, data: mujoco.MjData) -> Pixels: ...

    @abstractmethod
    def _look(self, data: mujoco.MjData) -> ImageView: ...

    def close(self) -> None:
        self._renderer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def perform_clicks(painter: Painter, data: mujoco.MjData, clicks: Sequence[Click]) -> None:
    """Performs clicks in the given order, and logs the item at each pixel."""
    for x, y, gesture, finger in clicks:
        if gesture == "hover":
            picked = painter.hover(data, x, y)
        else:
            tolerance = TOUCH_TOLERANCE if finger else 0.0
            picked = painter.click(data, x, y, gesture, tolerance)  # type: ignore[arg-type]
        what = "no item" if picked is None else f"{picked.kind} {picked.name}"
        log.info("%s at %g,%g: %s", gesture, x, y, what)
