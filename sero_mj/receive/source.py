"""What all sources share: the latest packet, counters, and whether anything arrives.

A source reads off the render thread. The latest packet wins; what is malformed is counted and
never handed on.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

QUIET_AFTER = 0.5  # s without a packet until a source counts as silent


@dataclass(frozen=True, eq=False)
class Packet:
    """One good packet.

    Attributes:
        values: event name to its array, float64, in the source's shapes. Finite, but for the
            events in which NaN is allowed; matrices are rigid frames.
        arrival: when it arrived, on the clock of `time.monotonic`, s.
        number: 1 for the first good packet of the source.
    """

    values: Mapping[str, Array]
    arrival: float
    number: int


@dataclass
class Counters:
    """What came in since the source was opened.

    Attributes:
        received: packets of any kind.
        wrong_size: malformed ones: not as long as the structure says.
        not_finite: malformed ones: with NaN or infinity where these are not allowed.
        not_frames: malformed ones: with a matrix that is not a rigid frame.
        blanked: good ones with NaN or infinity where these are allowed.
        superseded: good ones that a later packet replaced before they were used, as intended
            when a robot sends faster than pictures are made.
        dropped: packets that the kernel threw away because its buffer was full.
        last_fault: what was wrong with the last malformed packet.
        last_size: bytes of the last packet of a wrong size.
        last_fault_time: when the last malformed packet came, on the clock of `time.monotonic`.
    """

    received: int = 0
    wrong_size: int = 0
    not_finite: int = 0
    not_frames: int = 0
    blanked: int = 0
    superseded: int = 0
    dropped: int = 0
    last_fault: str = ""
    last_size: int = 0
    last_fault_time: float = 0.0

    @property
    def malformed(self) -> int:
        """Packets that were counted and not applied."""
        return self.wrong_size + self.not_finite + self.not_frames


class Source(Protocol):
    """Where packets come from."""

    @property
    def counters(self) -> Counters:
        """What came in since it was opened."""

    @property
    def name(self) -> str:
        """The source's name in routes."""

    @property
    def events(self) -> Mapping[str, tuple[int, ...]]:
        """Event name to its shape: (n,) values, (n, 3) vectors, (n, 4, 4) matrices."""

    @property
    def size(self) -> int:
        """Bytes of a packet."""

    def allow_nan(self, events: Collection[str]) -> None:
        """Lets NaN and infinity mean `no data` in these events, and in no others.

        There they are handed on as NaN, a matrix as a whole, and the rest of the packet is applied;
        anywhere else they make it malformed. Raises UnknownName.
        """

    def open(self) -> None:
        """Starts receiving; raises SourceError."""

    def close(self) -> None:
        """Stops receiving and frees what was opened."""

    def latest(self) -> Packet | None:
        """Returns the newest good packet, or None when there was none yet."""

    def wait(self, timeout: float) -> bool:
        """Waits until a good packet has come; returns whether one has."""


def age(packet: Packet | None, now: float | None = None) -> float:
    """Seconds since the packet arrived; infinite when there is none."""
    if packet is None:
        return float("inf")
    return (time.monotonic() if now is None else now) - packet.arrival
