"""Doubles that are not compiled in: MuJoCo lays out their geoms, we make them transparent.

Only the classic renderer draws them: MuJoCo Studio has no meshes among extra geoms.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.parts import Ghost
from .geoms import GEOM, set_geom, struct_view

_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_DECOR = int(mujoco.mjtCatBit.mjCAT_DECOR)
_ALL = int(mujoco.mjtCatBit.mjCAT_DYNAMIC) | int(mujoco.mjtCatBit.mjCAT_STATIC)
# How much farther from the eye a double is drawn than it is: where its surface is that of the
# robot, as on a link that has only turned about itself, the two would flicker in stripes.
_BEHIND = 0.002
_MORE = 16  # places for geoms that are none of the model's


class GhostPainter:
    """Adds doubles to scenes; has a scene of its own in which MuJoCo lays them out.

    Args:
        model: what they are doubles in.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._own = mujoco.MjvScene(model, maxgeom=model.ngeom + _MORE)
        self._rows = struct_view(self._own)
        self._option = mujoco.MjvOption()  # geoms that are seen by default, and nothing else
        self._option.flags[:] = 0
        self._option.flags[int(mujoco.mjtVisFlag.mjVIS_STATIC)] = 1
        self._option.sitegroup[:] = 0
        self._perturb = mujoco.MjvPerturb()

    def add(self, ghost: Ghost, scene: mujoco.MjvScene, view: NDArray[Any] | None) -> int:
        """Adds a double behind the geoms of a scene.

        Args:
            ghost: the double.
            scene: MuJoCo has filled it.
            view: all of its geoms as rows, if they can be had.

        Returns:
            how many geoms found no room.
        """
        own = self._own
        own.ngeom = 0
        mujoco.mjv_addGeoms(ghost.model, ghost.data, self._option, self._perturb, _ALL, own)
        rows = self._laid_out()
        of_model = (rows["objtype"] == _GEOM) & (rows["rgba"][:, 3] > 0)
        rows = rows[of_model & ghost.geoms[np.where(of_model, rows["objid"], 0)]]
        rows["rgba"] = ghost.rgba
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
        """Copies of the rows of our own scene."""
        if self._rows is not None:
            return self._rows[: self._own.ngeom].copy()
        rows = np.zeros(self._own.ngeom, GEOM)
        for row, geom in zip(rows, self._own.geoms, strict=False):
            for name in GEOM.names or ():
                row[name] = getattr(geom, name)
        return rows
