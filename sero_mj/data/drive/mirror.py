"""Applies the packets of sources to a world."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Protocol

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.world import World
from ...robots.assemble.world_view import WorldView
from ...robots.declared.scene import Scene
from ..receive.intake import Counters
from ..receive.mailbox import Packet, Packets, age
from ..receive.reception import QUIET_AFTER
from ..receive.source import Source
from .place import Placer, Router, follow
from .route import Route
from .velocities import Velocities
from .wiring import wire

if TYPE_CHECKING:
    from ...robots.external.model_world import ModelWorld

Listener = Callable[[str, Packets], None]
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class LiveWorld(Protocol):
    """A world with changing data, which windows and pages display; see `Mirror`."""

    @property
    def world(self) -> WorldView: ...

    @property
    def data(self) -> mujoco.MjData: ...

    @property
    def routes(self) -> Sequence[Route]: ...

    @property
    def sources(self) -> Mapping[str, Source]: ...

    @property
    def is_live(self) -> bool: ...

    def open(self) -> None: ...

    def close(self) -> None: ...

    def wait(self, timeout: float) -> list[str]: ...

    def listen(self, listener: Listener, *, to_all: bool = False) -> None: ...

    @property
    def has_states(self) -> bool:
        """Whether MuJoCo's state is enough to render an image later, see `Mirror.state`."""

    def reset(self) -> None: ...

    def advance(self, now: float | None = None) -> bool: ...


class Mirror:
    """A world whose data follow the sources of a scene; raises DeclarationError.

    Use it as a context manager, which opens the sources. `advance` applies the latest packets.
    """

    def __init__(self, scene: Scene) -> None:
        wiring = wire(scene).check(scene)
        self.world = World(scene)
        self.data = self.world.make_data()
        self.routes: list[Route] = wiring.routes
        used = {name for route in self.routes for name in route.sources}
        self.sources = {name: wiring.sources[name] for name in wiring.sources if name in used}
        self._routers = {
            name: Router(self.world, [r for r in self.routes if r.direct == name]) for name in used
        }
        self._placer = Placer(self.world, wiring)
        self._velocities = Velocities(self.world, self.routes)
        self._states = _SourceStates(self.world)
        self._latest: dict[str, Packet] = {}
        self._again: set[str] = set()  # sources whose latest packet is applied again
        self._listeners: list[Listener] = []
        self._listeners_to_all: list[Listener] = []
        self._news = threading.Event()
        self._started = time.monotonic()

    def open(self) -> None:
        """Opens all sources; if this fails, closes all of them and raises SourceError."""
        self._latest.clear()
        self._states.forget()
        self._velocities.forget()
        self._again.clear()
        self._news.clear()
        try:
            for source in self.sources.values():
                source.remove_callback(self._news.set)  # from an earlier `open`
                source.on_receive(self._news.set)
                if self._listeners_to_all:
                    source.start_history()
                source.open()
        except Exception:
            self.close()
            raise
        self._started = time.monotonic()

    def close(self) -> None:
        """Closes all sources and removes the callbacks from them."""
        for source in self.sources.values():
            source.close()
            source.remove_callback(self._news.set)
            if self._listeners_to_all:
                source.stop_history()

    def __enter__(self) -> Mirror:
        self.open()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @property
    def is_live(self) -> bool:
        """Whether a source is live, so that the display must run in real time."""
        return any(source.is_live for source in self.sources.values())

    @property
    def has_states(self) -> bool:
        return True

    def wait(self, timeout: float) -> list[str]:
        """Waits up to `timeout` s for a valid packet of each source.

        Returns the names of the sources without a packet.
        """
        deadline = time.monotonic() + timeout
        return [
            name
            for name, source in self.sources.items()
            if not source.wait(max(deadline - time.monotonic(), 0.0))
        ]

    def wait_fresh(self, timeout: float, now: float | None = None) -> None:
        """Waits up to `timeout` s for new packets of sources that are sending, and applies them.

        Packets that arrived while this thread was busy may be old, for example after the creation
        of an OpenGL context.
        """
        deadline = time.monotonic() + timeout
        live = {name: source for name, source in self.sources.items() if source.is_live}
        since = {name: source.now() for name, source in live.items() if source.wait(0.0)}
        while True:
            self.advance(now)
            if all(self._latest[name].arrival >= start for name, start in since.items()):
                return
            if not self.wait_next(max(deadline - time.monotonic(), 0.0)):
                return

    def wait_next(self, timeout: float) -> bool:
        """Waits up to `timeout` s for packets since the last call; returns whether any arrived."""
        came = self._news.wait(timeout)
        self._news.clear()
        return came

    def listen(self, listener: Listener, *, to_all: bool = False) -> None:
        """Calls `listener(source, packets)` in `advance` with the applied packets.

        With `to_all`, calls it with all valid packets, including packets that newer packets have
        replaced before use. Up to 16 MB are stored between calls of `advance`.
        """
        if not to_all:
            self._listeners.append(listener)
            return
        self._listeners_to_all.append(listener)
        for source in self.sources.values():
            source.start_history()

    def reset(self) -> None:
        """Resets the data to the declared pose; the next `advance` applies the latest packets."""
        self.world.reset(self.data)
        self._again.update(self._latest)

    def advance(self, now: float | None = None) -> bool:
        """Applies the latest packet of each source; returns whether a packet was new.

        Args:
            now: time since the mirror was opened, s; None for the real time.
        """
        data = self.data
        data.time = time.monotonic() - self._started if now is None else now
        fresh = set()
        for name, source in self.sources.items():
            source.advance_to(data.time)
            packets = source.take()
            if packets is not None:
                self._latest[name] = packets.last
                for listener in self._listeners:
                    listener(name, packets)
            if self._listeners_to_all and (all_packets := source.take_history()) is not None:
                for listener in self._listeners_to_all:
                    listener(name, all_packets)
            packet = self._latest.get(name)
            if packet is not None and (packets is not None or name in self._again):
                self._routers[name].apply(data, {name: packet.values})
                fresh.add(name)
        self._states.write(data, self.sources, self._latest)
        self._again.clear()
        self._velocities.update(data, fresh, self._latest, late=False)
        self._placer.place(data, self._values(fresh))
        self._velocities.update(data, fresh, self._latest, late=True)
        return bool(fresh)

    def _values(self, fresh: Set[str]) -> dict[str, dict[str, Array]]:
        values: dict[str, dict[str, Array]] = {}
        for name, source in self.sources.items():
            packet = self._latest.get(name)
            receiving = age(packet, source.now()) < QUIET_AFTER
            values[name] = {
                "receiving": np.array([float(receiving)]),
                "receive_trigger": np.array([float(name in fresh)]),
                **({} if packet is None else packet.values),
            }
        return values

    def state(self) -> Array:
        """Returns a copy of MuJoCo's state, from which the current image can be rendered later."""
        state = np.empty(mujoco.mj_stateSize(self.world.model, _STATE))
        mujoco.mj_getState(self.world.model, self.data, state, _STATE)
        return state


