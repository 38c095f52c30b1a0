"""Draws doubles that are not compiled into the model, as transparent copies of its geoms.

Only the classic renderer supports this: MuJoCo Studio has no meshes among extra geoms.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.parts import DrawnDouble
from .geoms import GEOM, set_geom, struct_view

_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_DECOR = int(mujoco.mjtCatBit.mjCAT_DECOR)
_ALL = int(mujoco.mjtCatBit.mjCAT_DYNAMIC) | int(mujoco.mjtCatBit.mjCAT_STATIC)
# Doubles are drawn farther from the camera by this factor, to avoid flicker (z-fighting) where
# their surface coincides with the robot's.
_BEHIND = 0.002
_MORE = 16  # additional capacity for geoms that do not belong to the model


class DoublePainter:
    """Adds doubles to scenes, from geoms that MuJoCo lays out in a separate scene.

    Args:
        model: compiled.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._own = mujoco.MjvScene(model, maxgeom=model.ngeom + _MORE)
        self._rows = struct_view(self._own)
        self._option = mujoco.MjvOption()  # only the geoms that are visible by default
        self._option.flags[:] = 0
        self._option.flags[int(mujoco.mjtVisFlag.mjVIS_STATIC)] = 1
        self._option.sitegroup[:] = 0
        self._perturb = mujoco.MjvPerturb()

    def add(self, drawn: DrawnDouble, scene: mujoco.MjvScene, view: NDArray[Any] | None) -> int:
        """Appends a double to the geoms of a scene.

        Args:
            drawn: the double.
            scene: filled by `mjv_updateScene`.
            view: its geoms as a structured array, if available.

        Returns:
            number of geoms that exceeded the capacity.
        """
        own = self._own
        own.ngeom = 0
        mujoco.mjv_addGeoms(drawn.model, drawn.data, self._option, self._perturb, _ALL, own)
        rows = self._laid_out()
        of_model = (rows["objtype"] == _GEOM) & (rows["rgba"][:, 3] > 0)
        rows = rows[of_model & drawn.geoms[np.where(of_model, rows["objid"], 0)]]
        rows["rgba"] = drawn.rgba
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
        """Returns copies of the geoms of the separate scene."""
        if self._rows is not None:
            return self._rows[: self._own.ngeom].copy()
        rows = np.zeros(self._own.ngeom, GEOM)
        for row, geom in zip(rows, self._own.geoms, strict=False):
            for name in GEOM.names or ():
                row[name] = getattr(geom, name)
        return rows
