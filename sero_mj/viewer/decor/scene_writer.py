"""`SceneWriter`: copies the geoms of a `GeomBuffer` into the `MjvScene` of a host.

All geoms of a scene are written at once, through one structured numpy array over their memory.
"""

from __future__ import annotations

import ctypes
import logging
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.parts import DrawnDouble
from .geom_buffer import GEOM, GREY, GeomBuffer

log = logging.getLogger(__name__)

GREYNESS = 0.8  # fraction of grey in the colour of a stale robot
_POS_OFFSET = 52
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_DECOR = int(mujoco.mjtCatBit.mjCAT_DECOR)
_ALL = int(mujoco.mjtCatBit.mjCAT_DYNAMIC) | int(mujoco.mjtCatBit.mjCAT_STATIC)
# Doubles are drawn farther from the camera by this factor, to avoid flicker (z-fighting) where
# their surface coincides with the robot's.
_BEHIND = 0.002
_MORE = 16  # additional capacity for geoms that do not belong to the model


class SceneWriter:
    """Adds decor to an `MjvScene` that MuJoCo has filled."""

    def __init__(self, scene: mujoco.MjvScene) -> None:
        self._scene = scene
        self._view = struct_view(scene)
        self._painter: _DoublePainter | None = None

    def add(self, buffer: GeomBuffer, *, with_text: bool = True) -> int:
        """Appends the buffer's geoms to the scene.

        Args:
            with_text: whether panels and labels are added as well.

        Returns:
            number of geoms that exceeded the scene's capacity.
        """
        self.mark(buffer)
        dropped = sum(self.add_double(drawn) for drawn in buffer.drawn_doubles)
        if with_text:
            return dropped + self._append(buffer.rows[: buffer.count])
        before, after = slice(0, buffer.text.start), slice(buffer.text.stop, buffer.count)
        return dropped + self._append(buffer.rows[before]) + self._append(buffer.rows[after])

    def mark(self, buffer: GeomBuffer) -> None:
        if buffer.hidden is not None:
            self._hide(buffer.hidden)
        if buffer.grey is not None:
            self._grey(buffer.grey, self._scene.ngeom)
        if buffer.opacity is not None:
            self._fade(buffer.opacity, self._scene.ngeom)

    def add_double(self, drawn: DrawnDouble) -> int:
        """Appends a double that is not compiled into the model."""
        if self._painter is None:
            self._painter = _DoublePainter(drawn.model)
        return self._painter.add(drawn, self._scene, self._view)

    def _append(self, rows: NDArray[Any]) -> int:
        scene = self._scene
        start = scene.ngeom
        count = min(len(rows), scene.maxgeom - start)
        if self._view is not None:
            self._view[start : start + count] = rows[:count]
        else:
            for geom, row in zip(scene.geoms[start : start + count], rows, strict=False):
                set_geom(geom, row)
        scene.ngeom = start + count
        return int(len(rows) - count)

    def _of_model(self, count: int) -> Ints:
        assert self._view is not None
        rows = self._view[:count]
        return np.flatnonzero((rows["objtype"] == _GEOM) & (rows["objid"] >= 0))

    def _hide(self, hidden: Bools) -> None:
        scene = self._scene
        if self._view is not None:
            rows, index = self._view[: scene.ngeom], self._of_model(scene.ngeom)
            kept = np.delete(rows, index[hidden[rows["objid"][index]]])
            rows[: len(kept)] = kept
            scene.ngeom = len(kept)
            return
        for geom in scene.geoms[: scene.ngeom]:
            if geom.objtype == _GEOM and geom.objid >= 0 and hidden[geom.objid]:
                geom.rgba[3] = 0.0

    def _grey(self, grey: Bools, count: int) -> None:
        if self._view is not None:
            rows, index = self._view[:count], self._of_model(count)
            index = index[grey[rows["objid"][index]]]
            colours = rows["rgba"][index]
            colours[:, :3] += GREYNESS * (np.array(GREY) - colours[:, :3])
            rows["rgba"][index] = colours
            return
        for geom in self._scene.geoms[:count]:
            if geom.objtype == _GEOM and geom.objid >= 0 and grey[geom.objid]:
                geom.rgba[:3] += GREYNESS * (np.array(GREY) - geom.rgba[:3])

    def _fade(self, opacity: Array, count: int) -> None:
        if self._view is not None:
            rows, index = self._view[:count], self._of_model(count)
            factors = opacity[rows["objid"][index]]
            index, factors = index[factors < 1], factors[factors < 1]
            rows["rgba"][index, 3] *= factors
            return
        for geom in self._scene.geoms[:count]:
            if geom.objtype == _GEOM and geom.objid >= 0:
                geom.rgba[3] *= opacity[geom.objid]


class _DoublePainter:
    """Adds doubles to scenes, from geoms that MuJoCo lays out in a separate scene."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._own = mujoco.MjvScene(model, maxgeom=model.ngeom + _MORE)
        self._rows = struct_view(self._own)
        self._option = mujoco.MjvOption()  # only the geoms that are visible by default
        self._option.flags[:] = 0
        self._option.flags[int(mujoco.mjtVisFlag.mjVIS_STATIC)] = 1
        self._option.sitegroup[:] = 0
        self._perturb = mujoco.MjvPerturb()

    def add(self, drawn: DrawnDouble, scene: mujoco.MjvScene, view: NDArray[Any] | None) -> int:
        """Appends a double to the geoms of a scene."""
        own = self._own
        own.ngeom = 0
        mujoco.mjv_addGeoms(drawn.model, drawn.data, self._option, self._perturb, _ALL, own)
        rows = self._laid_out()
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
        start = scene.ngeom
        count = min(len(rows), scene.maxgeom - start)
        if view is not None:
            view[start : start + count] = rows[:count]
        else:
            for geom, row in zip(scene.geoms[start : start + count], rows, strict=False):
                set_geom(geom, row)
        scene.ngeom = start + count
        return int(len(rows) - count)

    def _laid_out(self) -> NDArray[Any]:
        if self._rows is not None:
            return self._rows[: self._own.ngeom].copy()
        rows = np.zeros(self._own.ngeom, GEOM)
        for row, geom in zip(rows, self._own.geoms, strict=False):
            for name in GEOM.names or ():
                row[name] = getattr(geom, name)
        return rows


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