def restore(world: World, data: mujoco.MjData, state: Array) -> None:
    """Restores a state from `Mirror.state` in `data`, and computes the frames."""
    mujoco.mj_setState(world.model, data, state, _STATE)
    follow(world.model, data)


class _SourceStates:
    def __init__(self, world: WorldView) -> None:
        self._slots = world.slots
        self._link: dict[str, tuple[tuple[int, ...], float]] = {}
        self._foreign: dict[str, tuple[int, float]] = {}

    def forget(self) -> None:
        self._link.clear()
        self._foreign.clear()

    def write(
        self, data: mujoco.MjData, sources: Mapping[str, Source], latest: Mapping[str, Packet]
    ) -> None:
        for name, source in sources.items():
            packet, counters, now = latest.get(name), source.counters, source.now()
            data.userdata[self._slots[f"sources.{name}"]] = (
                counters.received,
                counters.malformed,
                age(packet, now) if packet is not None else -1.0,
                counters.wrong_size,
                counters.last_size,
                source.layout.size,
                max(now - counters.last_fault_time, 0.0) if counters.malformed else -1.0,
                counters.not_frames,
                counters.wrong_constant,
                counters.wrong_checksum,
                *((-1.0, -1.0) if packet is None else source.link_state(packet.values)),
                counters.lost,
                counters.late,
                counters.duplicates,
                counters.restarts,
                counters.dropped,
                # Recordings have no sender.
                counters.senders if counters.senders > 1 else 0,
                self._link_age(name, counters, now),
                counters.foreign,
                self._foreign_age(name, counters.foreign, now),
                counters.implausible,
                counters.failures,
                float(source.error is not None),
            )

    def _link_age(self, name: str, counters: Counters, now: float) -> float:
        counts = (
            counters.lost,
            counters.late,
            counters.duplicates,
            counters.restarts,
            counters.dropped,
        )
        before, since = self._link.get(name, ((0,) * len(counts), -1.0))
        if counts != before:
            # Counts can decrease after a restart, or if missing numbers have arrived late.
            since = now if any(map(int.__gt__, counts, before)) else since
            self._link[name] = counts, since
        return max(now - since, 0.0) if since >= 0 else -1.0

    def _foreign_age(self, name: str, foreign: int, now: float) -> float:
        before, since = self._foreign.get(name, (0, -1.0))
        if foreign != before:
            self._foreign[name] = foreign, now
            return 0.0
        return max(now - since, 0.0) if since >= 0 else -1.0


class Watch:
    """A `LiveWorld` that shows an external model, whose data the user's own loop changes.

    `advance` copies these data, so a paused window does not change while the loop continues.
    """

    def __init__(self, world: ModelWorld) -> None:
        self.world = world
        self.data = world.make_data()
        self._theirs: mujoco.MjData = world.data
        self.routes: list[Route] = []
        self.sources: dict[str, Source] = {}

    @property
    def is_live(self) -> bool:
        return True

    @property
    def has_states(self) -> bool:
        return False  # any field of an external model may be displayed

    def open(self) -> None:
        """Has no effect, because there are no sources."""

    def close(self) -> None:
        """Has no effect, because there are no sources."""

    def wait(self, timeout: float) -> list[str]:
        return []

    def listen(self, listener: Listener, *, to_all: bool = False) -> None:
        """Has no effect, because there are no packets."""

    def reset(self) -> None:
        """Has no effect on the user's data."""

    def advance(self, now: float | None = None) -> bool:
        """Copies the user's current data and ignores `now`."""
        mujoco.mj_copyData(self.data, self.world.model, self._theirs)
        return True
