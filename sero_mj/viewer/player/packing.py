"""Encodes arrays so that they compress well with deflate. `js/src/data.js` decodes them.

Values that change in time are stored as differences between frames, with the sign in the lowest
bit. Each channel is contiguous, and bytes of the same significance are grouped.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from ..decor.geom_buffer import FIRST_SHAPE

_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_TRIANGLE = int(mujoco.mjtGeom.mjGEOM_TRIANGLE)


class PackedArrays:
    """The arrays that follow the JSON head of a page. The head refers to them by number."""

    def __init__(self) -> None:
        self.arrays: list[bytes] = []

    def put(self, array: np.ndarray) -> list[Any]:
        """Adds an array, and returns its number, element type and element count."""
        array = np.ascontiguousarray(array)
        planes = array.reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T
        self.arrays.append(planes.tobytes())
        return [len(self.arrays) - 1, array.dtype.str[1:], array.size]

    def moving(self, numbers: np.ndarray, step: float) -> list[Any]:
        """Adds C channels of F frames, shape (F, C), as differences in multiples of `step`."""
        whole = np.round(numbers / step).astype(np.int64)
        differences = np.diff(whole, axis=0, prepend=0).T
        return self.put(unsigned(folded(differences)))


def folded(differences: Ints) -> Ints:
    """Converts signed integers to nonnegative integers with the sign in the lowest bit."""
    return np.asarray((differences << 1) ^ (differences >> 63))


def unsigned(numbers: Ints) -> np.ndarray:
    """Converts nonnegative integers to the smallest unsigned type."""
    for kind in (np.uint8, np.uint16):
        if numbers.max(initial=0) <= np.iinfo(kind).max:
            return numbers.astype(kind)
    return numbers.astype(np.uint32)


def rounded(numbers: Any, digits: int = 6) -> list[Any]:
    """Rounds numbers, and returns them as nested lists for JSON."""
    found: list[Any] = (np.round(np.asarray(numbers, float), digits) + 0.0).tolist()  # not -0.0
    return found


def differing(numbers: np.ndarray) -> np.ndarray:
    """Returns the differences between neighboring integers, shape (n,), in the form of `folded`."""
    whole: Ints = np.asarray(numbers, np.int64)
    return unsigned(folded(np.diff(whole, prepend=0)))


def types_of(rows: np.ndarray) -> Ints:
    """Returns the types of rows of `GEOM`. That of an arrow or axis is the number of its mesh."""
    is_shape = (rows["type"] == _MESH) & (rows["dataid"] >= FIRST_SHAPE)
    return np.asarray(np.where(is_shape, rows["dataid"], rows["type"]))


def poses(rows: np.ndarray) -> tuple[Array, Array]:
    """Returns quaternions (w, x, y, z), shape (k, 4), and sizes, shape (k, 3), of rows of `GEOM`.

    The x axis of a triangle points along its first side. Its sizes are the length of the first
    side, and the extents of the second side along y and x.
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
    """Converts rotation matrices, shape (k, 3, 3), to quaternions (w, x, y, z), shape (k, 4)."""
    quaternions = np.empty((len(mats), 4))
    for quaternion, mat in zip(quaternions, mats.reshape(-1, 9), strict=True):
        mujoco.mju_mat2Quat(quaternion, mat)
    return quaternions


def _along(vectors: Array, axes: Array) -> Any:
    return (vectors * axes).sum(axis=1)
