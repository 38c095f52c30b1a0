"""Detects loss, reordering, duplicates, restarts and concurrent senders, and measures timing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...base.frames import Array, Ints
from .structure import Rows

# Positions of a packet relative to earlier packets.
NEXT, DUPLICATE, LATE, RESTARTED = range(4)

# Criteria for a restarted sender: the number is more than `LATE_WITHIN` back, or the time stamp
# more than `LATE_SECONDS` back; or `RUN` consecutive old packets arrive in order; or an old packet
# arrives after a `PAUSE` in s; or more than `MAX_LOST` numbers are missing across the wrap to 0
# (RFC 3550, appendix A.1).
LATE_WITHIN = 64
LATE_SECONDS = 0.5
RUN = 4
PAUSE = 0.5
MAX_LOST = 3000
_WINDOW = (1 << (LATE_WITHIN + 1)) - 1  # bit mask of the newest and `LATE_WITHIN` earlier numbers

SEEN_FOR = 2.0  # s after its last packet until a sender is forgotten
MAX_SENDERS = 64
_MIN_STREAM = 2  # packets of a replaceable sender, because some use a new port for each packet

_WEIGHT = 1.0 / 16.0  # weight of a new packet in a running mean, as in RFC 3550, section 6.4.1
_LONG_PAUSE = 2.0  # s; longer intervals do not affect the rate
_BASELINE = 10.0  # s; window of the fastest packet, because the clocks of two machines drift


class SequenceTracker:
    """Tracks the sequence numbers of one sender.

    Args:
        modulus: modulus at which the sequence number wraps (65536 for 16 bits); 0 for no wrap.

    Attributes:
        lost: count of missing sequence numbers. Numbers that arrive late are subtracted.
    """

    def __init__(self, modulus: int = 0) -> None:
        self.lost = 0
        self._modulus = modulus
        self._last: int | None = None
        self._last_arrival = 0.0
        self._run, self._run_last = 0, 0
        # Bit k is set if the k-th number before the last has arrived, or is missing.
        self._arrived = self._missing = 0

    def is_consecutive(self, numbers: Sequence[int]) -> bool:
        """Returns whether numbers directly follow the last number, so that `skip_to` suffices."""
        first, last = numbers[0], numbers[-1]
        return (
            self._last is not None
            and first == self._last + 1
            and (not self._modulus or last < self._modulus)
            and last - first == len(numbers) - 1
            and list(numbers) == list(range(first, last + 1))  # a duplicate may hide a loss
        )

    def skip_to(self, number: int, arrival: float) -> None:
        """Advances to a number if all numbers before it have arrived in order."""
        steps = number - (self._last or 0)
        self._arrived = _shifted(self._arrived, steps) | ((1 << min(steps, LATE_WITHIN + 1)) - 1)
        self._missing = _shifted(self._missing, steps)
        self._last, self._last_arrival, self._run = number, arrival, 0

    def classify(self, number: int, arrival: float) -> int:
        """Classifies a number as `NEXT`, `DUPLICATE`, `LATE` or `RESTARTED`; `arrival` is in s."""
        last, paused = self._last, arrival - self._last_arrival > PAUSE
        self._last_arrival = arrival
        if last is None:
            self._begin(number)
            return NEXT
        step = number - last
        if self._modulus:
            half = self._modulus // 2
            step = (step + half) % self._modulus - half
        jumped = step > MAX_LOST and number < last
        if jumped or (step <= 0 and (paused or step < -LATE_WITHIN)):
            return self._restart(number)
        if step > 0:
            self._advance(number, step)
            return NEXT
        if step == 0:
            return DUPLICATE
        self._run = self._run + 1 if number == self._run_last + 1 else 1
        self._run_last = number
        if self._run >= RUN:
            return self._restart(number)
        return self._old(1 << -step)

    def _begin(self, number: int) -> None:
        self._last, self._run = number, 0
        self._arrived, self._missing = 1, 0

    def _advance(self, number: int, step: int) -> None:
        self.lost += step - 1
        self._last, self._run = number, 0
        skipped = ((1 << min(step, LATE_WITHIN + 1)) - 1) & ~1
        self._arrived = _shifted(self._arrived, step) | 1
        self._missing = _shifted(self._missing, step) | skipped

    def _old(self, bit: int) -> int:
        if self._arrived & bit:
            return DUPLICATE
        self._arrived |= bit
        if self._missing & bit:  # otherwise, it precedes the first received number
            self._missing &= ~bit
            self.lost -= 1
        return LATE

    def _restart(self, number: int) -> int:
        self._begin(number)
        return RESTARTED


def _shifted(bits: int, steps: int) -> int:
    return (bits << steps) & _WINDOW if steps <= LATE_WITHIN else 0


class StampTracker:
    """Tracks the time stamps of one sender. Equal time stamps are not duplicates."""

    lost = 0  # time stamps do not show losses

    def __init__(self) -> None:
        self._last: float | None = None
        self._last_arrival = 0.0
        self._run, self._run_last = 0, 0.0

    def classify(self, stamp: float, arrival: float) -> int:
        """Classifies a time stamp in s as `NEXT`, `LATE` or `RESTARTED`; `arrival` is in s."""
        last, paused = self._last, arrival - self._last_arrival > PAUSE
        self._last_arrival = arrival
        if last is None or stamp >= last:
            self._last, self._run = stamp, 0
            return NEXT
        self._run = self._run + 1 if self._run and stamp >= self._run_last else 1
        self._run_last = stamp
        if paused or last - stamp > LATE_SECONDS or self._run >= RUN:
            self._last, self._run = stamp, 0
            return RESTARTED
        return LATE


@dataclass
class _Sender:
    first: int  # number of its first packet
    last: int
    at: float  # arrival time of its last packet, s
    count: int


class Senders:
    """Distinguishes restarted senders from concurrent senders.

    A restarted program sends from another port, and nothing more arrives from its previous port.
    Packets of concurrent senders alternate.

    Attributes:
        at_once: number of concurrent senders.
        gone: addresses of the senders that have restarted with another address, as detected in the
            last batch.
        begins: row of the first packet in the last batch whose sender may be a restarted program;
            None if there is none.
    """

    def __init__(self) -> None:
        self.at_once = 0
        self.gone: list[bytes] = []
        self.begins: int | None = None
        self._seen: dict[bytes, _Sender] = {}
        self._current = b""
        self._replaced: set[bytes] = set()  # senders are removed if they send again
        self._packets = 0

    def note(self, senders: Rows, arrivals: Array) -> None:
        """Registers the senders of a batch of n >= 1 packets.

        Args:
            senders: addresses of the senders, shape (n, any).
            arrivals: arrival times of the packets in seconds, shape (n,).
        """
        self.gone, self.begins = [], None
        if (senders == senders[0]).all():
            self._register(senders[0].tobytes(), np.arange(len(senders)), arrivals)
        else:
            found, which = np.unique(senders, axis=0, return_inverse=True)
            rows = [np.flatnonzero(which.ravel() == k) for k in range(len(found))]
            for k in sorted(range(len(found)), key=lambda k: int(rows[k][0])):
                self._register(found[k].tobytes(), rows[k], arrivals)
            self._current = senders[-1].tobytes()
        self._packets += len(senders)
        self._conclude(float(arrivals[-1]))

    def _register(self, key: bytes, rows: Ints, arrivals: Array) -> None:
        first, last = self._packets + int(rows[0]), self._packets + int(rows[-1])
        known, at = self._seen.get(key), float(arrivals[rows[-1]])
        if known is not None:
            known.last, known.at, known.count = last, at, known.count + len(rows)
            self._replaced.discard(key)
        else:
            before = self._seen.get(self._current)
            self._seen[key] = _Sender(first, last, at, len(rows))
            if before is not None and before.last < first and before.count >= _MIN_STREAM:
                self._replaced.add(self._current)
                self.begins = int(rows[0])
        self._current = key

    def _conclude(self, now: float) -> None:
        if len(self._seen) == 1:
            self.at_once = 1
            return
        for key in [key for key in self._replaced if now - self._seen[key].at > PAUSE]:
            self._replaced.discard(key)
            self.gone.append(key)
        recent = [
            (key, sender)
            for key, sender in self._seen.items()
            if now - sender.at < SEEN_FOR or key == self._current
        ]
        self._seen = dict(recent[-MAX_SENDERS:])
        self._seen.setdefault(self._current, dict(recent)[self._current])
        self._replaced &= self._seen.keys()
        began = self._seen[self._current].first
        self.at_once = sum(sender.last >= began for sender in self._seen.values())


class Timing:
    """Measures rate, jitter and delay from arrival times and time stamps.

    Attributes:
        interval: running mean of the time between packets in seconds; 0 while unknown.
        jitter: running mean in seconds of the deviation of the time between packets from the
            difference of their time stamps (RFC 3550, section 6.4.1), or else from `interval`.
        delay: delay in seconds of the last packet, relative to the fastest packet of the last 10 to
            20 s.
    """

    def __init__(self) -> None:
        self.interval = self.jitter = self.delay = 0.0
        self._arrival: float | None = None
        self._stamp: float | None = None
        self._fastest = [np.inf, np.inf]  # in this window and the previous one
        self._since = 0.0

    def restart(self) -> None:
        """Discards values that depend on the sender's clock. Call this after a restart."""
        self._arrival = self._stamp = None
        self._fastest = [np.inf, np.inf]

    def add(self, arrivals: Array, stamps: Array | None = None) -> None:
        """Adds n >= 1 packets to the statistics.

        Args:
            arrivals: arrival times in seconds, shape (n,).
            stamps: send times in seconds on the sender's clock, shape (n,); None if unknown.
        """
        if len(arrivals) == 1 and self.interval > 0.0 and self._arrival is not None:
            stamp = None if stamps is None else float(stamps[0])
            if stamp is None or self._stamp is not None:
                self._add_one(self._arrival, float(arrivals[0]), stamp)
                return
        times = _joined(self._arrival, arrivals)
        self._arrival = float(arrivals[-1])
        between = np.diff(times)
        steady = between < _LONG_PAUSE
        between = between[steady]
        if self.interval == 0.0 and len(between):
            self.interval = float(between.mean())
        deviations = between - self.interval
        if stamps is not None:
            with np.errstate(over="ignore"):  # stamps may be any numbers
                sent = np.diff(_joined(self._stamp, stamps))
            steady &= np.abs(sent) < _LONG_PAUSE
            deviations = (np.diff(times) - sent)[steady]
        self.interval = _running(self.interval, between)
        self.jitter = _running(self.jitter, np.abs(deviations))
        if stamps is not None:
            self._stamp = float(stamps[-1])
            slowness = arrivals - stamps
            self._compare(float(slowness.min()), float(slowness[-1]))

    def _add_one(self, before: float, arrival: float, stamp: float | None) -> None:
        # The usual case at a robot's rate. Arrays of one number would take eight times as long.
        between = arrival - before
        deviation, sent = between - self.interval, 0.0
        if stamp is not None:
            assert self._stamp is not None
            sent = stamp - self._stamp
            deviation = between - sent
        is_steady = between < _LONG_PAUSE
        if is_steady:
            self.interval += _WEIGHT * (between - self.interval)
        if is_steady and abs(sent) < _LONG_PAUSE:
            self.jitter += _WEIGHT * (abs(deviation) - self.jitter)
        self._arrival = arrival
        if stamp is not None:
            self._stamp = stamp
            self._compare(arrival - stamp, arrival - stamp)

    def _compare(self, fastest: float, last: float) -> None:
        assert self._arrival is not None
        if self._arrival - self._since > _BASELINE:
            self._since = self._arrival
            self._fastest = [np.inf, self._fastest[0]]
        self._fastest[0] = min(self._fastest[0], fastest)
        self.delay = last - min(self._fastest)

    @property
    def fastest(self) -> float:
        """Minimum difference in seconds of arrival time and time stamp in the last 10 to 20 s.

        This is the offset of the receiver's clock from the sender's clock, plus the transmission
        time of the fastest packet. Infinite if unknown.
        """
        return min(self._fastest)

    @property
    def rate(self) -> float:
        """Number of packets per second; 0 while unknown."""
        return 1.0 / self.interval if self.interval > 0 else 0.0


def _joined(before: float | None, values: Array) -> Array:
    return values if before is None else np.concatenate(([before], values))


def _running(mean: float, values: Array) -> float:
    if not len(values):
        return mean
    weights = (1.0 - _WEIGHT) ** np.arange(len(values) - 1, -1, -1)
    return float(mean * (1.0 - _WEIGHT) ** len(values) + _WEIGHT * (weights @ values))
