"""`HeldTorques`: gravity torques for robots without data.

If neither joint angles nor torques of a robot are received or declared, the torques that hold the
robot in its pose are computed from the model. The legend labels them as gravity torques.
"""

from __future__ import annotations

import logging
import threading

import mujoco
import numpy as np

from ...base.errors import SeroError
from ...base.frames import Array
from ...data.drive.mirror import LiveWorld
from ...robots.assemble.gravity_torques import GravityTorques, gravity_model
from ..decor.toggles import Toggles

log = logging.getLogger(__name__)


class HeldTorques:
    """Gravity torques that are shown for robots without data, while arrows or billboards are on.

    Attributes:
        note: reason why no gravity torques are shown; empty if they are shown.
    """

    def __init__(self, mirror: LiveWorld, toggles: Toggles) -> None:
        self._world, self._toggles = mirror.world, toggles
        routed = {route.to.target for route in mirror.routes}
        # The torques that were written for each robot are stored to detect changes by programs.
        self._written: dict[str, Array | None] = {
            name: None
            for name in unrouted(mirror)
            if f"{name}.torques" not in routed and not self._has_torques(mirror.data, name)
        }
        self._model: GravityTorques | None = None
        self._compiling: threading.Thread | None = None
        self._angles: Array = np.zeros(0)  # joint angles for which the torques were written
        self.note = ""

    @property
    def torques(self) -> dict[str, Array]:
        return {name: each for name, each in self._written.items() if each is not None}

    def _has_torques(self, data: mujoco.MjData, name: str) -> bool:
        return bool(data.userdata[self._world.flags[f"{name}.torques"]] > 0)

    def update(self, data: mujoco.MjData, *, wait: bool = True) -> None:
        """Writes the gravity torques of the current pose into a state, if they are shown.

        Args:
            wait: whether to wait until the model is compiled, which takes a second for a robot with
                many meshes.
        """
        world, toggles = self._world, self._toggles
        for name, written in [*self._written.items()]:
            current = data.userdata[world.slots[f"{name}.torques"]]
            if not self._has_torques(data, name):
                self._written[name] = None  # they were reset
            elif written is None or not np.array_equal(current, written, equal_nan=True):
                del self._written[name]  # a program has set them
                toggles.modelled[world.robots[name].joints] = False
        if self._model is None and not self.note and self._is_seen():
            self._compile(wait)
        if self._model is None:
            return
        is_new = any(each is None for each in self._written.values())
        if not is_new and np.array_equal(data.qpos, self._angles):
            return
        self._angles = data.qpos.copy()
        angles = {name: data.qpos[part.qpos] for name, part in world.robots.items()}
        torques = self._model.of(angles)
        for name in self._written:
            world.set_input(data, f"{name}.torques", torques[name])
            self._written[name] = np.array(data.userdata[world.slots[f"{name}.torques"]])
            toggles.modelled[world.robots[name].joints] = True

    def _is_seen(self) -> bool:
        rows = [self._world.robots[name].joints for name in self._written]
        toggles = self._toggles
        return any(toggles.arrows[r].any() or toggles.billboards[r].any() for r in rows)

    def _compile(self, wait: bool) -> None:
        def make() -> None:
            try:
                self._model = gravity_model(self._world)
            except SeroError as error:
                self.note = f"no gravity torque: {error}"

        if wait:
            make()
            if self.note:
                log.warning("%s", self.note)
        elif self._compiling is None:
            self._compiling = threading.Thread(target=make, name="gravity", daemon=True)
            self._compiling.start()


def unrouted(mirror: LiveWorld) -> list[str]:
    """Returns the names of the robots whose joint angles no route sets."""
    routed = {route.to.target for route in mirror.routes}
    angles = {name: f"{name}.joint_angles" for name in mirror.world.robots}
    return [
        name
        for name, target in angles.items()
        if target in mirror.world.inputs and target not in routed
    ]
