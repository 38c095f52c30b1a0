"""Decoded events as JSON messages that Foxglove and PlotJuggler can plot.

Foxglove refuses a whole channel whose schema has an array of arrays. So values are an array of
numbers; vectors an array of `{x, y, z}`; matrices an array of `{position: {x, y, z}, rotation: [9
numbers, row by row]}`, which is all of a frame. NaN and infinity, which JSON lacks, are null.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
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
_POINT_TEXT = '{"x":%r,"y":%r,"z":%r}'
_FRAME_TEXT = f'{{"position":{_POINT_TEXT},"rotation":[{",".join(["%r"] * 9)}]}}'


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
    table = np.concatenate([array.ravel() for array in values.values()])[None]
    return encode_table({event: array.shape for event, array in values.items()}, table)[0]


def encode_table(events: Mapping[str, tuple[int, ...]], table: NDArray[np.float64]) -> list[bytes]:
    """Returns many decoded packets at once, each as `encode_signals` does.

    Args:
        events: event name to its shape.
        table: (packets, k), the numbers of all events in their order; matrices row by row.
    """
    template, order = _template(tuple(events.items()))
    if order is not None:
        table = table[:, order]
    rows: list[list[Any]] = table.tolist()
    finite = np.isfinite(table)
    if not finite.all():
        for row, known in zip(rows, finite.tolist(), strict=True):
            row[:] = [number if k else _NULL for number, k in zip(row, known, strict=True)]
    return [(template % tuple(row)).encode() for row in rows]


class _Null:
    def __repr__(self) -> str:
        return "null"


_NULL = _Null()


@cache
def _template(
    events: tuple[tuple[str, tuple[int, ...]], ...],
) -> tuple[str, NDArray[np.intp] | None]:
    """The message with %r, which writes numbers as JSON does, and which number goes where.

    The latter is None where they go as they come.
    """
    members, order, first = [], [], 0
    for event, shape in events:
        count = int(np.prod(shape))
        places = np.arange(first, first + count)
        first += count
        if shape[1:] == _VECTORS:
            items = [_POINT_TEXT] * shape[0]
        elif shape[1:] == _MATRICES:
            items = [_FRAME_TEXT] * shape[0]
            frames = places.reshape(-1, 4, 4)
            parts = frames[:, :3, 3], frames[:, :3, :3].reshape(-1, 9)
            places = np.concatenate(parts, axis=1).ravel()
        else:
            items = ["%r"] * count
        members.append(f"{json.dumps(event).replace('%', '%%')}:[{','.join(items)}]")
        order.append(places)
    places = np.concatenate(order)
    as_they_come = np.array_equal(places, np.arange(first))
    return f"{{{','.join(members)}}}", None if as_they_come else places
