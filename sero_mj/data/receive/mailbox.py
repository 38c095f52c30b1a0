"""`Mailbox`: passes good packets from the receiving thread to its consumers."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base.frames import Array
from .structure import Rows

HEARD_BYTES = 16 * 2**20  # of packets waiting for `take_all`; the oldest are dropped
QUEUE_BYTES = 64 * 2**20  # of packets waiting to be taken when none may be lost
_WAIT_INTERVAL = 0.1  # s


@dataclass(frozen=True, eq=False)
class Packet:
    """One good packet.

    Attributes:
        values: event name to its array, float64: `name[i]` is event `name` number i. NaN only in
            events in which NaN is allowed; matrices are rigid frames.
        arrival: when it arrived, on the clock of `Source.now`, s.
        number: 1 for the first good packet of the source.
    """

    values: Mapping[str, Array]
    arrival: float
    number: int


def age(packet: Packet | None, now: float) -> float:
    """Seconds since the packet arrived, `now` being `Source.now()`.

    Infinite without a packet, 0 if it arrived after `now`.
    """
    return float("inf") if packet is None else max(now - packet.arrival, 0.0)


@dataclass(frozen=True, eq=False)
class Packets:
    """Consecutive good packets.

    Attributes:
        values: event name to its arrays, (n, ...), float64, n >= 1.
        arrivals: (n,), s, on the clock of `Source.now`.
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
    """Keeps good packets until they are taken; the consumer decodes them.

    Args:
        on_superseded: called with the number of packets replaced by newer ones before use.

    Attributes:
        is_lossless: whether every packet is kept, and `put` waits for room; else only the newest.
        closing: set while the source is being closed, so that `put` does not wait.
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
        self._heard: deque[tuple[Rows, Array]] | None = None  # see `keep_all`
        self._heard_bytes = 0

    def empty(self) -> None:
        """Discards all packets and resets the count; `keep_all` stays in effect."""
        self.number = self._looked = self._taken = self._queued_bytes = 0
        self._last = self._decoded = None
        self._queue.clear()
        if self._heard is not None:
            self.keep_all()
        self._first.clear()
        self.closing.clear()

    def forget_last(self) -> None:
        """Discards the newest packet; counting continues, so that later ones are new."""
        self._last = None

    @property
    def last_arrival(self) -> float | None:
        """When the newest packet arrived, s; None before the first."""
        return None if self._last is None else float(self._last[1][-1])

    def put(self, rows: Rows, arrivals: Array) -> None:
        """Adds packets, on the source's own thread."""
        last = rows[-1:].copy()
        if self._heard is not None:
            with self._room:
                if (heard := self._heard) is not None:
                    heard.append((rows.copy(), arrivals.copy()))
                    self._heard_bytes += rows.size
                    while self._heard_bytes > HEARD_BYTES:
                        self._heard_bytes -= heard.popleft()[0].size
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
        """The newest packet; None before the first."""
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
        """The packets since the last call, or the newest of them; None without any."""
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

    def keep_all(self) -> None:
        """Starts to keep all packets for `take_all`, independent of `take`."""
        with self._room:
            self._heard, self._heard_bytes = deque(), 0

    def keep_none(self) -> None:
        """Ends `keep_all`, and drops the packets that nobody has taken."""
        with self._room:
            self._heard, self._heard_bytes = None, 0

    def take_all(self) -> Packets | None:
        """All packets since the last call, at most 16 MB; None without any."""
        with self._room:
            batches, self._heard_bytes = [*(self._heard or ())], 0
            if batches:
                self._heard = deque()
            number = self.number
        return self._joined(batches, number)

    def _joined(self, batches: Sequence[tuple[Rows, Array]], number: int) -> Packets | None:
        if not batches:
            return None
        rows = np.concatenate([rows for rows, _ in batches])
        arrivals = np.concatenate([arrivals for _, arrivals in batches])
        return Packets(self._decode(rows), arrivals, number)

    def wait(self, timeout: float) -> bool:
        """Waits up to `timeout` s for a packet; returns whether one has arrived."""
        return self._first.wait(timeout)
