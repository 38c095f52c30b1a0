"""Inertia tensors in numpy: parsing, validation, and rotation into other frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..declaration import numbers

Array = NDArray[np.float64]

# Relative tolerance: typed values are rounded, and a flat plate meets the bound exactly.
_ROUNDING = 1e-6


def tensors_from(value: Any) -> Array:
    """Parses inertia tensors as given in a file.

    Args:
        value: one entry per link, each 6 numbers (Ixx, Iyy, Izz, Ixy, Ixz, Iyz, the entries of
            the tensor, as in URDF and MJCF) or 3 x 3.

    Returns:
        (m, 3, 3), kg m2.

    Raises:
        ValueError: other counts, or a matrix that is not symmetric.
    """
    if not isinstance(value, list | tuple | np.ndarray):
        raise ValueError(f"found {value!r}; expected one tensor per link")
    tensors = np.empty((len(value), 3, 3))
    for k, entry in enumerate(value):
        array = numbers(entry)
        if array.shape == (6,):
            xx, yy, zz, xy, xz, yz = array
            tensors[k] = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        elif array.shape == (3, 3):
            if np.abs(array - array.T).max() > _ROUNDING * max(float(np.abs(array).max()), 1e-300):
                raise ValueError(
                    f"{link_name(k)}: found {array.tolist()}; expected a symmetric 3x3"
                )
            tensors[k] = (array + array.T) / 2
        else:
            found = " x ".join(map(str, array.shape)) or "one number"
            raise ValueError(
                f"{link_name(k)}: found {found}; expected 6 numbers (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) "
                "or 3 x 3"
            )
    return tensors


def link_name(k: int) -> str:
    """Returns the name of body k for messages: the base, then the links from 1."""
    return f"link {k}" if k else "the base"


def inertia_problem(tensor: Array) -> str | None:
    """Returns why no rigid body can have this tensor about its centre of mass; None if one can.

    Its principal moments are positive, and none is larger than the sum of the other two (each
    is an integral of a sum of two squares).

    Args:
        tensor: (3, 3), kg m2, symmetric.

    Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.13.
    """
    low, middle, high = np.linalg.eigvalsh(tensor)
    found = f"found principal moments {low:.4g}, {middle:.4g}, {high:.4g} kg m2"
    if low <= 0:
        return f"{found}; expected all of them positive"
    if low + middle < high * (1 - _ROUNDING):
        return (
            f"{found}; expected the largest to be at most the sum of the others, "
            f"{low + middle:.4g} (a tensor about the centre of mass?)"
        )
    return None


def principal_moments(tensor: Array) -> tuple[Array, Array]:
    """Returns the principal moments (3,), kg m2, and a rotation (3, 3) with their axes as columns.

    Rounding errors in the moments of a flat body are corrected, because MuJoCo tolerates none.
    """
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    moments[2] = min(moments[2], (moments[0] + moments[1]) * (1 - 1e-12))
    return moments, axes


def rotate_tensors(tensors: Array, rotation: Array) -> Array:
    """Returns tensors (..., 3, 3) in other axes: rotation_new_old @ I @ rotation_old_new."""
    return np.asarray(rotation @ tensors @ np.swapaxes(rotation, -1, -2))
