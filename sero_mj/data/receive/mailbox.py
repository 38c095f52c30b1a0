"""`Mailbox`: good packets between the thread that receives them and those that take them."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base.frames import Array
from .structure import Rows

HEARD_BYTES = 16 * 2**20  # of packets that wait for `take_all`; the oldest are dropped
QUEUE_BYTES = 64 * 2**20  # of packets that wait to be taken when none may be lost
_LOOK_AGAIN = 0.1  # s


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


@dataclass(frozen=True, eq=False)
class Packets:
    """Good packets, one after the other.

    Attributes:
        values: event name to its arrays, (n, ...), float64, n >= 1.
        arrivals: when they arrived, (n,), s, on the clock of `Source.now`.
        number: of the last one.
    """

    values: Mapping[str, Array]
    arrivals: Array
    number: int

    def __len__(self) -> int:
        return len(self.arrivals)

    @cached_property
    def last(self) -> Packet:
        """The newest one."""
        values = {event: array[-1] for event, array in self.values.items()}
        return Packet(values, float(self.arrivals[-1]), self.number)


class Mailbox:
    """Keeps good packets until they are taken; they are decoded by who takes them.

    Args:
        decode: makes values of packets in rows.
        on_superseded: is told how many packets were replaced by newer ones before anybody looked.

    Attributes:
        is_lossless: whether every packet is kept, and `put` waits where there is no room; else the
            newest wins.
        number: how many were put until now.
        closing: set while the source is being closed: `put` then no longer waits.
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
        """Forgets all packets and begins to count anew; what `keep_all` has begun goes on."""
        self.number = self._looked = self._taken = self._queued_bytes = 0
        self._last = self._decoded = None
        self._queue.clear()
        if self._heard is not None:
            self.keep_all()
        self._first.clear()
        self.closing.clear()

    def forget_last(self) -> None:
        """Forgets the newest packet; those that follow are counted on, so that they are new."""
        self._last = None

    @property
    def last_arrival(self) -> float | None:
        """When the newest packet arrived, s; None before the first."""
        return None if self._last is None else float(self._last[1][-1])

    def put(self, rows: Rows, arrivals: Array) -> None:
        """Puts packets in, on the source's own thread."""
        last = rows[-1:].copy()
        if self._heard is not None:
            with self._room:
                self._heard.append((rows.copy(), arrivals.copy()))
                self._heard_bytes += rows.size
                while self._heard_bytes > HEARD_BYTES:
                    self._heard_bytes -= self._heard.popleft()[0].size
        if not self.is_lossless:
            self.number = number = self.number + len(rows)
            self._last = (last, arrivals[-1:].copy(), number)
        else:
            with self._room:
                while self._queued_bytes > QUEUE_BYTES and not self.closing.is_set():
                    self._room.wait(_LOOK_AGAIN)
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
        """The packets since the last call, or the newest of them; None where there is none."""
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
        """Begins to keep all packets for `take_all`, whatever `take` returns."""
        with self._room:
            self._heard, self._heard_bytes = deque(), 0

    def take_all(self) -> Packets | None:
        """All packets since the last call, of the last 16 MB; None where there is none."""
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
        """Waits up to `timeout` s until a packet has come; returns whether one has."""
        return self._first.wait(timeout)
