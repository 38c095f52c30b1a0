"""States of a mirror at a fixed rate, in real time where its sources are live."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator

import mujoco
import numpy as np

from ...base.frames import Array
from ...data.drive.mirror import LiveWorld, Mirror

_POSES = 64  # by which a camera is placed
_LONGEST = 120.0  # s of a recording that is read before it is shown


def recorded_poses(mirror: LiveWorld) -> Iterator[mujoco.MjData]:
    """Yields states of recordings, as `known_poses`; none of live, simulated and long ones."""
    sources = mirror.sources.values()
    ends = [source.end for source in sources if source.end is not None and source.step is None]
    if not mirror.is_live and 0 < len(ends) == len(sources) and max(ends) <= _LONGEST:
        yield from known_poses(mirror, 0.0, max(ends))


def known_poses(mirror: LiveWorld, begin: float, end: float) -> Iterator[mujoco.MjData]:
    """Yields states over a time whose sources are not live, for a camera that holds them.

    Args:
        mirror: open; it is at the begin afterwards.
    """
    # Backwards: recordings jump back without reading what is between.
    for now in np.linspace(end, begin, _POSES if mirror.sources else 1).tolist():
        mirror.advance(now)
        yield mirror.data


def sampled_states(mirror: Mirror, count: int, fps: float, begin: float = 0.0) -> Iterator[Array]:
    """Yields the state at the time of every frame, sampled on a thread if sources are live.

    What is done with them may take longer than the time between two.
    """
    if not mirror.is_live:
        for k in range(count):
            mirror.advance(begin + k / fps)
            yield mirror.state()
        return
    taken: queue.SimpleQueue[Array | BaseException] = queue.SimpleQueue()
    stop = threading.Event()

    def sample() -> None:
        try:
            start = time.monotonic()
            for k in range(count):
                if stop.wait(max(start + k / fps - time.monotonic(), 0.0)):
                    return
                mirror.advance(k / fps)
                taken.put(mirror.state())
        except BaseException as error:  # raised again on the caller's thread
            taken.put(error)

    sampler = threading.Thread(target=sample, name="film sampler", daemon=True)
    sampler.start()
    try:
        for _ in range(count):
            state = taken.get()
            if isinstance(state, BaseException):
                raise state
            yield state
    finally:
        stop.set()
        sampler.join()
