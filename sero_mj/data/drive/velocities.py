"""Computes joint velocities as differences of received joint angles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ..receive.mailbox import Packet
from ..receive.reception import QUIET_AFTER
from .route import Route


class Velocities:
    """An estimator that writes the velocities of robots with received joint angles to `qvel`.

    A velocity is the difference of the angles of two applied packets, divided by the time between
    their arrivals. It is zero if this time exceeds half a second.
    """

    def __init__(self, world: WorldView, routes: Sequence[Route]) -> None:
        by_target = {route.to.target: route for route in routes}
        self._parts = {
            name: (part, by_target[target].direct is None, sources)
            for name, part in world.robots.items()
            if (sources := _sources(by_target, target := f"{name}.joint_angles"))
        }
        self._before: dict[str, tuple[float, Array]] = {}  # arrival time and angles

    def forget(self) -> None:
        """Forgets the previous angles. Called when the sources are opened."""
        self._before.clear()

    def update(
        self,
        data: mujoco.MjData,
        fresh: Set[str],
        latest: Mapping[str, Packet],
        *,
        late: bool,
    ) -> None:
        """Updates velocities from the joint angles in `data`.

        Args:
            fresh: names of the sources with new packets.
            latest: latest packet of each source.
            late: true to update only the robots that `Placer.place` moves, after it has moved them;
                false to update only the other robots.
        """
        for name, (part, is_late, sources) in self._parts.items():
            came = [latest[source].arrival for source in sources & fresh]
            if not came or is_late != late:
                continue
            now, angles = max(came), data.qpos[part.qpos].copy()
            before = self._before.get(name)
            self._before[name] = now, angles
            if before is None or now == before[0]:
                continue  # the first packet, or the same packet again
            step = now - before[0]
            is_next = 0.0 < step < QUIET_AFTER
            with np.errstate(over="ignore", invalid="ignore"):  # angles may be any numbers
                speeds = (angles - before[1]) / step if is_next else np.zeros(len(angles))
            data.qvel[part.dofs] = np.where(np.isfinite(speeds), speeds, 0.0)


def _sources(routes: Mapping[str, Route], target: str) -> frozenset[str]:
    found, todo, seen = set[str](), [target], set[str]()
    while todo:
        route = routes.get(at := todo.pop())
        if route is not None and at not in seen:
            seen.add(at)
            found |= {*route.sources}
            todo += route.outputs
    return frozenset(found)
