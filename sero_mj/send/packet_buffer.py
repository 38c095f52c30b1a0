"""Makes packets ahead of time, so that they leave on time."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..receive.structure import Structure

Rows = NDArray[np.uint8]

_COMPUTED = 1000.0  # packets/s; between them floating-point numbers go along straight lines
_AHEAD = 0.25  # s


class PacketBuffer:
    """Packets of a motion at a high rate, made in the time that is left between two of them.

    Up to 1 kHz every packet is computed; above, as many as that are, and those in between are
    interpolated: an LWR's joint angles are then 1e-6 rad off at most.

    Args:
        packet_at: makes the packet of a time (s).
        structure: of the packets.
        rate: packets per second.
        sequence: event that numbers the packets, from 1; empty for none.
        time: event that says when a packet leaves; empty for none.
        time_scale: s per unit of `time`.
    """

    def __init__(
        self,
        packet_at: Callable[[float], bytes],
        structure: Structure,
        *,
        rate: float,
        sequence: str = "",
        time: str = "",
        time_scale: float = 1.0,
    ) -> None:
        self._packet_at, self._rate = packet_at, rate
        self._sequence = structure.field(sequence) if sequence else None
        self._time = structure.field(time) if time else None
        self._time_scale = time_scale
        self._floats = [field for field in structure.fields if field.is_float]
        self._step = max(math.ceil(rate / _COMPUTED), 1)
        self._packets: deque[bytes] = deque()
        self._first = 0  # the number of the first of them, from 0
        self._made = 0
        self._last: Rows | None = None
        self._takes = 0.0  # s to make some more

    def at(self, t: float) -> bytes:
        """Returns the packet of time t (s); times are those of packets, and go up."""
        number = round(t * self._rate)
        while self._made <= number:
            self._make()
        while self._first < number:
            self._packets.popleft()
            self._first += 1
        return self._packets[0]

    def idle(self, left: float) -> bool:
        """Makes packets if that takes less than the time left (s); returns whether it has."""
        if left < 1.5 * self._takes or len(self._packets) > _AHEAD * self._rate:
            return False
        self._make()
        return True

    def _make(self) -> None:
        """Computes one packet and interpolates those up to the next."""
        start = time.perf_counter()
        step, made = self._step, self._made
        here = self._compute(made) if self._last is None else self._last
        rows = np.repeat(here[None], step, axis=0)
        if step > 1:
            self._last = self._compute(made + step)
            share = np.arange(step)[:, None] / step
            for field in self._floats:
                part = slice(field.offset, field.end)
                low, high = here[part].view(field.dtype), self._last[part].view(field.dtype)
                with np.errstate(invalid="ignore", over="ignore"):
                    between = low + share * (high - low)
                rows[:, part].view(field.dtype)[:] = between
        numbers = np.arange(made, made + step)
        if self._sequence is not None:
            field = self._sequence
            # As a counter in C does, it wraps.
            counted = (numbers + 1).astype("<i8").astype(field.dtype)
            rows[:, field.offset : field.end].view(field.dtype)[:, 0] = counted
        if self._time is not None:
            field, stamps = self._time, numbers / self._rate / self._time_scale
            if not field.is_float:
                stamps = np.rint(stamps).astype("<i8")
            rows[:, field.offset : field.end].view(field.dtype)[:, 0] = stamps.astype(field.dtype)
        self._packets.extend(row.tobytes() for row in rows)
        self._made += step
        took = time.perf_counter() - start
        self._takes = took if not self._takes else 0.9 * self._takes + 0.1 * took

    def _compute(self, number: int) -> Rows:
        return np.frombuffer(self._packet_at(number / self._rate), np.uint8)
