"""A camera that follows a robot or a frame, smoothly."""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.errors import UnknownName
from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ...robots.declared.mounts import carrier

TIME_CONSTANT = 0.4  # s, by which the camera is late
_JUMP = 1.0  # s; over a longer time, or back in time, it moves at once


def roots(world: WorldView, name: str) -> list[str]:
    """Returns the robots whose bases move a robot or group: those placed in the world.

    Empty for a name of neither.
    """
    members = world.scene.members(name) or [name]
    robots = {each: world.robots[each].robot for each in members if each in world.robots}
    return [each for each, robot in robots.items() if carrier(robot) not in robots]


class Follower:
    """Computes how a camera moves with something, by a low-pass filter of first order.

    Where time stands still or jumps, the camera moves at once.

    Args:
        name: of a robot or group, whose base is followed, or of a frame (`lwr/flange`).

    Raises:
        UnknownName: nothing has this name.
    """

    def __init__(self, world: WorldView, name: str, data: mujoco.MjData) -> None:
        self._world, self._name = world, name
        self._roots = [int(world.robots[each].bodies[0]) for each in roots(world, name)]
        if not self._roots and world.scene.frame_name(name) not in world.frames.names:
            scene = world.scene
            names = [*scene.robots, *scene.groups, *world.frames.names]
            raise UnknownName("robot, group or frame", name, names)
        self._last = self._position(data)
        self._time: float | None = None
        self._late = np.zeros(3)  # m, what the camera has still to move

    def _position(self, data: mujoco.MjData) -> Array:
        if not self._roots:
            return np.array(self._world.frame(data, self._name)[:3, 3])
        return np.asarray(self._world.state(data).xpos[self._roots].mean(axis=0))

    def displacement(self, data: mujoco.MjData, now: float | None = None) -> Array:
        """Returns by how much the camera moves since the last call, (3,), m."""
        position, now = self._position(data), float(data.time) if now is None else now
        if not np.isfinite(position).all():
            return np.zeros(3)
        moved, self._last = position - self._last, position
        passed = 0.0 if self._time is None else now - self._time
        self._time = now
        if not 0.0 < passed <= _JUMP:
            return moved
        late = (self._late + moved) * np.exp(-passed / TIME_CONSTANT)
        moved, self._late = self._late + moved - late, late
        return np.asarray(moved)
