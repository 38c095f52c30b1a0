"""`Timeline`: the times of a source, with the defaults of one that receives in real time."""

from __future__ import annotations

import time as clock


class Timeline:
    """When the packets of a source come; recordings and runs override all of it."""

    def now(self) -> float:
        """The time on the clock of arrivals, s: that of `time.monotonic`, or of a recording."""
        return clock.monotonic()

    @property
    def is_live(self) -> bool:
        """Whether packets arrive in real time; those of a recording follow `advance_to`."""
        return True

    @property
    def end(self) -> float | None:
        """Time of the last packet, s on the clock of `advance_to`; None for endless sources."""
        return None

    @property
    def begin(self) -> float:
        """Time of the first packet, s on the clock of `advance_to`."""
        return 0.0

    @property
    def newest(self) -> float | None:
        """Time of the newest packet, s, for endless sources with a visible past."""
        return None

    @property
    def step(self) -> float | None:
        """Time step of a simulation, whose `advance_to` is slow, s; None for all others."""
        return None

    def advance_to(self, time: float) -> None:
        """Advances to a time, s, if the source does not run in real time."""
