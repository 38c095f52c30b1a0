"""The geoms of an `MjvScene` as one structured numpy array, for vectorized writes."""

from __future__ import annotations

import ctypes
import logging
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

log = logging.getLogger(__name__)

# mjvGeom of MuJoCo 4.0 (mjvisualize.h). `struct_view` compares it with the loaded library.
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

_POS_OFFSET = 52


def struct_view(scene: mujoco.MjvScene) -> NDArray[Any] | None:
    """Returns all geoms of a scene as a structured array that shares their memory.

    The array is valid as long as the scene exists. Returns None if the memory layout differs from
    `GEOM`, as it may in a later MuJoCo; geoms are then copied one by one.
    """
    count = scene.maxgeom
    if count < 2:
        return None
    first = scene.geoms[0].pos.__array_interface__["data"][0] - _POS_OFFSET
    last = scene.geoms[count - 1].pos.__array_interface__["data"][0] - _POS_OFFSET
    if last - first != (count - 1) * GEOM.itemsize:
        log.warning(
            "mjvGeom does not have %d bytes; geoms are copied one by one, which is slower",
            GEOM.itemsize,
        )
        return None
    memory = (ctypes.c_char * (GEOM.itemsize * count)).from_address(first)
    view = np.frombuffer(memory, GEOM)
    view.flags.writeable = True
    if not (_agrees(view, scene, 0) and _agrees(view, scene, count - 1)):
        log.warning(
            "mjvGeom has an unexpected memory layout; geoms are copied one by one, which is slower"
        )
        return None
    return view


def _agrees(view: NDArray[Any], scene: mujoco.MjvScene, i: int) -> bool:
    """Whether every field of one geom, written by the binding, reads back through the view."""
    geom = scene.geoms[i]
    before = view[i : i + 1].tobytes()
    # New memory is uninitialized, also after the end of a label.
    view[i : i + 1] = np.zeros(1, GEOM)
    marks = np.zeros(1, GEOM)
    for k, name in enumerate(GEOM.names or ()):
        marks[name] = b"label" if name == "label" else 1 if name == "castshadow" else k + 2
    set_geom(geom, marks[0])
    same = all(np.array_equal(view[name][i], marks[name][0]) for name in GEOM.names or ())
    view[i : i + 1] = np.frombuffer(before, GEOM)
    return same


def set_geom(geom: mujoco.MjvGeom, row: Any) -> None:
    """Sets one geom from one row, field by field, without relying on the memory layout."""
    for name in GEOM.names or ():
        value = row[name]
        if name == "label":
            geom.label = value.decode("ascii", "replace")
        elif name in ("size", "pos", "mat", "rgba", "texrepeat"):
            getattr(geom, name)[:] = value
        else:
            setattr(geom, name, value.item())
