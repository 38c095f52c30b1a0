"""Passes valid packets from the receiving thread of a source to its consumers."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base.frames import Array
from .structure import Rows

HISTORY_BYTES = 16 * 2**20  # maximum size of the packets stored for `take_history`
QUEUE_BYTES = 64 * 2**20  # maximum size of the packets stored for `take` if none may be lost
_WAIT_INTERVAL = 0.1  # s


@dataclass(frozen=True, eq=False)
class Packet:
    """A valid packet of a source.

    Attributes:
        values: mapping from event names to float64 arrays. NaN occurs only in events in which it
            is allowed. Matrices are rigid frames.
        arrival: arrival time in seconds on the clock of `Source.now`.
        number: number of the packet. The first valid packet of the source has the number 1.
    """

    values: Mapping[str, Array]
    arrival: float
    number: int


def age(packet: Packet | None, now: float) -> float:
    """Returns the non-negative time in seconds since a packet arrived; infinity for None."""
    return float("inf") if packet is None else max(now - packet.arrival, 0.0)


@dataclass(frozen=True, eq=False)
class Packets:
    """n >= 1 consecutive valid packets of a source.

    Attributes:
        values: mapping from event names to float64 arrays, shape (n, ...).
        arrivals: arrival times in seconds on the clock of `Source.now`, shape (n,).
        number: number of the last packet, as in `Packet`.
    """

    values: Mapping[str, Array]
    arrivals: Array
    number: int

    def __len__(self) -> int:
        return len(self.arrivals)

    @cached_property
    def last(self) -> Packet:
        values = {event: array[-1] for event, array in self.values.items()}
        return Packet(values, float(self.arrivals[-1]), self.number)


class Mailbox:
    """Stores valid packets until a consumer takes and decodes them.

    Args:
        decode: function that decodes rows, called in the thread of the consumer.
        on_superseded: function called with the number of packets that were replaced before use.

    Attributes:
        is_lossless: whether all packets are stored, and `put` waits if the queue is full.
            Otherwise, only the newest packet is stored.
        closing: event that is set while the source is being closed, so that `put` does not wait.
    """

    def __init__(
        self,
        decode: Callable[[Rows], Mapping[str, Array]],
        on_superseded: Callable[[int], None],
        *,
        is_lossless: bool,
    ) -> None:
        self._decode, self._on_superseded, self.is_lossless = decode, on_superseded, is_lossless
        self.number = 0
        self.closing = threading.Event()
        self._first = threading.Event()
        self._room = threading.Condition()
        self._last: tuple[Rows, Array, int] | None = None
        self._decoded: Packets | None = None
        self._looked = self._taken = 0
        self._queue: deque[tuple[Rows, Array]] = deque()
        self._queued_bytes = 0
        self._history: deque[tuple[Rows, Array]] | None = None  # packets for `take_history`
        self._history_bytes = 0

    def empty(self) -> None:
        """Discards all packets, and resets their count. `start_history` stays in effect."""
        self.number = self._looked = self._taken = self._queued_bytes = 0
        self._last = self._decoded = None
        self._queue.clear()
        if self._history is not None:
            self.start_history()
        self._first.clear()
        self.closing.clear()

    def forget_last(self) -> None:
        """Discards the newest packet without resetting the count."""
        self._last = None

    @property
    def last_arrival(self) -> float | None:
        """Arrival time of the newest packet in seconds; None before the first packet."""
        return None if self._last is None else float(self._last[1][-1])

    def put(self, rows: Rows, arrivals: Array) -> None:
        """Adds valid packets. Called in the receiving thread."""
        last = rows[-1:].copy()
        if self._history is not None:
            with self._room:
                if (history := self._history) is not None:
                    history.append((rows.copy(), arrivals.copy()))
                    self._history_bytes += rows.size
                    while self._history_bytes > HISTORY_BYTES:
                        self._history_bytes -= history.popleft()[0].size
        if not self.is_lossless:
            self.number = number = self.number + len(rows)
            self._last = (last, arrivals[-1:].copy(), number)
        else:
            with self._room:
                while self._queued_bytes > QUEUE_BYTES and not self.closing.is_set():
                    self._room.wait(_WAIT_INTERVAL)
                self._queue.append((rows.copy(), arrivals.copy()))
                self._queued_bytes += rows.size
                self.number += len(rows)
                self._last = (last, arrivals[-1:].copy(), self.number)
        self._first.set()

    def newest(self) -> Packets | None:
        """Returns the newest packet, or None before the first packet."""
        last, decoded = self._last, self._decoded
        if last is None:
            return None
        rows, arrivals, number = last
        if decoded is None or decoded.number != number:
            decoded = self._decoded = Packets(self._decode(rows), arrivals, number)
        if number > self._looked:
            if not self.is_lossless:
                self._on_superseded(number - self._looked - 1)
            self._looked = number
        return decoded

    def take(self) -> Packets | None:
        if not self.is_lossless:
            packets = self.newest()
            if packets is None or packets.number == self._taken:
                return None
            self._taken = packets.number
            return packets
        with self._room:
            batches = list(self._queue)
            self._queue.clear()
            self._queued_bytes = 0
            self._taken = self._looked = self.number
            self._room.notify()
        return self._joined(batches, self._taken)

    def start_history(self) -> None:
        with self._room:
            self._history, self._history_bytes = deque(), 0

    def stop_history(self) -> None:
        with self._room:
            self._history, self._history_bytes = None, 0

    def take_history(self) -> Packets | None:
        with self._room:
            batches, self._history_bytes = [*(self._history or ())], 0
            if batches:
                self._history = deque()
            number = self.number
        return self._joined(batches, number)

    def _joined(self, batches: Sequence[tuple[Rows, Array]], number: int) -> Packets | None:
        if not batches:
            return None
        rows = np.concatenate([rows for rows, _ in batches])
        arrivals = np.concatenate([arrivals for _, arrivals in batches])
        return Packets(self._decode(rows), arrivals, number)

    def wait(self, timeout: float) -> bool:
        return self._first.wait(timeout)
