"""What a controller makes of a client's answers: statistics, and the quality of the link."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

WINDOW = 100  # packets that FRI averages over
_PATIENCE = 2  # packets that may go out before the answer to one is missed; ours
# The answer rate from which a quality is reached. FRI says that it grades the link in four steps,
# not where these are; the thresholds are ours.
_REACHED_FROM = {3: 0.95, 2: 0.8, 1: 0.5, 0: 0.0}


@dataclass
class _Sent:
    """One packet: its counter, when it went, and how long its answer took, s."""

    counter: int
    time: float
    latency: float | None = None


class AnswerStatistics:
    """Follows which packets were answered.

    Attributes:
        miss_counter: packets that were not answered in time, so far.
    """

    def __init__(self) -> None:
        self.miss_counter = 0
        self._sent: deque[_Sent] = deque()

    def send(self, counter: int, time: float) -> None:
        """Notes that a packet goes out at a time (s)."""
        self._sent.append(_Sent(counter, time))
        if len(self._sent) > _PATIENCE and self._sent[-1 - _PATIENCE].latency is None:
            self.miss_counter += 1
        if len(self._sent) > WINDOW + _PATIENCE:
            self._sent.popleft()

    def answer(self, reflected: int, time: float) -> None:
        """Notes an answer that came at a time (s); one that is late counts as missed."""
        waiting = list(self._sent)[-_PATIENCE:]
        for packet in waiting:
            if packet.counter == reflected and packet.latency is None:
                packet.latency = max(time - packet.time, 0.0)

    def _latencies(self) -> list[float]:
        """Of the answers to the last 100 packets that can have been answered."""
        judged = list(self._sent)[:-_PATIENCE]
        return [packet.latency for packet in judged if packet.latency is not None]

    def values(self) -> dict[str, float]:
        """FRI's statistics; packets before the first count as not answered."""
        latencies = self._latencies()
        rate = len(latencies) / WINDOW
        return {
            "answer_rate": rate,
            "latency": float(np.mean(latencies)) if latencies else 0.0,
            "jitter": float(np.std(latencies)) if latencies else 0.0,
            "miss_rate": 1.0 - rate,
            "miss_counter": self.miss_counter,
        }

    @property
    def quality(self) -> int:
        """0 unacceptable to 3 perfect, by the answer rate."""
        rate = len(self._latencies()) / WINDOW
        return next(quality for quality, least in _REACHED_FROM.items() if rate >= least)
