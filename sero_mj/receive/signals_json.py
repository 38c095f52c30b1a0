"""Decoded events as JSON messages that Foxglove and PlotJuggler can plot.

Foxglove refuses a whole channel whose schema has an array of arrays. So values are an array of
numbers; vectors an array of `{x, y, z}`; matrices an array of `{position: {x, y, z}, rotation: [9
numbers, row by row]}`, which is all of a frame. NaN and infinity, which JSON lacks, are null.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_NUMBER = {"type": "number"}
_POINT = {"type": "object", "properties": {axis: _NUMBER for axis in "xyz"}}
_FRAME = {
    "type": "object",
    "properties": {"position": _POINT, "rotation": {"type": "array", "items": _NUMBER}},
}
_ENCODER = json.JSONEncoder(separators=(",", ":"), allow_nan=False, check_circular=False)
_VECTORS, _MATRICES = (3,), (4, 4)  # the shape of one item


def signals_schema(name: str, events: Mapping[str, tuple[int, ...]]) -> bytes:
    """Returns the JSON Schema of a source's decoded packets.

    Args:
        name: the source.
        events: event name to its shape, (n,), (n, 3) or (n, 4, 4).
    """
    items = {_VECTORS: _POINT, _MATRICES: _FRAME}
    properties = {
        event: {"type": "array", "items": items.get(tuple(shape[1:]), _NUMBER)}
        for event, shape in events.items()
    }
    return json.dumps({"title": name, "type": "object", "properties": properties}).encode()


def encode_signals(values: Mapping[str, NDArray[np.float64]]) -> bytes:
    """Returns a decoded packet as a JSON message; arrays in the shapes of `signals_schema`."""
    return encode_signal_rows({event: array[None] for event, array in values.items()})[0]


def encode_signal_rows(values: Mapping[str, NDArray[np.float64]]) -> list[bytes]:
    """Returns many decoded packets at once, which takes half the time; arrays have one axis more.

    Args:
        values: event name to its array, (packets, n), (packets, n, 3) or (packets, n, 4, 4); at
            least one event.
    """
    columns = [_items(array) for array in values.values()]
    encode = _ENCODER.encode
    return [
        encode(dict(zip(values, row, strict=True))).encode() for row in zip(*columns, strict=True)
    ]


def _items(array: NDArray[np.float64]) -> list[list[Any]]:
    if array.shape[2:] == _VECTORS:
        return [[_point(vector) for vector in row] for row in _numbers(array)]
    if array.shape[2:] == _MATRICES:
        positions = _numbers(array[:, :, :3, 3])
        rotations = _numbers(array[:, :, :3, :3].reshape(*array.shape[:2], 9))
        return [
            [
                {"position": _point(position), "rotation": rotation}
                for position, rotation in zip(*row, strict=True)
            ]
            for row in zip(positions, rotations, strict=True)
        ]
    return _numbers(array)


def _point(vector: list[float | None]) -> dict[str, float | None]:
    return {"x": vector[0], "y": vector[1], "z": vector[2]}


def _numbers(array: NDArray[np.float64]) -> list[Any]:
    finite = np.isfinite(array)
    if finite.all():
        return list(array.tolist())
    with_none = array.astype(object)
    with_none[~finite] = None
    return list(with_none.tolist())
