"""`GravityTorques`: the torques that hold robots against gravity, computed from their model."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any
from weakref import WeakKeyDictionary, WeakSet

import mujoco
import numpy as np

from ...base.errors import DeclarationError, Problem, SeroError
from ...base.frames import Array
from ..declared.robot import SerialRobot
from .robot_dynamics import EARTH
from .world import world_without_meshes
from .world_view import WorldView

log = logging.getLogger(__name__)


class GravityTorques:
    """Computes the gravity torques of robots, including the loads of robots mounted on them.

    Bases are at their declared frames. Raises DeclarationError if MuJoCo cannot compile the robots,
    or if a robot has a free base.
    """

    def __init__(self, robots: Mapping[str, SerialRobot]) -> None:
        floating = [name for name, robot in robots.items() if robot.free_base is True]
        if floating:
            why = "joint torques cannot hold a robot with a free base against gravity"
            raise DeclarationError([Problem(f"robots.{name}", why) for name in floating])
        self._world = world_without_meshes(robots.values())
        self._world.model.opt.gravity[:] = EARTH
        self._data = self._world.make_data()
        self._torques: Array = np.zeros(self._world.model.nv)

    def of(self, angles: Mapping[str, Array]) -> dict[str, Array]:
        """Returns the gravity torques of each robot at joint angles (n,), shape (n,), Nm or N."""
        model, data, parts = self._world.model, self._data, self._world.robots
        for name, part in parts.items():
            data.qpos[part.qpos] = angles[name]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_rne(model, data, 0, self._torques)
        return {name: self._torques[part.dofs] for name, part in parts.items()}

    def over_time(self, angles: Mapping[str, Array]) -> dict[str, Array]:
        """Returns the gravity torques of each robot at T times, shape (T, n), Nm or N, by name.

        Args:
            angles: joint values of each robot, shape (T, n), or (n,) if constant, rad or m. Where a
                value is NaN, the torques of all robots are NaN.
        """
        count = max((len(each) for each in angles.values() if each.ndim > 1), default=1)
        rows = {name: np.broadcast_to(q, (count, q.shape[-1])) for name, q in angles.items()}
        found = {name: np.full(q.shape, np.nan) for name, q in rows.items()}
        for k in range(count):
            now = {name: q[k] for name, q in rows.items()}
            if all(np.isfinite(q).all() for q in now.values()):
                for name, torques in self.of(now).items():
                    found[name][k] = torques
        return found


_KNOWN: WeakKeyDictionary[WorldView, GravityTorques] = WeakKeyDictionary()
_WITHOUT: WeakSet[WorldView] = WeakSet()  # worlds whose missing gravity model has been logged


def gravity_model(world: WorldView) -> GravityTorques:
    """Returns the gravity model of a world, which is compiled at the first call.

    Raises DeclarationError if MuJoCo cannot compile the robots, or if a robot has a free base.
    """
    if world not in _KNOWN:
        _KNOWN[world] = GravityTorques({name: part.robot for name, part in world.robots.items()})
    return _KNOWN[world]


def gravity_torques(world: WorldView, data: Any) -> Array:
    """Returns the torques that hold all joints of a world against gravity, shape (N,), Nm or N.

    Values of doubles are NaN. If there is no gravity model, all values are NaN, and a warning is
    logged once. The first call for a world compiles the model.
    """
    found = np.full(len(world.joints.names), np.nan)
    if world in _WITHOUT:
        return found
    try:
        model = gravity_model(world)
    except SeroError as error:
        log.warning("torques without gravity are unavailable: %s", error)
        _WITHOUT.add(world)
        return found
    angles = world.joints.angles(data)
    of = model.of({name: angles[part.joints] for name, part in world.robots.items()})
    for name, part in world.robots.items():
        found[part.joints] = of[name]
    return found
