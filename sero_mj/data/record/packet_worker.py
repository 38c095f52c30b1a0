"""Worker that accepts packets from receiving threads, and handles them in its own thread."""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass
from typing import Any, Self

from ...base.errors import RecordingError, UnknownName
from ...base.frames import Array, Ints
from ..receive.structure import Rows

QUEUE_BYTES = 64 << 20
_PER_PACKET = 64  # bytes of memory for each packet, in addition to its contents


@dataclass(frozen=True, eq=False)
class Batch:
    """Packets of one source, see `PacketWorker.take`. `size` is their memory in bytes."""

    name: str
    rows: Rows
    lengths: Ints
    arrivals: Array
    size: int

    def __len__(self) -> int:
        return len(self.rows)


class PacketWorker(ABC):
    """Base class of workers that handle packets from any number of threads in bounded memory.

    `take` never waits: if the queue is full, packets are counted as lost. A subclass calls
    `__init__` last, because this starts the thread. Use it as a context manager, or call `close`.

    Attributes:
        error: exception that has ended the thread, or None. After an error, no packets are
            accepted.
    """

    def __init__(self, name: str, queue_bytes: int = QUEUE_BYTES) -> None:
        self.error: Exception | None = None
        self._queue_bytes = queue_bytes
        self._queue: deque[Batch] = deque()
        self._queued = 0  # bytes of the packets that have not been handled
        self._lost: dict[str, int] = {}  # number of lost packets by source
        self._closing = False
        self._changed = threading.Condition()  # guards the queue; held briefly
        self._started, self._ended = time.monotonic(), math.nan
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def take(self, name: str, rows: Rows, lengths: Ints, arrivals: Array) -> bool:
        """Copies packets to the queue. Returns false if it is full or the worker has ended.

        Args:
            rows: one packet per row, shape (n, bytes).
            lengths: length of each packet in its row, shape (n,).
            arrivals: arrival times in seconds on the clock of `time.monotonic`, shape (n,).
        """
        if name not in self._lost:
            raise UnknownName("source", name, self._lost)
        count = len(rows)
        if len(arrivals) != count or len(lengths) != count:
            found = f"{len(arrivals)} arrivals and {len(lengths)} lengths"
            raise ValueError(f"found {found} for {count} packets; expected one for each")
        if not count:
            return True
        size = rows.nbytes + _PER_PACKET * count
        with self._changed:
            ended = self._closing or self.error is not None
            if ended or self._queued + size > self._queue_bytes:
                self._lost[name] += count
                return False
            # Copies, because the source reuses its arrays.
            self._queue.append(Batch(name, rows.copy(), lengths.copy(), arrivals.copy(), size))
            self._queued += size
            self._changed.notify_all()
        return True

    @property
    def seconds(self) -> float:
        """Time in seconds from the start until now, or until the end."""
        return (time.monotonic() if math.isnan(self._ended) else self._ended) - self._started

    def wait_until_handled(self) -> None:
        """Waits until all packets have been handled, or an error has occurred."""
        with self._changed:
            self._changed.wait_for(lambda: not self._queued or self.error is not None)

    def close(self) -> None:
        """Handles the remaining packets and ends the thread. Raises `error` if it is not None.

        After a RecordingError, for example on a full disk, the data written before can be read.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        if self.error is not None:
            raise self.error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: Any) -> None:
        self.close()

    @abstractmethod
    def _next(self) -> list[Batch] | None:
        """Returns the next packets or an empty list; None if the queue is empty while closing."""

    @abstractmethod
    def _handle(self, batches: list[Batch]) -> None:
        """Called with the next packets, which may be an empty list."""

    @abstractmethod
    def _finish(self, error: Exception | None) -> None:
        """Called after the last packet or an error."""

    def _run(self) -> None:
        try:
            while (batches := self._next()) is not None:
                self._handle(batches)
                with self._changed:
                    self._queued -= sum(batch.size for batch in batches)
                    self._changed.notify_all()
            self._finish(None)
        except Exception as error:  # `close` raises it in the caller's thread
            with self._changed:
                self.error = error
                for batch in self._queue:
                    self._lost[batch.name] += len(batch)
                self._queue.clear()
                self._changed.notify_all()
            try:
                self._finish(error)
            except RecordingError as second:
                if second is not error:
                    error.add_note(str(second))
        self._ended = time.monotonic()
