"""Applies packets of one source to a world's data."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.world import World
from ..receive.source import Packet
from .route import Route

Ints = NDArray[np.intp]


class Router:
    """Applies packets of one source to a world's data.

    Args:
        world: the compiled scene.
        routes: those that lead from the source.
    """

    def __init__(self, world: World, routes: Sequence[Route]) -> None:
        self._world = world
        self._to_qpos: list[tuple[str, Ints]] = []
        self._to_userdata: list[tuple[str, slice]] = []
        self._negated: list[tuple[str, slice]] = []
        self._poses: list[tuple[str, str]] = []
        for route in routes:
            item = route.to
            if item.kind == "pose":
                self._poses.append((route.event, item.name))
            elif item.kind == "angles" and item.name in world.robots:
                self._to_qpos.append((route.event, world.robots[item.name].qpos))
            elif route.negated:
                self._negated.append((route.event, world.slots[item.target]))
            else:
                self._to_userdata.append((route.event, world.slots[item.target]))
        self._flags = [world.flags[route.to.target] for route in routes]

    def apply(self, packet: Packet, data: mujoco.MjData) -> None:
        """Writes the packet's values where the routes lead; `Placer.place` moves the frames."""
        qpos, userdata, values = data.qpos, data.userdata, packet.values
        for event, index in self._to_qpos:
            qpos[index] = values[event].ravel()
        for event, slot in self._to_userdata:
            userdata[slot] = values[event].ravel()
        for event, slot in self._negated:
            userdata[slot] = values[event].ravel() <= 0.5
        for event, name in self._poses:
            self._world.set_pose(data, name, values[event][0])
        userdata[self._flags] = 1.0
