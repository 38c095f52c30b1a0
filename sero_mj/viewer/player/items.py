"""Geoms of decor as poses and sizes for a player."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array

_TRIANGLE = int(mujoco.mjtGeom.mjGEOM_TRIANGLE)


def poses(rows: np.ndarray) -> tuple[Array, Array]:
    """Returns quaternions, scalar first (k, 4), and sizes (k, 3), m, of rows of `GEOM`.

    The sides of a triangle are not perpendicular. Its x axis is along its first side; its sizes are
    the length of that side, and the extent of the second side along y and along x.
    """
    mats, sizes = rows["mat"].astype(float), rows["size"].astype(float)
    skew = (rows["type"] == _TRIANGLE).nonzero()[0]
    if len(skew):
        first, second = mats[skew, :, 0], mats[skew, :, 1] * sizes[skew, 1:2]
        normal = np.cross(first, second)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        across = np.cross(normal, first)
        mats[skew] = np.stack([first, across, normal], axis=-1)
        sizes[skew, 1] = _along(second, across)
        sizes[skew, 2] = _along(second, first)
    return quaternions_of(mats), sizes


def quaternions_of(mats: Array) -> Array:
    """Returns the quaternions, scalar first (k, 4), of rotations (k, 3, 3)."""
    quaternions = np.empty((len(mats), 4))
    for quaternion, mat in zip(quaternions, mats.reshape(-1, 9), strict=True):
        mujoco.mju_mat2Quat(quaternion, mat)
    return quaternions


def _along(vectors: Array, axes: Array) -> Any:
    return (vectors * axes).sum(axis=1)
