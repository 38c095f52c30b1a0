"""Draws anti-aliased triangles into images, for the thin tips of billboard leaders.

Filament renders images without multisampling, so that tips that are thinner than a pixel would look
like dashes.
"""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array, Bools
from ...viewer.image.image_files import Pixels

_TRIANGLE = int(mujoco.mjtGeom.mjGEOM_TRIANGLE)
_DECOR = int(mujoco.mjtCatBit.mjCAT_DECOR)
_LAID_OUT = 2.0  # maximum depth of leaders, in units of the near plane distance


def is_flat(rows: np.ndarray, eye: mujoco.MjvGLCamera) -> Bools:
    """Returns a mask (k,) of the geoms that are leaders: triangles just behind the near plane."""
    forward = np.array(eye.forward, float)
    depth = (rows["pos"].astype(float) - np.array(eye.pos, float)) @ forward
    near = (depth > 0) & (depth < _LAID_OUT * eye.frustum_near)
    return np.asarray(near & (rows["type"] == _TRIANGLE) & (rows["category"] == _DECOR))


def corners_of(rows: np.ndarray, eye: mujoco.MjvGLCamera, width: int, height: int) -> Array:
    """Projects the corners of triangle geoms to pixels with y down, shape (k, 3, 2)."""
    first = rows["pos"].astype(float)
    edges = rows["mat"].astype(float)[:, :, :2] * rows["size"].astype(float)[:, None, :2]
    world = np.stack([first, first + edges[:, :, 0], first + edges[:, :, 1]], axis=1)
    forward, up = np.array(eye.forward, float), np.array(eye.up, float)
    in_eye = world - np.array(eye.pos, float)
    scale = eye.frustum_near / (in_eye @ forward)
    top, bottom = float(eye.frustum_top), float(eye.frustum_bottom)
    half = float(eye.frustum_width) or 0.5 * width / height * (top - bottom)
    x = (in_eye @ np.cross(forward, up)) * scale - eye.frustum_center
    y = (in_eye @ up) * scale
    return np.stack([(x + half) / (2 * half) * width, (top - y) / (top - bottom) * height], axis=-1)


def blend(image: Pixels, corners: Array, rgba: Array) -> None:
    """Draws anti-aliased triangles into an image in place.

    Args:
        corners: corners of the triangles, shape (k, 3, 2), pixels, y down.
        rgba: displayed colors of the triangles, shape (k, 4).
    """
    height, width = image.shape[:2]
    for triangle, colour in zip(corners, rgba, strict=True):
        low = np.maximum(np.floor(triangle.min(axis=0)).astype(int) - 1, 0)
        high = np.minimum(np.ceil(triangle.max(axis=0)).astype(int) + 1, (width, height))
        if not (low < high).all():
            continue
        x, y = np.meshgrid(*(np.arange(a, b) + 0.5 for a, b in zip(low, high, strict=True)))
        shares = []
        middle = triangle.mean(axis=0)
        for k in range(3):
            start, along = triangle[k], triangle[(k + 1) % 3] - triangle[k]
            length = float(np.hypot(*along)) or 1.0
            normal = np.array([-along[1], along[0]]) / length
            normal *= 1.0 if (middle - start) @ normal >= 0 else -1.0
            inside = (x - start[0]) * normal[0] + (y - start[1]) * normal[1]
            shares.append(np.clip(inside + 0.5, 0.0, 1.0))
        first, second, third = np.sort(np.stack(shares), axis=0)
        cover = np.clip(first + second - 1.0, 0.0, 1.0) * third * colour[3]
        below = image[low[1] : high[1], low[0] : high[0]]
        mixed = below + cover[..., None] * (255 * colour[:3] - below)
        below[:] = np.rint(mixed).astype(np.uint8)
