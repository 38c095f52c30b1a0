"""Samples the state of a mirrored scene at a fixed rate, in real time if its sources are live."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator

import mujoco
import numpy as np

from ...base.frames import Array
from ...data.drive.mirror import LiveWorld, Mirror

_POSES = 64  # number of poses that a camera has to show
_MAX_DURATION = 120.0  # maximum duration of a recording that is read in advance, s


def recorded_poses(mirror: LiveWorld) -> Iterator[mujoco.MjData]:
    """Yields states of a mirror over the whole duration of its recordings, unless they are long."""
    sources = mirror.sources.values()
    ends = [source.end for source in sources if source.end is not None and source.step is None]
    if not mirror.is_live and 0 < len(ends) == len(sources) and max(ends) <= _MAX_DURATION:
        yield from known_poses(mirror, 0.0, max(ends))


def known_poses(mirror: LiveWorld, begin: float, end: float) -> Iterator[mujoco.MjData]:
    """Yields states of a mirror between two times in seconds, for a camera that shows all of them.

    The mirror must not be live. Afterwards, its time is `begin`.
    """
    # The times decrease, because recordings jump back without reading the frames in between.
    for now in np.linspace(end, begin, _POSES if mirror.sources else 1).tolist():
        mirror.advance(now)
        yield mirror.data


def sampled_states(mirror: Mirror, count: int, fps: float, begin: float = 0.0) -> Iterator[Array]:
    """Yields the state of a mirror at the time of each frame of a video.

    A thread samples live sources, so that the consumer may be slower than the frame rate.
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
        except BaseException as error:  # raised again on the thread of the caller
            taken.put(error)

    sampler = threading.Thread(target=sample, name="video sampler", daemon=True)
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
