"""Decoded events as JSON messages that Foxglove and PlotJuggler can plot.

Numbers that have a name of their own (`lwr.A1.torque [Nm]`) are members of the message. Foxglove
refuses a whole channel whose schema has an array of arrays. So other values are an array of
numbers; vectors an array of `{x, y, z}`; matrices an array of `{position: {x, y, z}, rotation: [9
numbers, row by row]}`, which is all of a frame. NaN and infinity, which JSON lacks, are null.
Numbers have seven significant digits, enough for a plot; the packets beside them have them all.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
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
_DIGITS = "%.7g"
_POINT_TEXT = f'{{"x":{_DIGITS},"y":{_DIGITS},"z":{_DIGITS}}}'
_FRAME_TEXT = f'{{"position":{_POINT_TEXT},"rotation":[{",".join([_DIGITS] * 9)}]}}'


@dataclass(frozen=True, eq=False)
class Signals:
    """What the messages of a source hold, and what it is called there.

    Attributes:
        shapes: event, or input that a route leads to, to its shape: (n,), (n, 3) or (n, 4, 4).
        names: one of these to the names of its numbers, n; the others are arrays.
        origins: such a name to where its number comes from: `values1[0]`.
    """

    shapes: Mapping[str, tuple[int, ...]]
    names: Mapping[str, Sequence[str]] = field(default_factory=dict)
    origins: Mapping[str, str] = field(default_factory=dict)

    def schema(self, title: str) -> bytes:
        """Returns the JSON Schema of the messages."""
        items = {_VECTORS: _POINT, _MATRICES: _FRAME}
        properties: dict[str, Any] = {}
        for key, shape in self.shapes.items():
            if key in self.names:
                for name in self.names[key]:
                    origin = self.origins.get(name)
                    properties[name] = {**_NUMBER, **({"description": origin} if origin else {})}
            else:
                item = items.get(tuple(shape[1:]), _NUMBER)
                properties[key] = {"type": "array", "items": item}
        return json.dumps({"title": title, "type": "object", "properties": properties}).encode()

    def encode(self, values: Mapping[str, NDArray[np.float64]]) -> bytes:
        """Returns a decoded packet as a message; arrays as `shapes` has them."""
        numbers = [np.asarray(values[key], np.float64).ravel() for key in self.shapes]
        return self.encode_table(np.concatenate(numbers)[None])[0] if numbers else b"{}"

    def encode_table(self, table: NDArray[np.float64]) -> list[bytes]:
        """Returns many decoded packets at once, each as `encode` does.

        Args:
            table: (packets, k), the numbers of all events in their order; matrices row by row.
        """
        template, order = self._template
        if order is not None:
            table = table[:, order]
        rows: list[list[float]] = table.tolist()
        finite = np.isfinite(table)
        if finite.all():
            return [(template % tuple(row)).encode() for row in rows]
        text = template.replace(_DIGITS, "%s")
        return [
            (text % tuple(_DIGITS % x if k else "null" for x, k in zip(row, known, strict=True)))
            .encode()
            for row, known in zip(rows, finite.tolist(), strict=True)
        ]  # fmt: skip

    @cached_property
    def _template(self) -> tuple[str, NDArray[np.intp] | None]:
        """The message with a place for every number, and which number goes where.

        The latter is None where they go as they come.
        """
        members, order, first = [], [], 0
        for key, shape in self.shapes.items():
            count = int(np.prod(shape))
            places = np.arange(first, first + count)
            first += count
            if key in self.names:
                members += [f"{_quoted(name)}:{_DIGITS}" for name in self.names[key]]
                order.append(places)
                continue
            if shape[1:] == _VECTORS:
                items = [_POINT_TEXT] * shape[0]
            elif shape[1:] == _MATRICES:
                items = [_FRAME_TEXT] * shape[0]
                frames = places.reshape(-1, 4, 4)
                parts = frames[:, :3, 3], frames[:, :3, :3].reshape(-1, 9)
                places = np.concatenate(parts, axis=1).ravel()
            else:
                items = [_DIGITS] * count
            members.append(f"{_quoted(key)}:[{','.join(items)}]")
            order.append(places)
        places = np.concatenate(order) if order else np.arange(0)
        as_they_come = np.array_equal(places, np.arange(first))
        return f"{{{','.join(members)}}}", None if as_they_come else places


def _quoted(name: str) -> str:
    return json.dumps(name).replace("%", "%%")
