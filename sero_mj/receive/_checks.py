"""What a packet's arrays may hold: finite numbers, and matrices that are rigid frames."""

from __future__ import annotations

from collections.abc import Collection, Mapping, MutableMapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ROTATION_TOLERANCE = 1e-3  # as `nearest_rotation` has it for frames in files
# Much smaller: a frame sent the other way round has its position there, be that of 1 mm only.
_LAST_ROW_TOLERANCE = 1e-6
_LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_IDENTITY = np.eye(3)


def find_not_finite(values: Mapping[str, Array], but: Collection[str] = ()) -> str:
    """Says where the first NaN or infinity stands; empty when there is none.

    Args:
        values: event name to its array.
        but: events that are left out.
    """
    for event, array in values.items():
        if event in but:
            continue
        good = np.isfinite(array)
        if not good.all():
            index = tuple(np.argwhere(~good)[0].tolist())
            return f"{event}[{', '.join(map(str, index))}] is {array[index]}"
    return ""


def blank_not_finite(
    values: MutableMapping[str, Array], events: Collection[str], matrices: Collection[str]
) -> None:
    """Makes NaN of every infinity, and of a whole matrix when one of its numbers is either.

    Args:
        values: event name to its array, of one packet or of many; what has to change is replaced
            by a copy.
        events: those that are looked at.
        matrices: those that are matrices.
    """
    for event in events:
        array = values.get(event)
        if array is None:
            continue
        good = np.isfinite(array)
        if good.all():
            continue
        if event in matrices:  # part of a frame is none
            good &= good.all(axis=(-2, -1), keepdims=True)
        values[event] = np.where(good, array, np.nan)


def are_frames(matrices: Array) -> NDArray[np.bool_]:
    """Whether each of the matrices (n, 4, 4) is a rigid frame, (n,).

    The last row is 0 0 0 1 within 1e-6, the upper left 3 x 3 orthonormal within 1e-3 and no mirror
    image.
    """
    # Entries far above 1 are still far from a rotation, and their squares do not overflow.
    rotations = np.minimum(np.maximum(matrices[:, :3, :3], -2.0), 2.0)  # np.clip is slower
    off = np.abs(rotations @ rotations.swapaxes(1, 2) - _IDENTITY).max(axis=(1, 2))
    last_row_off = np.abs(matrices[:, 3] - _LAST_ROW).max(axis=1)
    good: NDArray[np.bool_] = (off <= _ROTATION_TOLERANCE) & (last_row_off <= _LAST_ROW_TOLERANCE)
    good[good] = np.linalg.det(rotations[good]) > 0.0  # of NaN it would warn
    return good


def find_not_frame(
    values: Mapping[str, Array], events: Collection[str], *, column_major: bool
) -> str:
    """Says which is the first matrix that is no rigid frame, and why; empty when all are frames.

    Args:
        values: event name to its array; matrices that are NaN are left out.
        events: those that are matrices.
        column_major: how they were read, for advice when the other way gives a frame.
    """
    matrices = np.concatenate([values[event] for event in events])
    wrong = ~(are_frames(matrices) | np.isnan(matrices[:, 3, 3]))
    if not wrong.any():
        return ""
    first = int(np.argmax(wrong))
    name = [f"{event}[{i}]" for event in events for i in range(len(values[event]))][first]
    matrix = matrices[first]
    if np.abs(matrix[3] - _LAST_ROW).max() > _LAST_ROW_TOLERANCE:
        why = f"last row [{', '.join(f'{number:.7g}' for number in matrix[3])}]"
    else:
        why = "upper left 3 x 3 is not a rotation (orthonormal, determinant +1)"
    if are_frames(matrix.T[None])[0]:
        other = "false" if column_major else "true"
        why += f"; its transpose is one: set column_major = {other}"
    return f"{name} is not a frame: {why}"
