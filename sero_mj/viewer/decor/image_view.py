"""`ImageView`: a perspective camera, which projects points into an image."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array
from .font import DEFAULT_FONT, Font

Depth = TypeVar("Depth", float, Array)


@dataclass(frozen=True, eq=False)
class ImageView:
    """A perspective camera with the size and the font of its image.

    Pixels are counted from the lower left corner, x to the right, y up.

    Attributes:
        position: position of the camera, shape (3,), m.
        right: unit vector to the right of the image, shape (3,).
        up: unit vector to the top of the image, shape (3,).
        forward: unit vector in the viewing direction, shape (3,).
        tan_half_fovy: tangent of half the vertical field of view.
        near: distance of the near plane from the camera, m.
        inset: widths of the left, bottom, right and top margins that the UI covers, pixels.
            Billboards and other panels are placed between these margins.
    """

    position: Array
    right: Array
    up: Array
    forward: Array
    tan_half_fovy: float
    near: float
    width: int
    height: int
    font: Font = field(default=DEFAULT_FONT)
    inset: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @classmethod
    def of_scene(
        cls,
        scene: mujoco.MjvScene,
        width: int,
        height: int,
        font: Font = DEFAULT_FONT,
        inset: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> ImageView:
        """Returns the view of an `MjvScene` that was filled by `mjv_updateScene`."""
        left, right = scene.camera[0], scene.camera[1]
        position = (np.array(left.pos, np.float64) + right.pos) / 2
        forward = np.array(left.forward, np.float64)
        up = np.array(left.up, np.float64)
        near = float(left.frustum_near)
        return cls(
            position=position,
            right=np.cross(forward, up),
            up=up,
            forward=forward,
            tan_half_fovy=float(left.frustum_top - left.frustum_bottom) / (2 * near),
            near=near,
            width=width,
            height=height,
            font=font,
            inset=inset,
        )

    @cached_property
    def free(self) -> tuple[Array, Array]:
        """Lower left and upper right pixel of the area that the UI does not cover."""
        left, below, right, above = self.inset
        low = np.array([left, below])
        return low, np.maximum(np.array([self.width - right, self.height - above]), low)

    @cached_property
    def facing(self) -> Array:
        """Camera rotation (3, 3), with the columns right, up, and opposite to forward."""
        return np.stack([self.right, self.up, -self.forward], axis=1)

    @cached_property
    def _pixels_per_tan(self) -> float:
        return self.height / (2 * self.tan_half_fovy)

    @cached_property
    def _centre(self) -> Array:
        return np.array([self.width / 2, self.height / 2])

    def project(self, points: Array) -> tuple[Array, Array]:
        """Projects world points into the image.

        Returns:
            pixels, shape (..., 2), and depths along the viewing direction, shape (...), m. A point
            behind the camera has a negative depth and undefined pixels.
        """
        in_eye = (points - self.position) @ self.facing
        depth = -in_eye[..., 2]
        safe = np.where(np.abs(depth) < 1e-9, 1e-9, depth)
        pixels = in_eye[..., :2] * (self._pixels_per_tan / safe)[..., None]
        return pixels + self._centre, depth

    def sees(self, pixels: Array, depth: Array) -> NDArray[np.bool_]:
        """Returns a mask of the projected points that are in the image, shape (...)."""
        inside = (pixels >= 0).all(axis=-1) & (pixels < [self.width, self.height]).all(axis=-1)
        return np.asarray(inside & (depth > self.near))

    def at(self, pixels: Array, depth: Depth) -> Array:
        """Returns the world points, shape (..., 3), m, that `project` maps to pixels and depths.

        Args:
            depth: depths along the viewing direction, a scalar or shape (..., 1), m.
        """
        scale = self.pixel_size(depth)
        middle = self.position + depth * self.forward
        return np.asarray(middle + ((pixels - self._centre) * scale) @ self.facing[:, :2].T)

    def pixel_size(self, depth: Depth) -> Depth:
        return depth / self._pixels_per_tan
