"""Loss, reordering, duplicates and restarts of a sender, from its numbers or time stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

LATE_WITHIN = 64  # numbers; what is further back comes from a sender that restarted
LATE_SECONDS = 0.5  # likewise for time stamps
RUN = 4  # as many old packets, one after the other in order, come from such a sender as well
PAUSE = 0.5  # s; after it, an old number comes from such a sender as well
MOST_LOST = 3000  # numbers; who skips more over the wrap to 0 restarted (RFC 3550, appendix A.1)

_WINDOW = (1 << (LATE_WITHIN + 1)) - 1  # a bit for the newest number and each that may be late


class Position(Enum):
    """Order of a packet relative to those before it."""

    NEXT = 0
    DUPLICATE = 1
    LATE = 2
    RESTARTED = 3


@dataclass
class Track:
    """What the numbers of one sender say so far.

    Attributes:
        lost: numbers that never came; one that comes late is taken off again.
    """

    lost: int = 0


class SequenceTracker(Track):
    """Follows the sequence numbers of one sender.

    Args:
        modulus: the number that wraps to 0 (65536 for 16 bits); 0 where they do not wrap.
    """

    def __init__(self, modulus: int = 0) -> None:
        super().__init__()
        self._modulus = modulus
        self._last: int | None = None
        self._last_arrival = 0.0
        self._run, self._run_last = 0, 0
        # Bit k is about the number k before the last: whether it came, whether it counts as lost.
        self._came = self._missing = 0

    def is_consecutive(self, numbers: Sequence[int]) -> bool:
        """Whether they directly follow the last number, so that `skip_to` suffices."""
        first, last = numbers[0], numbers[-1]
        return (
            self._last is not None
            and first == self._last + 1
            and (not self._modulus or last < self._modulus)
            and last - first == len(numbers) - 1
            and list(numbers) == list(range(first, last + 1))  # one twice may hide one lost
        )

    def skip_to(self, number: int, arrival: float) -> None:
        """Advances to a number, all before it having come in order."""
        steps = number - (self._last or 0)
        self._came = _shifted(self._came, steps) | ((1 << min(steps, LATE_WITHIN + 1)) - 1)
        self._missing = _shifted(self._missing, steps)
        self._last, self._last_arrival, self._run = number, arrival, 0

    def classify(self, number: int, arrival: float) -> Position:
        """Classifies a number; `arrival` (s) shows pauses.

        The sender has restarted when the number is more than 64 back, not ahead after a pause
        of half a second, the fourth old one in order, or more than 3000 ahead over the wrap to 0.
        """
        last, paused = self._last, arrival - self._last_arrival > PAUSE
        self._last_arrival = arrival
        if last is None:
            self._begin(number)
            return Position.NEXT
        step = number - last
        if self._modulus:
            half = self._modulus // 2
            step = (step + half) % self._modulus - half
        jumped = step > MOST_LOST and number < last
        if jumped or (step <= 0 and (paused or step < -LATE_WITHIN)):
            return self._restart(number)
        if step > 0:
            self._advance(number, step)
            return Position.NEXT
        if step == 0:
            return Position.DUPLICATE
        self._run = self._run + 1 if number == self._run_last + 1 else 1
        self._run_last = number
        if self._run >= RUN:
            return self._restart(number)
        return self._old(1 << -step)

    def _begin(self, number: int) -> None:
        self._last, self._run = number, 0
        self._came, self._missing = 1, 0

    def _advance(self, number: int, step: int) -> None:
        self.lost += step - 1
        self._last, self._run = number, 0
        skipped = ((1 << min(step, LATE_WITHIN + 1)) - 1) & ~1
        self._came = _shifted(self._came, step) | 1
        self._missing = _shifted(self._missing, step) | skipped

    def _old(self, bit: int) -> Position:
        if self._came & bit:
            return Position.DUPLICATE
        self._came |= bit
        if self._missing & bit:  # else it is from before the first one that was seen
            self._missing &= ~bit
            self.lost -= 1
        return Position.LATE

    def _restart(self, number: int) -> Position:
        self._begin(number)
        return Position.RESTARTED


def _shifted(bits: int, steps: int) -> int:
    return (bits << steps) & _WINDOW if steps <= LATE_WITHIN else 0


class StampTracker(Track):
    """Follows the time stamps of one sender; equal ones are no duplicates."""

    def __init__(self) -> None:
        super().__init__()
        self._last: float | None = None
        self._last_arrival = 0.0
        self._run, self._run_last = 0, 0.0

    def classify(self, stamp: float, arrival: float) -> Position:
        """Classifies a time stamp (s); `arrival` (s) shows pauses."""
        last, paused = self._last, arrival - self._last_arrival > PAUSE
        self._last_arrival = arrival
        if last is None or stamp >= last:
            self._last, self._run = stamp, 0
            return Position.NEXT
        self._run = self._run + 1 if self._run and stamp >= self._run_last else 1
        self._run_last = stamp
        if paused or last - stamp > LATE_SECONDS or self._run >= RUN:
            self._last, self._run = stamp, 0
            return Position.RESTARTED
        return Position.LATE
