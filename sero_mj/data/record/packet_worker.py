"""`PacketWorker`: takes packets off receiving threads and handles them on a thread of its own."""

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
_PER_PACKET = 64  # bytes that a packet takes in memory beside its own


@dataclass(frozen=True, eq=False)
class Batch:
    """Packets of one source, as `PacketWorker.take` takes them, and their bytes in memory."""

    name: str
    rows: Rows
    lengths: Ints
    arrivals: Array
    size: int

    def __len__(self) -> int:
        return len(self.rows)


class PacketWorker(ABC):
    """Handles packets of any number of threads, with bounded memory.

    It never holds up who hands it packets: when it is too slow and the queue is full, packets are
    counted as lost. A subclass calls `__init__` when all that its thread needs is there.

    Use it as a context manager, or call `close`.

    Attributes:
        error: what ended it, or None. Nothing is taken any more then.
    """

    def __init__(self, name: str, queue_bytes: int = QUEUE_BYTES) -> None:
        self.error: Exception | None = None
        self._queue_bytes = queue_bytes
        self._queue: deque[Batch] = deque()
        self._queued = 0  # bytes of what is not yet handled
        self._lost: dict[str, int] = {}  # packets, by source
        self._closing = False
        self._changed = threading.Condition()  # guards the queue; held for moments only
        self._started, self._ended = time.monotonic(), math.nan
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def take(self, name: str, rows: Rows, lengths: Ints, arrivals: Array) -> bool:
        """Takes packets to be handled soon. Cheap, and never waits.

        Args:
            rows: (n, bytes), a packet each; they are copied.
            lengths: how many bytes of each row are the packet, (n,). What was longer than its row
                is kept as long as the row.
            arrivals: when each arrived, (n,), s on the clock of `time.monotonic`.

        Returns:
            Whether they will be handled. If not, all of them are counted.

        Raises:
            UnknownName: no such source was added.
            ValueError: not as many arrivals or lengths as packets.
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
            # Their owner will receive into them again.
            self._queue.append(Batch(name, rows.copy(), lengths.copy(), arrivals.copy(), size))
            self._queued += size
            self._changed.notify_all()
        return True

    @property
    def seconds(self) -> float:
        """Since it began; until it ended, when it has."""
        return (time.monotonic() if math.isnan(self._ended) else self._ended) - self._started

    def wait_until_seen(self) -> None:
        """Waits until all packets that were taken have been handled, or it has failed."""
        with self._changed:
            self._changed.wait_for(lambda: not self._queued or self.error is not None)

    def close(self) -> None:
        """Handles what was taken, and finishes; harmless when it is closed.

        Raises:
            RecordingError: the disk is full, or cannot be written for another reason. What was
                written before is kept and can be read.
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
        """What is to be handled next, perhaps nothing; None when all is and it closes."""

    @abstractmethod
    def _handle(self, batches: list[Batch]) -> None:
        """Handles packets, and what else is due."""

    @abstractmethod
    def _finish(self, error: Exception | None) -> None:
        """Ends what is written, after the last packet or an error."""

    def _run(self) -> None:
        try:
            while (batches := self._next()) is not None:
                self._handle(batches)
                with self._changed:
                    self._queued -= sum(batch.size for batch in batches)
                    self._changed.notify_all()
            self._finish(None)
        except Exception as error:  # whatever it is: close() raises it where it is seen
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
