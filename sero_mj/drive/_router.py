"""Applies what routes compute to a world's data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.inputs import BLANKABLE
from ..assemble.world_view import WorldView
from ..receive.source import Packet
from .affine import Origin
from .wiring import Route

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
LatestValues = Mapping[str, Mapping[str, Array]]


class Router:
    """Applies packets of one source to a world's data.

    Args:
        world: the compiled scene.
        routes: those that take nothing but a packet of the source.
    """

    def __init__(self, world: WorldView, routes: Sequence[Route]) -> None:
        self._world = world
        # What goes as it comes, which is most of it, without a detour.
        self._to_qpos: list[tuple[str, Ints]] = []
        self._to_userdata: list[tuple[str, slice]] = []
        self._poses: list[tuple[str, str]] = []
        self._computed: list[tuple[Route, _InputWriter]] = []
        flags = []
        for route in routes:
            item, whole = route.to, route.value.whole
            if whole is None or route.negated:
                self._computed.append((route, _InputWriter(world, route)))
                continue
            flags.append(world.flags[item.target])
            if item.kind == "pose":
                self._poses.append((whole.key, item.name))
            elif item.kind == "angles" and item.name in world.robots:
                self._to_qpos.append((whole.key, world.robots[item.name].qpos))
            else:
                self._to_userdata.append((whole.key, world.slots[item.target]))
        self._flags = np.array(flags, np.intp)

    def apply(self, packet: Packet, data: mujoco.MjData) -> None:
        """Writes the packet's values where the routes lead; `Placer.place` moves the frames."""
        qpos, userdata, values = data.qpos, data.userdata, packet.values
        for event, index in self._to_qpos:
            qpos[index] = values[event].ravel()
        for event, slot in self._to_userdata:
            userdata[slot] = values[event].ravel()
        for event, name in self._poses:
            self._world.set_pose(data, name, values[event].reshape(4, 4))
        userdata[self._flags] = 1.0
        if self._computed:
            with np.errstate(over="ignore", invalid="ignore"):
                for route, place in self._computed:
                    place.put(data, route.value.evaluate(lambda o: values[o.key].ravel()))


class LateRouter:
    """Applies routes that take more than one packet: of two sources, or outputs, or constants.

    Args:
        world: the compiled scene.
        routes: such routes, each after those to what it reads.
    """

    def __init__(self, world: WorldView, routes: Sequence[Route]) -> None:
        self._world = world
        self._routes = [(route, _InputWriter(world, route)) for route in routes]

    def apply(self, data: mujoco.MjData, packets: LatestValues) -> None:
        """Writes what can be computed.

        Where an origin has no data yet, the input is left as it is.

        Args:
            data: the world's state; other routes have been applied to it.
            packets: the latest values by source and event.
        """
        if not self._routes:
            return
        with np.errstate(over="ignore", invalid="ignore"):
            for route, place in self._routes:
                if all(self._has(data, packets, origin) for origin in route.value.origins):
                    values = route.value.evaluate(lambda o: self._numbers(data, packets, o))
                    place.put(data, values)

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
    """Where a route writes to."""

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
        """Writes the numbers; what overflowed blanks, or is left out where it would move."""
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
