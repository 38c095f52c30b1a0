"""The force with which the world around it pushes on a robot, from MuJoCo's contacts."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.world import World

Array = NDArray[np.float64]


class Contacts:
    """Sums up what touches robots from outside; a robot's own links against each other are not.

    Args:
        world: compiled with `dynamic`.
        data: of it.

    Attributes:
        forces: (robots, 3), on every robot, in the world's axes, N; of the last `update`.
    """

    def __init__(self, world: World, data: mujoco.MjData) -> None:
        self._model, self._data = world.model, data
        self.forces: Array = np.zeros((len(world.robots), 3))
        roots = world.model.body_rootid
        # Of every geom the robot's number, -1 for all else.
        self._owner = np.full(world.model.ngeom, -1)
        for number, part in enumerate(world.robots.values()):
            mine = roots == roots[part.flange_body]
            self._owner[mine[world.model.geom_bodyid]] = number
        self._force: Array = np.zeros(6)

    def update(self) -> Array:
        """Returns `forces` as they are now."""
        data, forces = self._data, self.forces
        forces[:] = 0.0
        contact = data.contact
        for index, (first, second) in enumerate(self._owner[contact.geom].tolist()):
            if first == second or contact.exclude[index]:
                continue
            mujoco.mj_contactForce(self._model, data, index, self._force)
            # Rows of the contact's frame: normal from the first geom to the second, two tangents.
            force = self._force[:3] @ contact.frame[index].reshape(3, 3)
            if second >= 0:
                forces[second] += force
            if first >= 0:
                forces[first] -= force
        return forces
