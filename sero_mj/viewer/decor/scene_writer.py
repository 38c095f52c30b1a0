"""`SceneWriter`: copies the geoms of a `GeomBuffer` into an `MjvScene`.

All geoms are written at once, through a structured NumPy array that shares memory with the scene.
"""

from __future__ import annotations

import ctypes
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.errors import RenderError
from ...base.frames import Ints
from ...robots.assemble.parts import DrawnDouble
from .arrow_shapes import COARSE, shapes
from .geom_buffer import FIRST_SHAPE, GEOM, GREY, GeomBuffer, place_triangles

GREYNESS = 0.8  # fraction of gray in the color of a robot without fresh data
_POS_OFFSET = 52
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_TRIANGLE = int(mujoco.mjtGeom.mjGEOM_TRIANGLE)
_DECOR = int(mujoco.mjtCatBit.mjCAT_DECOR)
_ALL = int(mujoco.mjtCatBit.mjCAT_DYNAMIC) | int(mujoco.mjtCatBit.mjCAT_STATIC)
# Doubles are drawn farther from the camera by this factor, to avoid flicker (z-fighting) if their
# surface coincides with the robot's.
_BEHIND = 0.002
_MORE = 16  # additional capacity for geoms that are not part of the model


class SceneWriter:
    """A writer that adds arrows, axes, panels and other geoms to an `MjvScene` filled by MuJoCo.

    Args:
        first_shape: `dataid` of the first mesh of `arrow_shapes` in the renderer of the scene. If
            the renderer does not have these meshes (None), they are drawn as triangle geoms.
    """

    def __init__(self, scene: mujoco.MjvScene, first_shape: int | None = None) -> None:
        self._scene, self._first_shape = scene, first_shape
        self._rows = struct_view(scene)
        self._painter: _DoublePainter | None = None

    def add(self, buffer: GeomBuffer, *, with_text: bool = True) -> int:
        """Applies `mark`, and appends the geoms of a buffer, with or without panels and labels.

        Returns:
            number of geoms that were dropped because they exceeded the capacity of the scene.
        """
        self.mark(buffer)
        dropped = sum(self.add_double(drawn) for drawn in buffer.drawn_doubles)
        text = buffer.text
        parts = [slice(0, text.start), text, slice(text.stop, buffer.count)]
        for part in parts if with_text else parts[::2]:
            dropped += self._append(self._drawable(buffer.rows[part]))
        return dropped

    def _drawable(self, rows: NDArray[Any]) -> NDArray[Any]:
        of_shape = (rows["type"] == _MESH) & (rows["dataid"] >= FIRST_SHAPE)
        if not of_shape.any():
            return rows
        if self._first_shape is None:
            return np.concatenate([rows[~of_shape], *map(_triangles, rows[of_shape])])
        rows = rows.copy()
        shaped = rows[of_shape]
        shaped["dataid"] = self._first_shape + 2 * (shaped["dataid"] - FIRST_SHAPE)
        # MuJoCo ignores the size of meshes, but multiplies by `mat`, whatever it contains.
        shaped["mat"] *= shaped["size"][:, None]
        rows[of_shape] = shaped
        return rows

    def mark(self, buffer: GeomBuffer) -> None:
        """Hides, grays and fades geoms of the model as the masks of a buffer state."""
        scene, rows = self._scene, self._rows
        if buffer.hidden is not None:
            index = self._of_model()
            index = index[buffer.hidden[rows["objid"][index]]]
            shown = np.delete(rows[: scene.ngeom], index)
            rows[: len(shown)] = shown
            scene.ngeom = len(shown)
        index = self._of_model()
        if buffer.grey is not None:
            stale = index[buffer.grey[rows["objid"][index]]]
            colours = rows["rgba"][stale]
            colours[:, :3] += GREYNESS * (np.array(GREY) - colours[:, :3])
            rows["rgba"][stale] = colours
        if buffer.opacity is not None:
            factors = buffer.opacity[rows["objid"][index]]
            rows["rgba"][index[factors < 1], 3] *= factors[factors < 1]

    def add_double(self, drawn: DrawnDouble) -> int:
        """Appends a double that is not in the model, and returns the number of dropped geoms."""
        if self._painter is None:
            self._painter = _DoublePainter(drawn.model)
        return self._append(self._painter.rows(drawn, self._scene))

    def _append(self, rows: NDArray[Any]) -> int:
        scene = self._scene
        start = scene.ngeom
        count = min(len(rows), scene.maxgeom - start)
        self._rows[start : start + count] = rows[:count]
        scene.ngeom = start + count
        return int(len(rows) - count)

    def _of_model(self) -> Ints:
        rows = self._rows[: self._scene.ngeom]
        return np.flatnonzero((rows["objtype"] == _GEOM) & (rows["objid"] >= 0))


