"""Rigid frames as 4x4 arrays, and array types, without MuJoCo.

`T_a_b` transforms coordinates in frame b to coordinates in frame a.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import Problem, mismatch

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]

_NICE = (1.0, 2.0, 5.0)
_ROTATION_KEYS = ("rpy", "rpy_deg", "quat")
# Accepts rotations that are typed with four digits, such as 0.7071.
_TYPED_ROTATION_TOLERANCE = 1e-3
NOT_A_ROTATION = "the upper left 3 x 3 part is not a rotation (orthonormal, determinant +1)"
# Reflects a frame T at the xz plane: MIRROR @ T @ MIRROR.
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def rotation_about(axis: int, angle: float | Array) -> Array:
    """Returns matrices (..., 3, 3) that rotate by angles (...) in rad about axis 0, 1, 2 (xyz)."""
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.zeros((*np.shape(angle), 3, 3))
    matrix[..., axis, axis] = 1.0
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[..., i, i] = matrix[..., j, j] = c
    matrix[..., i, j], matrix[..., j, i] = -s, s
    return matrix


def empty_transforms(shape: tuple[int, ...]) -> Array:
    """Returns transforms (*shape, 4, 4) with the last row 0 0 0 1 and zeros above it.

    Each matrix element is contiguous over `shape`, which reduces the time for computing 1000 poses
    of seven joints from 375 us to 250 us.
    """
    T = np.zeros((4, 4, *shape)).transpose(*range(2, len(shape) + 2), 0, 1)
    T[..., 3, 3] = 1.0
    return T


def rotation_to_z(rotation: Array, axis: Array) -> Array:
    """Returns the rotation (3, 3) nearest to `rotation` whose z axis points along `axis` (3,).

    `axis` must not be zero.
    """
    z = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    x = rotation[:, 0] - (rotation[:, 0] @ z) * z
    if np.linalg.norm(x) < 0.5:  # x is nearly along z; y is not
        x = np.cross(rotation[:, 1], z)
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def rotation_from_rpy(rpy: Array) -> Array:
    """Returns the rotation (3, 3) by roll, pitch, yaw in rad about fixed x, y, z axes (URDF)."""
    roll, pitch, yaw = rpy
    return rotation_about(2, yaw) @ rotation_about(1, pitch) @ rotation_about(0, roll)


def rpy_from_rotation(rotation: Array) -> Array:
    """Returns roll, pitch, yaw in rad of a rotation (3, 3). Yaw is zero at ±90 degrees of pitch."""
    R = rotation
    across = float(np.hypot(R[0, 0], R[1, 0]))
    pitch = np.arctan2(-R[2, 0], across)
    if across < 1e-9:
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])])


def rotation_from_quat(quat: Array) -> Array:
    """Returns the rotation (3, 3) of a quaternion w, x, y, z, which need not have unit length."""
    quat = quat / np.abs(quat).max()  # squares of huge numbers would overflow
    w, x, y, z = quat / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quat_from_rotation(rotation: Array) -> Array:
    """Returns the unit quaternion w, x, y, z of a rotation (3, 3), with a non-negative w.

    Uses the formula with the largest divisor out of four (Shepperd 1978).
    """
    R = rotation
    trace = float(np.trace(R))
    squares = np.array([trace, *np.diag(R)])  # the largest belongs to the largest component
    k = int(np.argmax(squares))
    if k == 0:
        quat = np.array([1 + trace, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        quat = np.empty(4)
        quat[0] = R[m, j] - R[j, m]
        quat[1 + i] = 1 + R[i, i] - R[j, j] - R[m, m]
        quat[1 + j], quat[1 + m] = R[j, i] + R[i, j], R[m, i] + R[i, m]
    quat = quat / np.linalg.norm(quat)
    return np.asarray(-quat if quat[0] < 0 else quat)


def frame(rotation: Array | None = None, position: Array | None = None) -> Array:
    """Returns a 4x4 frame with a rotation (3, 3) and a position (3,) in m (default: identity)."""
    matrix = np.eye(4)
    if rotation is not None:
        matrix[:3, :3] = rotation
    if position is not None:
        matrix[:3, 3] = position
    return matrix


def inverse(T_a_b: Array) -> Array:
    """Returns the inverses `T_b_a` of rigid frames `T_a_b`, shape (..., 4, 4)."""
    result = np.zeros_like(T_a_b)
    transposed = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    result[..., :3, :3] = transposed
    result[..., :3, 3] = -np.einsum("...ij,...j->...i", transposed, T_a_b[..., :3, 3])
    result[..., 3, 3] = 1.0
    return result


def rotation_angle(rotation: Array) -> float:
    """Returns the angle in rad of a rotation matrix (3, 3), accurate near 0 and near pi."""
    return float(rotation_angles(rotation))


def rotation_angles(rotations: Array) -> Array:
    """Returns the angles (...,) in rad of rotations (..., 3, 3), accurate near 0 and near pi."""
    twice = rotations - rotations.mT
    sine = 0.5 * np.sqrt(twice[..., 2, 1] ** 2 + twice[..., 0, 2] ** 2 + twice[..., 1, 0] ** 2)
    cosine = 0.5 * (np.trace(rotations, axis1=-2, axis2=-1) - 1.0)
    return np.asarray(np.arctan2(sine, cosine))


def frame_from(value: Any, numbers: Callable[[Any], Array]) -> Array:
    """Parses a frame from a file or a user.

    Args:
        value: 4x4 matrix, list of its 16 numbers row by row, or mapping with `xyz` (m) and one of
            `rpy` (rad), `rpy_deg`, `quat` (w, x, y, z).
        numbers: function that converts a list to a float64 array.

    Raises:
        ValueError: the frame is invalid.
    """
    if isinstance(value, Mapping):
        return _frame_from_table(value, numbers)
    matrix = numbers(value)
    if matrix.size != 16:
        raise mismatch(matrix.size, "4 x 4, or { xyz = [...], rpy = [...] }", of="numbers")
    matrix = matrix.reshape(4, 4).copy()
    if matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise mismatch(matrix[3].tolist(), "[0, 0, 0, 1] (row-major)", "last row is")
    matrix[:3, :3] = nearest_rotation(matrix[:3, :3])
    return matrix


def nearest_rotation(matrix: Array) -> Array:
    """Returns the rotation nearest to a matrix that was typed with few digits.

    Raises ValueError if the matrix is not approximately a rotation.
    """
    # Rejects large entries before their squares overflow.
    far = np.abs(matrix).max() > 2.0
    off = np.inf if far else float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > _TYPED_ROTATION_TOLERANCE or np.linalg.det(matrix) < 0:
        raise ValueError(NOT_A_ROTATION)
    if off < 1e-14:
        return matrix
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)


def _frame_from_table(table: Mapping[str, Any], numbers: Callable[[Any], Array]) -> Array:
    known = ("xyz", *_ROTATION_KEYS)
    for key in table:
        if key not in known:
            raise Problem("", "unknown key", found=key, available=known).error()
    declared = [key for key in _ROTATION_KEYS if key in table]
    if len(declared) > 1:
        both = " and ".join(map(repr, declared[:2]))
        raise ValueError(f"found both {both}; expected one rotation")

    def vector(key: str, length: int) -> Array:
        array = numbers(table[key])
        if array.shape != (length,):
            if array.size == length:
                raise ValueError(f"'{key}' is nested; expected {length} numbers in one list")
            raise mismatch(array.size, length, f"'{key}' has", of="numbers")
        return array

    position = vector("xyz", 3) if "xyz" in table else None
    rotation = None
    if "rpy" in table:
        rotation = rotation_from_rpy(vector("rpy", 3))
    elif "rpy_deg" in table:
        rotation = rotation_from_rpy(np.deg2rad(vector("rpy_deg", 3)))
    elif "quat" in table:
        quat = vector("quat", 4)
        if np.abs(quat).max() < 1e-6:
            raise ValueError("'quat' is zero; expected a unit quaternion w, x, y, z")
        rotation = rotation_from_quat(quat)
    return frame(rotation, position)


def round_down_1_2_5(value: float) -> float:
    """Rounds a positive value down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in _NICE if step * power <= value * (1 + 1e-9)) * power)
