"""Poses of the doubles of an external model, computed in separate `MjData`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.double import HIDDEN_ANGLE, HIDDEN_DISTANCE, PATH_FADE
from ..assemble.parts import DoublePart, DrawnDouble

Array = NDArray[np.float64]


class ModelDoubles:
    """Computes the poses of the doubles of a model.

    Args:
        model: compiled.
        doubles: by name.
    """

    def __init__(self, model: mujoco.MjModel, doubles: Mapping[str, DoublePart]) -> None:
        self._model = model
        self._doubles = doubles
        self._scratch = {
            name: [mujoco.MjData(model) for _ in range(1 if part.path is None else len(part.path))]
            for name, part in doubles.items()
        }

    def pose(
        self, data: mujoco.MjData, angles: Mapping[str, Array]
    ) -> dict[str, list[mujoco.MjData]]:
        """Computes the state of every double that has joint angles; all else is as in `data`.

        Args:
            data: the user's, kinematics up to date.
            angles: (n,) of every double that has any, except paths, rad or m.
        """
        poses = {}
        for name, part in self._doubles.items():
            if part.path is None and name not in angles:
                continue
            rows = [angles[name]] if part.path is None else part.path
            poses[name] = self._scratch[name]
            for scratch, row in zip(poses[name], rows, strict=True):
                scratch.qpos[:] = data.qpos
                scratch.mocap_pos[:], scratch.mocap_quat[:] = data.mocap_pos, data.mocap_quat
                scratch.qpos[part.of.qpos] = row
                mujoco.mj_kinematics(self._model, scratch)
        return poses

    def drawn(self, state: Any, name: str) -> list[DrawnDouble]:
        """Returns what to draw of one double: its links that do not coincide with the robot's.

        Args:
            state: the `ModelState`.
            name: of the double.
        """
        part = self._doubles[name]
        poses = state.doubles.get(name, [])
        fade = np.linspace(*PATH_FADE, len(poses)) if len(poses) > 1 else np.ones(1)
        return [
            DrawnDouble(
                name,
                self._model,
                pose,
                self._apart(part, state.data, pose),
                part.double.rgba * [1, 1, 1, share],
            )
            for pose, share in zip(poses, fade, strict=False)
        ]

    def _apart(
        self, part: DoublePart, data: mujoco.MjData, pose: mujoco.MjData
    ) -> NDArray[np.bool_]:
        """Returns the geoms of links that do not coincide with the robot's, (ngeom,) bool."""
        model = self._model
        apart = np.linalg.norm(pose.xpos - data.xpos, axis=1) > HIDDEN_DISTANCE
        # The trace of R_target^T R_actual is 1 + 2 cos(angle between them).
        trace = np.einsum("ki,ki->k", pose.xmat, data.xmat)
        apart |= trace < 1.0 + 2.0 * np.cos(HIDDEN_ANGLE)
        mine = model.body_rootid == part.of.bodies[0]
        return np.asarray((mine & apart)[model.geom_bodyid])