def _triangles(row: Any) -> NDArray[Any]:
    vertices, faces = shapes(COARSE)[int(row["dataid"]) - FIRST_SHAPE]
    places = row["pos"] + (vertices * row["size"]) @ row["mat"].T
    rows = np.repeat(np.atleast_1d(row), len(faces))
    rows["type"], rows["dataid"] = _TRIANGLE, -1
    rows["size"] = 0.0
    place_triangles(rows, *np.moveaxis(places[faces.T], -1, 1))
    return rows


class _DoublePainter:
    def __init__(self, model: mujoco.MjModel) -> None:
        self._own = mujoco.MjvScene(model, maxgeom=model.ngeom + _MORE)
        self._rows = struct_view(self._own)
        self._option = mujoco.MjvOption()  # only the geoms that are visible by default
        self._option.flags[:] = 0
        self._option.flags[int(mujoco.mjtVisFlag.mjVIS_STATIC)] = 1
        self._option.sitegroup[:] = 0
        self._perturb = mujoco.MjvPerturb()

    def rows(self, drawn: DrawnDouble, scene: mujoco.MjvScene) -> NDArray[Any]:
        own = self._own
        own.ngeom = 0
        mujoco.mjv_addGeoms(drawn.model, drawn.data, self._option, self._perturb, _ALL, own)
        rows = self._rows[: own.ngeom].copy()
        of_model = (rows["objtype"] == _GEOM) & (rows["rgba"][:, 3] > 0)
        opacity = np.where(of_model, drawn.opacity[np.where(of_model, rows["objid"], 0)], 0.0)
        rows = rows[opacity > 0]
        rows["rgba"] = drawn.rgba
        rows["rgba"][:, 3] *= opacity[opacity > 0]
        rows["category"] = _DECOR  # without a shadow
        rows["matid"] = rows["texid"] = rows["segid"] = -1
        rows["reflectance"] = 0.0
        eye = (np.array(scene.camera[0].pos) + scene.camera[1].pos) / 2
        rows["pos"] += _BEHIND * (rows["pos"] - eye)
        return rows


def struct_view(scene: mujoco.MjvScene) -> NDArray[Any]:
    """Returns all geoms of a scene as a structured array that shares memory with the scene.

    The array is valid only while the scene exists.

    Raises:
        RenderError: the memory layout of this version of MuJoCo differs from `GEOM`.
    """
    count = scene.maxgeom
    if not count:
        return np.zeros(0, GEOM)
    first, last = (
        scene.geoms[k].pos.__array_interface__["data"][0] - _POS_OFFSET for k in (0, count - 1)
    )
    if last - first == (count - 1) * GEOM.itemsize:
        memory = (ctypes.c_char * (GEOM.itemsize * count)).from_address(first)
        view = np.frombuffer(memory, GEOM)
        view.flags.writeable = True
        if _agrees(view, scene, 0) and _agrees(view, scene, count - 1):
            return view
    raise RenderError(f"mjvGeom of MuJoCo {mujoco.__version__} has an unexpected memory layout")


def _agrees(view: NDArray[Any], scene: mujoco.MjvScene, i: int) -> bool:
    before = view[i].copy()
    # New memory is uninitialized, and so are the bytes after the end of a label.
    view[i] = np.zeros(1, GEOM)[0]
    marks = np.zeros(1, GEOM)
    for k, name in enumerate(GEOM.names or ()):
        marks[name] = b"label" if name == "label" else 1 if name == "castshadow" else k + 2
    set_geom(scene.geoms[i], marks[0])
    same = all(np.array_equal(view[name][i], marks[name][0]) for name in GEOM.names or ())
    view[i] = before
    return same


def set_geom(geom: mujoco.MjvGeom, row: Any) -> None:
    """Copies a row of type `GEOM` to a geom field by field, independent of the memory layout."""
    for name in GEOM.names or ():
        value = row[name]
        if name == "label":
            geom.label = value.decode("ascii", "replace")
        elif name in ("size", "pos", "mat", "rgba", "texrepeat"):
            getattr(geom, name)[:] = value
        else:
            setattr(geom, name, value.item())
