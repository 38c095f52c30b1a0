"""`TendonRows`: the tendons of a model as MuJoCo draws them, as geoms for a player."""

from __future__ import annotations

import mujoco
import numpy as np

from ..decor.geom_buffer import GEOM
from ..decor.scene_writer import struct_view

TENDON = int(mujoco.mjtObj.mjOBJ_TENDON)
_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_ALL = int(mujoco.mjtCatBit.mjCAT_ALL)
_MOST_GEOMS = 4000  # besides those of the model


class TendonRows:
    """Asks MuJoCo for the tendons of a frame.

    Args:
        model: compiled.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._has_tendons = bool((model.ntendon and (model.tendon_width > 0).any()) or model.nwrap)
        self._scene: mujoco.MjvScene | None = None
        self._camera, self._option = mujoco.MjvCamera(), mujoco.MjvOption()

    def rows(self, data: mujoco.MjData) -> np.ndarray:
        """Returns the straight pieces of all tendons, (k,) of `GEOM`; none takes no time.

        Args:
            data: the state, with everything up to date that is drawn of it.
        """
        if not self._has_tendons:
            return np.zeros(0, GEOM)
        model = self._model
        if self._scene is None:
            self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + model.nsite + _MOST_GEOMS)
        scene = self._scene
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, _ALL, scene)
        rows = struct_view(scene)
        if rows is None:
            return np.zeros(0, GEOM)
        rows = rows[: scene.ngeom]
        kept: np.ndarray = rows[(rows["objtype"] == TENDON) & (rows["type"] == _CAPSULE)].copy()
        return kept
