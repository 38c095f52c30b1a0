"""`Mirror`: a world that follows its sources."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.scene import Scene
from ..assemble.scene_file import read_scene
from ..assemble.world import World
from ..errors import DeclarationError
from ..paths import find_scene
from ..receive.source import age
from .follow import follow
from .place import Placer
from .route import Route, wire
from .router import Router

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


def load_scene(path: Path | str, overrides: Mapping[str, Any] | None = None) -> Scene:
    """Reads and checks a scene file, opening nothing.

    Args:
        path: a TOML file, or a shipped scene's name.
        overrides: `robot.field` to its value, over what the file says. An input that is set so
            (`lwr.joint_angles`) is no longer routed to.

    Raises:
        DeclarationError: everything that is wrong in the file, at once.
        UnknownName: there is no such scene.
    """
    scene, problems = read_scene(find_scene(str(path)), overrides)
    problems += scene.located(wire(scene).problems)
    if problems:
        raise DeclarationError(problems)
    return scene


class Mirror:
    """Follows live sources: opens them, applies what arrives, keeps the last good pose.

    Use it as a context manager; `advance` brings `data` up to the latest packets.

    Args:
        scene: what to compile and follow.

    Attributes:
        world: the compiled scene.
        data: its state.
        routes: the routes from sources in force.
        sources: those that a route leads from.

    Raises:
        DeclarationError: the scene, its sources or its routes are wrong.
    """

    def __init__(self, scene: Scene) -> None:
        wiring = wire(scene)
        if wiring.problems:
            raise DeclarationError(scene.located(wiring.problems))
        self.world = World(scene)
        self.data = self.world.make_data()
        self.routes: list[Route] = wiring.routes
        used = {route.source for route in self.routes}
        self.sources = {name: wiring.sources[name] for name in wiring.sources if name in used}
        self._routers = {
            name: Router(self.world, [r for r in self.routes if r.source == name]) for name in used
        }
        self._placer = Placer(self.world, wiring)
        self._applied: dict[str, int] = {}
        self._started = time.monotonic()

    def open(self) -> None:
        """Opens every source; on failure those already open are closed again.

        Raises:
            SourceError: a source cannot be opened.
        """
        self._applied.clear()
        try:
            for source in self.sources.values():
                source.open()
        except Exception:
            self.close()
            raise
        self._started = time.monotonic()

    def close(self) -> None:
        """Closes every source."""
        for source in self.sources.values():
            source.close()

    def __enter__(self) -> Mirror:
        self.open()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def wait(self, timeout: float) -> list[str]:
        """Waits until every source has sent a good packet, up to `timeout` s in all.

        Returns:
            the names of the sources that are still silent.
        """
        deadline = time.monotonic() + timeout
        return [
            name
            for name, source in self.sources.items()
            if not source.wait(max(deadline - time.monotonic(), 0.0))
        ]

    def reset(self) -> None:
        """Resets the data to the declared pose; the next `advance` applies the latest packets."""
        self.world.reset(self.data)
        self._applied.clear()

    def advance(self, now: float | None = None) -> bool:
        """Applies the latest packet of every source and moves the frames.

        Args:
            now: time to show, s since the mirror was opened; the real one when None.

        Returns:
            whether a new packet was applied.
        """
        clock = time.monotonic()
        data = self.data
        data.time = clock - self._started if now is None else now
        fresh = False
        for name, source in self.sources.items():
            packet = source.latest()
            if packet is not None and self._applied.get(name) != packet.number:
                self._routers[name].apply(packet, data)
                self._applied[name] = packet.number
                fresh = True
            counters = source.counters
            data.userdata[self.world.slots[f"sources.{name}"]] = (
                counters.received,
                counters.malformed,
                counters.dropped,
                age(packet, clock) if packet is not None else -1.0,
                counters.wrong_size,
                counters.last_size,
                source.size,
                max(clock - counters.last_fault_time, 0.0) if counters.malformed else -1.0,
                counters.not_frames,
            )
        self._placer.place(data)
        return fresh

    def state(self) -> NDArray[np.float64]:
        """Returns a copy of everything that a picture of this moment needs."""
        state = np.empty(mujoco.mj_stateSize(self.world.model, _STATE))
        mujoco.mj_getState(self.world.model, self.data, state, _STATE)
        return state


def restore(world: World, data: mujoco.MjData, state: NDArray[np.float64]) -> None:
    """Puts a state that `Mirror.state` returned into `data` and moves the frames."""
    mujoco.mj_setState(world.model, data, state, _STATE)
    follow(world.model, data)
