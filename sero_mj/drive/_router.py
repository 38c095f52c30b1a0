"""Applies what routes compute to a world's data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.inputs import BLANKABLE
from ..assemble.world_view import WorldView
from .affine import Origin
from .wiring import Route

Array = NDArray[np.float64]
# The newest values by source and event.
LatestValues = Mapping[str, Mapping[str, Array]]


class Router:
    """Applies routes to a world's data.

    Args:
        world: the compiled scene.
        routes: each after those to what it reads.
    """

    def __init__(self, world: WorldView, routes: Sequence[Route]) -> None:
        self._world = world
        self._routes = [(route.value, _InputWriter(world, route)) for route in routes]

    def apply(self, data: mujoco.MjData, packets: LatestValues) -> None:
        """Writes what can be computed; `Placer.place` moves the frames.

        Where an origin has no data yet, the input is left as it is.

        Args:
            data: the world's state.
            packets: the newest values by source and event.
        """
        if not self._routes:
            return
        with np.errstate(over="ignore", invalid="ignore"):
            for value, writer in self._routes:
                if all(self._has(data, packets, origin) for origin in value.origins):
                    writer.put(data, value.evaluate(lambda o: self._numbers(data, packets, o)))

    def _has(self, data: mujoco.MjData, packets: LatestValues, origin: Origin) -> bool:
        if origin.is_event:
            return origin.key in packets.get(origin.name, ())
        if origin.key == "joint_angles" and origin.name in self._world.robots:
            return True  # a robot always stands somewhere
        return bool(data.userdata[self._world.flags[str(origin)]] > 0)

    def _numbers(self, data: mujoco.MjData, packets: LatestValues, origin: Origin) -> Array:
        if origin.is_event:
            return packets[origin.name][origin.key].ravel()
        if origin.key == "joint_angles" and origin.name in self._world.robots:
            return np.asarray(data.qpos[self._world.robots[origin.name].qpos])
        return np.asarray(data.userdata[self._world.slots[str(origin)]])


class _InputWriter:
    """Writes an input of the world."""

    def __init__(self, world: WorldView, route: Route) -> None:
        item = route.to
        self._world = world
        self._negated = route.negated
        self._blankable = item.kind in BLANKABLE
        self._flag = world.flags[item.target]
        self._pose = item.name if item.kind == "pose" else None
        self._slot = world.slots.get(item.target)
        robot = world.robots.get(item.name) if item.kind == "angles" else None
        self._qpos = None if robot is None else robot.qpos

    def put(self, data: mujoco.MjData, values: Array) -> None:
        """Writes the numbers; overflow is no data, and is not applied to what would move."""
        if self._negated:
            values = (values <= 0.5).astype(np.float64)
        finite = np.isfinite(values)
        if not finite.all():
            if not self._blankable:
                return
            values = np.where(finite, values, np.nan)
        if self._pose is not None:
            self._world.set_pose(data, self._pose, values.reshape(4, 4))
        elif self._qpos is not None:
            data.qpos[self._qpos] = values
        else:
            data.userdata[self._slot] = values
        data.userdata[self._flag] = 1.0
