"""`SourceStates`: what sources have counted, in user data, where decor reads it."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco

from ..assemble.world_view import WorldView
from ..receive.source import Counters, Packet, Source, age


class SourceStates:
    """Writes the slots `sources.<name>` of a world's user data; `SOURCE_FIELDS` says what is there.

    Args:
        world: whose slots.
    """

    def __init__(self, world: WorldView) -> None:
        self._slots = world.slots
        self._link: dict[str, tuple[tuple[int, ...], float]] = {}
        self._foreign: dict[str, tuple[int, float]] = {}

    def forget(self) -> None:
        """Resets, as the sources do when they are opened."""
        self._link.clear()
        self._foreign.clear()

    def write(
        self, data: mujoco.MjData, sources: Mapping[str, Source], latest: Mapping[str, Packet]
    ) -> None:
        """Writes what every source has counted until now.

        Args:
            data: the world's state.
            sources: by name.
            latest: the newest packet of each source that has one.
        """
        for name, source in sources.items():
            packet, counters, now = latest.get(name), source.counters, source.now()
            data.userdata[self._slots[f"sources.{name}"]] = (
                counters.received,
                counters.malformed,
                age(packet, now) if packet is not None else -1.0,
                counters.wrong_size,
                counters.last_size,
                source.size,
                max(now - counters.last_fault_time, 0.0) if counters.malformed else -1.0,
                counters.not_frames,
                counters.wrong_constant,
                *((-1.0, -1.0) if packet is None else source.link_state(packet.values)),
                counters.lost,
                counters.late,
                counters.duplicates,
                counters.restarts,
                _dropped(source),
                # One is as it should be, and a recording knows of none.
                counters.senders if counters.senders > 1 else 0,
                self._link_age(name, counters, _dropped(source), now),
                counters.foreign,
                self._foreign_age(name, counters.foreign, now),
            )

    def _link_age(self, name: str, counters: Counters, dropped: int, now: float) -> float:
        """How long ago (s) the link last lost or mixed up something; -1 when it never has."""
        counts = (counters.lost, counters.late, counters.duplicates, counters.restarts, dropped)
        before, since = self._link.get(name, ((0,) * len(counts), -1.0))
        if counts != before:
            # Less than before after a restart: the numbers that were missed have come after all.
            since = now if any(map(int.__gt__, counts, before)) else since
            self._link[name] = counts, since
        return max(now - since, 0.0) if since >= 0 else -1.0

    def _foreign_age(self, name: str, foreign: int, now: float) -> float:
        """How long ago (s) a packet of a foreign sender came; -1 when none has."""
        before, since = self._foreign.get(name, (0, -1.0))
        if foreign != before:
            self._foreign[name] = foreign, now
            return 0.0
        return max(now - since, 0.0) if since >= 0 else -1.0


def _dropped(source: Source) -> int:
    """What the kernel threw away, where that harms anything: the newest packet always comes."""
    return 0 if source.only_latest_packet else source.counters.dropped
