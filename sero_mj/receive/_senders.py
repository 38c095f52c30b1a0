"""Detects senders: one that replaces another, as after a restart, or several at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ._sequence import PAUSE

Array = NDArray[np.float64]
Addresses = NDArray[np.uint8]

SEEN_FOR = 2.0  # s for which a sender counts after its last packet
MOST = 64  # senders that are followed; more at once is a flood
_STREAM = 2  # packets; who sends every packet from a new port does not begin anew each time


@dataclass
class _Sender:
    """When a sender has sent.

    Attributes:
        first: which packet of all was its first.
        last: which was its last.
        at: when that came, s.
        count: its packets.
    """

    first: int
    last: int
    at: float
    count: int


class Senders:
    """Tells a sender that takes the place of another from one that sends beside it.

    A program that is started anew sends from another port. Its predecessor is silent from then on;
    two that send at once are heard of in turns.

    Attributes:
        at_once: how many send at once; 1 as long as none returns after another one has sent.
        gone: addresses of those in whose place another one sends, since the last `note`.
        begins: row of the last `note` from which on another one sends; None where none begins.
    """

    def __init__(self) -> None:
        self.at_once = 0
        self.gone: list[bytes] = []
        self.begins: int | None = None
        self._seen: dict[bytes, _Sender] = {}
        self._current = b""
        self._replaced: set[bytes] = set()  # who are gone if they keep silent
        self._packets = 0

    def note(self, senders: Addresses, arrivals: Array) -> None:
        """Registers the senders of a batch.

        Args:
            senders: addresses, (n, any number of bytes), n >= 1.
            arrivals: when their packets came, (n,), s.
        """
        self.gone, self.begins = [], None
        if (senders == senders[0]).all():
            self._heard(senders[0].tobytes(), np.arange(len(senders)), arrivals)
        else:
            found, which = np.unique(senders, axis=0, return_inverse=True)
            rows = [np.flatnonzero(which.ravel() == k) for k in range(len(found))]
            for k in sorted(range(len(found)), key=lambda k: int(rows[k][0])):
                self._heard(found[k].tobytes(), rows[k], arrivals)
            self._current = senders[-1].tobytes()
        self._packets += len(senders)
        self._conclude(float(arrivals[-1]))

    def _heard(self, key: bytes, rows: NDArray[np.intp], arrivals: Array) -> None:
        first, last = self._packets + int(rows[0]), self._packets + int(rows[-1])
        known, at = self._seen.get(key), float(arrivals[rows[-1]])
        if known is not None:
            known.last, known.at, known.count = last, at, known.count + len(rows)
            self._replaced.discard(key)
        else:
            before = self._seen.get(self._current)
            self._seen[key] = _Sender(first, last, at, len(rows))
            if before is not None and before.last < first and before.count >= _STREAM:
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
        self._seen = dict(recent[-MOST:])
        self._seen.setdefault(self._current, dict(recent)[self._current])
        self._replaced &= self._seen.keys()
        began = self._seen[self._current].first
        self.at_once = sum(sender.last >= began for sender in self._seen.values())
