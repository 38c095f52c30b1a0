"""Rate, jitter and delay of packets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WEIGHT = 1.0 / 16.0  # of a new packet in a running mean, as in RFC 3550, section 6.4.1
_PAUSE = 2.0  # s; a longer one says nothing about the rate
_BASELINE = 10.0  # s for which the fastest packet is the measure; clocks of two machines drift


class Timing:
    """Measures arrivals, and what time stamps say about them.

    Attributes:
        interval: running mean of the time between packets, s; 0 while unknown.
        jitter: running mean of how much that time differs from what the sender's time stamps say
            (RFC 3550, section 6.4.1), or, without these, from its mean, s.
        delay: by how much the last packet was slower than the fastest of the last 10 to 20 s, s.
    """

    def __init__(self) -> None:
        self.interval = self.jitter = self.delay = 0.0
        self._arrival: float | None = None
        self._stamp: float | None = None
        self._fastest = [np.inf, np.inf]  # of this stretch of time and of the one before
        self._since = 0.0

    def restart(self) -> None:
        """Discards what depends on the sender's clock, after a restart."""
        self._arrival = self._stamp = None
        self._fastest = [np.inf, np.inf]

    def add(self, arrivals: Array, stamps: Array | None = None) -> None:
        """Adds packets to the statistics.

        Args:
            arrivals: when they came, (n,), n >= 1, s.
            stamps: when they were sent, by the sender's clock, (n,), s.
        """
        if len(arrivals) == 1 and self.interval > 0.0 and self._arrival is not None:
            stamp = None if stamps is None else float(stamps[0])
            if stamp is None or self._stamp is not None:
                self._add_one(self._arrival, float(arrivals[0]), stamp)
                return
        times = _joined(self._arrival, arrivals)
        self._arrival = float(arrivals[-1])
        between = np.diff(times)
        steady = between < _PAUSE
        between = between[steady]
        if self.interval == 0.0 and len(between):
            self.interval = float(between.mean())
        deviations = between - self.interval
        if stamps is not None:
            with np.errstate(over="ignore"):  # stamps may be any numbers
                sent = np.diff(_joined(self._stamp, stamps))
            steady &= np.abs(sent) < _PAUSE
            deviations = (np.diff(times) - sent)[steady]
        self.interval = _running(self.interval, between)
        self.jitter = _running(self.jitter, np.abs(deviations))
        if stamps is not None:
            self._stamp = float(stamps[-1])
            slowness = arrivals - stamps
            self._compare(float(slowness.min()), float(slowness[-1]))

    def _add_one(self, before: float, arrival: float, stamp: float | None) -> None:
        """Adds a single packet, the usual case at a robot's rate.

        Plain numbers: arrays of one number would take eight times as long.
        """
        between = arrival - before
        deviation, sent = between - self.interval, 0.0
        if stamp is not None:
            assert self._stamp is not None
            sent = stamp - self._stamp
            deviation = between - sent
        is_steady = between < _PAUSE
        if is_steady:
            self.interval += _WEIGHT * (between - self.interval)
        if is_steady and abs(sent) < _PAUSE:
            self.jitter += _WEIGHT * (abs(deviation) - self.jitter)
        self._arrival = arrival
        if stamp is not None:
            self._stamp = stamp
            self._compare(arrival - stamp, arrival - stamp)

    def _compare(self, fastest: float, last: float) -> None:
        """Sets the delay, where so many seconds are between arrivals and the sender's clock."""
        assert self._arrival is not None
        if self._arrival - self._since > _BASELINE:
            self._since = self._arrival
            self._fastest = [np.inf, self._fastest[0]]
        self._fastest[0] = min(self._fastest[0], fastest)
        self.delay = last - min(self._fastest)

    @property
    def rate(self) -> float:
        """Packets per second; 0 while unknown."""
        return 1.0 / self.interval if self.interval > 0 else 0.0


def _joined(before: float | None, values: Array) -> Array:
    return values if before is None else np.concatenate(([before], values))


def _running(mean: float, values: Array) -> float:
    """The running mean after these values, as if it were updated with one after the other."""
    if not len(values):
        return mean
    kept = (1.0 - _WEIGHT) ** np.arange(len(values) - 1, -1, -1)
    return float(mean * (1.0 - _WEIGHT) ** len(values) + _WEIGHT * (kept @ values))
