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
    message = {event: _items(array) for event, array in values.items()}
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()


def _items(array: NDArray[np.float64]) -> list[Any]:
    if array.shape[1:] == _VECTORS:
        return [_point(row) for row in _numbers(array)]
    if array.shape[1:] == _MATRICES:
        positions, rotations = _numbers(array[:, :3, 3]), _numbers(array[:, :3, :3].reshape(-1, 9))
        return [
            {"position": _point(position), "rotation": rotation}
            for position, rotation in zip(positions, rotations, strict=True)
        ]
    return _numbers(array.ravel())


def _point(row: list[float | None]) -> dict[str, float | None]:
    return {"x": row[0], "y": row[1], "z": row[2]}


def _numbers(array: NDArray[np.float64]) -> list[Any]:
    finite = np.isfinite(array)
    if finite.all():
        return list(array.tolist())
    with_none = array.astype(object)
    with_none[~finite] = None
    return list(with_none.tolist())
