"""`GeomBuffer`: a buffer of geoms, which visual features fill in each frame."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.parts import DrawnDouble

# mjvGeom of MuJoCo 4.0 (mjvisualize.h); `struct_view` checks it against the loaded library.
GEOM = np.dtype(
    {
        "names": [
            "type", "dataid", "objtype", "objid", "category", "matid", "texid", "texuniform",
            "texcoord", "segid", "size", "pos", "mat", "rgba", "emission", "specular",
            "shininess", "reflectance", "texrepeat", "castshadow", "label",
        ],
        "formats": [
            *["<i4"] * 10, ("<f4", 3), ("<f4", 3), ("<f4", (3, 3)), ("<f4", 4), "<f4", "<f4",
            "<f4", "<f4", ("<f4", 2), "u1", "S100",
        ],
        "offsets": [*range(0, 40, 4), 40, 52, 64, 100, 116, 120, 124, 128, 132, 140, 141],
        "itemsize": 256,
    }
)  # fmt: skip
_LABEL = int(mujoco.mjtGeom.mjGEOM_LABEL)
# `dataid` of the first mesh of `arrow_shapes`. Smaller values are meshes of the shown model.
FIRST_SHAPE = 1 << 20
CAPACITY = 4096  # default maximum number of geoms of a frame
# MuJoCo 4.0.0 draws arrows half as long as size[2] (glScalef by size[2] / 6 in render_gl3.c), with
# a shaft of a third and a head of a sixth of size[2]. A test checks this factor.
ARROW_SIZE_OF_LENGTH = 2.0
GREY = (0.50, 0.50, 0.51)


class Kind(IntEnum):
    """The kind of item that a geom shows. Kind and index of the item identify what was clicked."""

    NONE = 0
    ARROW = 1  # round arrow of a joint; the item is the joint
    BILLBOARD = 2  # billboard of a joint; the item is the joint
    AXES = 3  # coordinate axes; the item is the frame
    NAME = 4  # name of a frame; the item is the frame
    VECTOR = 5  # smart arrow; the item is the arrow
    CARD = 6  # panel with the values of a smart arrow; the item is the arrow
    CHECK = 7  # panel of a flange check; the item is the robot
    HANDLE = 8  # handle to drag a frame; the item is an index of `HANDLE_NAMES`
    PART = 9  # name of a part of the model; without an item
    LIMB = 10  # billboard of a limb; the item is the first joint of the limb


class GeomBuffer:
    """A buffer of geoms, which visual features clear and fill in each frame.

    Attributes:
        rows: structured array of all geoms, of type `GEOM`.
        count: number of geoms in use.
        kinds: kind of the item that each geom shows (`Kind`).
        items: index of the item that each geom shows.
        dropped: number of geoms of this frame that exceeded the capacity.
        grey: mask of the geoms of the model that are drawn in gray, shape (ngeom,), or None.
        hidden: mask of the geoms of the model that are not drawn, shape (ngeom,), or None.
        opacity: factor for the opacity of each geom of the model, shape (ngeom,); None for 1.
        drawn_doubles: visible doubles that are not compiled into the model.
        text: rows of panels and labels, which windows and images with their own fonts leave out.
    """

    def __init__(self, capacity: int = CAPACITY) -> None:
        self.rows: NDArray[Any] = np.zeros(capacity, GEOM)
        self.rows["dataid"] = self.rows["objid"] = self.rows["matid"] = -1
        self.rows["texid"] = self.rows["segid"] = -1
        self.rows["texrepeat"] = 1.0
        # Without this, billboards cast shadows on the robot in the classic renderer.
        self.rows["category"] = int(mujoco.mjtCatBit.mjCAT_DECOR)
        self.rows["objtype"] = int(mujoco.mjtObj.mjOBJ_UNKNOWN)
        self.rows["shininess"] = 0.3
        self.kinds = np.zeros(capacity, np.uint8)
        self.items = np.zeros(capacity, np.intp)
        self.grey: Bools | None = None
        self.hidden: Bools | None = None
        self.opacity: Array | None = None
        self.drawn_doubles: list[DrawnDouble] = []
        self.text = slice(0, 0)
        self._labelled: list[slice] = []
        self.count = 0
        self.dropped = 0

    def clear(self) -> None:
        for place in self._labelled:
            self.rows["label"][place] = b""
        self._labelled.clear()
        self.text = slice(0, 0)
        self.count = 0
        self.dropped = 0

    def take(
        self, n: int, geom: int, kind: Kind = Kind.NONE, items: Ints | int = 0
    ) -> NDArray[Any]:
        """Allocates n rows for geoms of the same type and returns them.

        The caller sets size, pos, mat and rgba. If the rows exceed the capacity, an empty array is
        returned and `dropped` increases. This avoids partially drawn items.

        Args:
            geom: type of the geoms, `mjtGeom`.
            kind: kind of the items that the geoms show.
            items: index of the item that each geom shows, shape (n,), or one index for all.
        """
        if self.count + n > len(self.rows):
            self.dropped += n
            return self.rows[:0]
        place = slice(self.count, self.count + n)
        rows = self.rows[place]
        self.kinds[place] = kind
        self.items[place] = items
        self.count += n
        rows["type"] = geom
        if geom == _LABEL:  # stored for `clear`, which would be slow for the labels of all geoms
            self._labelled.append(place)
        rows["emission"] = 0.35
        rows["specular"] = 0.1
        return rows


def place_triangles(rows: NDArray[Any], origin: Array, second: Array, third: Array) -> None:
    """Sets size, pos and mat of triangle geoms from their corners.

    MuJoCo draws the corners of a triangle at its origin, at size[0] along x and at size[1] along y.
    The triangle is visible from the side that z points to, from which the corners must appear in
    counterclockwise order. Coordinates are the first dimension of the corners, because NumPy is
    slower for arrays with an inner dimension of 3.

    Args:
        rows: rows from `GeomBuffer.take`, shape (...).
        origin: first corner of each triangle, shape (3, ...), m.
    """
    x, y = second - origin, third - origin
    rows["size"][..., 0] = _normalise(x)
    rows["size"][..., 1] = _normalise(y)
    z = np.array([x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]])
    _normalise(z)
    rows["pos"] = np.moveaxis(origin, 0, -1)
    rows["mat"] = np.moveaxis(np.array([x, y, z]), (0, 1), (-1, -2))


def _normalise(vectors: Array) -> Array:
    x, y, z = vectors
    lengths: Array = np.sqrt(x * x + y * y + z * z)
    vectors /= lengths
    return lengths
