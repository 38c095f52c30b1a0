"""`Recorder`: takes packets off receiving threads and writes them on a thread of its own."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...base.errors import RecordingError, UnknownName
from ...base.frames import Array, Ints
from ..receive.structure import Rows
from .recording_format import RecordingClock
from .recording_writer import RecordingWriter

Decode = Callable[[bytes], Mapping[str, Array] | None]

QUEUE_BYTES = 64 << 20
SIGNALS_RATE = 1000.0  # decoded packets per s and source
_PER_PACKET = 64  # bytes that a packet takes in memory beside its own
_BURST = 0.05  # s of signals that may come at once, because packets come in batches


@dataclass(frozen=True)
class RecorderStatistics:
    """Packets and bytes of a recording so far.

    Attributes:
        packets: those that were written, of all sources. When the disk was full, up to one chunk
            (1 MiB, or 0.4 s) of them is lost nevertheless; the error says how many are kept.
        bytes: how long these are together.
        signals: those of them whose decoded values were written too.
        seconds: since the recording began; until it ended, when it has.
        not_recorded: source to the packets that were lost to it: the queue was full, or the
            recording had ended.
        file_size: bytes of the file.
    """

    packets: int
    bytes: int
    signals: int
    seconds: float
    not_recorded: Mapping[str, int]
    file_size: int


@dataclass(frozen=True, eq=False)
class _Batch:
    """Packets of one source, as `Recorder.take` takes them, and their bytes in memory."""

    name: str
    rows: Rows
    lengths: Ints
    arrivals: Array
    size: int

    def __len__(self) -> int:
        return len(self.rows)


class RateLimiter:
    """Allows so many packets per second, a few of them at once (a token bucket).

    Args:
        rate: packets per second; 0 allows none, infinity all.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._most = max(1.0, rate * _BURST)
        self._credit = self._most
        self._last = -math.inf

    def allow(self, arrival: float) -> bool:
        """Whether a packet that arrived then, in s, is one of them."""
        if not 0.0 < self._rate < math.inf:
            return self._rate > 0.0
        if arrival > self._last:
            earned = (arrival - self._last) * self._rate
            self._credit, self._last = min(self._most, self._credit + earned), arrival
        if self._credit < 1.0:
            return False
        self._credit -= 1.0
        return True


class Recorder:
    """Records packets of any number of threads into a file, with bounded memory.

    It never holds up who hands it packets: when the disk is too slow and the queue is full, packets
    are counted in `statistics` as not recorded, and told in the file as well.

    Use it as a context manager, or call `close`.

    Args:
        path: the file.
        about: what it is a recording of, e.g. `{"scene": "lwr_udp"}`.
        overwrite: write over a file that exists; else that is an error.
        queue_bytes: how much may wait to be written.
        signals_rate: of how many packets per second and source the decoded values are kept as well,
            for other programs; 0 for none. All packets are kept as they came.

    Attributes:
        path: the file.
        error: what ended the recording, or None. Nothing is recorded any more then.

    Raises:
        RecordingError: the file exists already, or cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        about: Mapping[str, str],
        overwrite: bool = False,
        queue_bytes: int = QUEUE_BYTES,
        signals_rate: float = SIGNALS_RATE,
    ) -> None:
        self.path = Path(path)
        self.error: Exception | None = None
        self._queue_bytes = queue_bytes
        self._signals_rate = signals_rate
        self._decoders: dict[str, tuple[Decode, RateLimiter]] = {}
        self._packets = self._bytes = self._signals = 0
        self._not_recorded: dict[str, int] = {}
        self._queue: deque[_Batch] = deque()
        self._queued = 0
        self._closing = False
        self._changed = threading.Condition()  # guards the queue; held for moments only
        self._writing = threading.Lock()  # guards the file
        self._writer = RecordingWriter(path, about=about, overwrite=overwrite)
        self._started, self._ended = time.monotonic(), math.nan
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def add_source(self, name: str, *, decode: Decode, **declaration: Any) -> None:
        """Adds a source; before its packets are taken.

        Args:
            name: the source's name in routes.
            decode: a packet to its signals; None, or ValueError, for a malformed one, of which only
                the bytes are kept. It is called on the recorder's thread.
            **declaration: what `RecordingWriter.add_source` takes, and raises errors about.
        """
        with self._writing:
            self._writer.add_source(name, **declaration)
        with self._changed:
            self._not_recorded[name] = 0
            self._decoders[name] = (decode, RateLimiter(self._signals_rate))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Puts a file into the recording; see `RecordingWriter.attach`."""
        with self._writing:
            self._writer.attach(name, media_type, data)

    def take(self, name: str, rows: Rows, lengths: Ints, arrivals: Array) -> bool:
        """Takes packets to be written soon. Cheap, and never waits for the disk.

        Args:
            name: their source.
            rows: (n, bytes), a packet each; they are copied.
            lengths: how many bytes of each row are the packet, (n,). What was longer than its row
                is kept as long as the row.
            arrivals: when each arrived, (n,), s on the clock of `time.monotonic`.

        Returns:
            Whether they will be recorded. If not, all of them are counted.

        Raises:
            UnknownName: no such source was added.
            ValueError: not as many arrivals or lengths as packets.
        """
        if name not in self._decoders:
            raise UnknownName("source", name, self._decoders)
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
                self._not_recorded[name] += count
                return False
            # Their owner will receive into them again.
            batch = _Batch(name, rows.copy(), lengths.copy(), arrivals.copy(), size)
            self._queue.append(batch)
            self._queued += size
            self._changed.notify()
        return True

    @property
    def clock(self) -> RecordingClock:
        """When the recording began, on both clocks."""
        return self._writer.clock

    @property
    def statistics(self) -> RecorderStatistics:
        """Packets and bytes so far."""
        with self._changed:
            end = time.monotonic() if math.isnan(self._ended) else self._ended
            return RecorderStatistics(
                self._packets,
                self._bytes,
                self._signals,
                end - self._started,
                dict(self._not_recorded),
                self._writer.size,
            )

    def close(self) -> None:
        """Writes what was taken, and finishes the file; harmless when it is closed.

        Raises:
            RecordingError: the disk is full, or cannot be written for another reason. What was
                written before is kept and can be read.
        """
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()
        if self.error is not None:
            raise self.error

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _run(self) -> None:
        try:
            while (batch := self._next()) is not None:
                with self._writing:
                    self._write(batch)
                with self._changed:
                    self._queued -= batch.size
            with self._writing:
                self._writer.close(lost=self._not_recorded)
        except Exception as error:  # whatever it is: close() raises it where it is seen
            self._fail(error)
        self._ended = time.monotonic()

    def _next(self) -> _Batch | None:
        """The next batch, as soon as there is one; None when all is written and it closes."""
        while True:
            with self._writing:
                due = self._writer.flush_if_old()
            with self._changed:
                if not self._queue and not self._closing:
                    self._changed.wait(None if math.isinf(due) else due)
                if self._queue:
                    return self._queue.popleft()
                if self._closing:
                    return None

    def _write(self, batch: _Batch) -> None:
        decode, limiter = self._decoders[batch.name]
        before = self._packets
        try:
            ends, times = batch.lengths.tolist(), batch.arrivals.tolist()
            for row, end, arrival in zip(batch.rows, ends, times, strict=True):
                packet = row[:end].tobytes()
                self._writer.write_raw(batch.name, packet, arrival)
                self._packets += 1
                self._bytes += len(packet)
                values = decoded(decode, packet) if limiter.allow(arrival) else None
                if values is not None:
                    self._writer.write_signals(batch.name, values, arrival)
                    self._signals += 1
        except Exception:
            with self._changed:
                self._not_recorded[batch.name] += len(batch) - (self._packets - before)
            raise

    def _fail(self, error: Exception) -> None:
        with self._changed:
            self.error = error
            for batch in self._queue:
                self._not_recorded[batch.name] += len(batch)
            self._queue.clear()
        if not isinstance(error, RecordingError):  # the file itself is well: finish it
            with self._writing:
                try:
                    self._writer.close(lost=self._not_recorded)
                except RecordingError as second:
                    error.add_note(str(second))


def decoded(decode: Decode, packet: bytes) -> Mapping[str, Array] | None:
    """Returns the values of a packet; None for a malformed one."""
    try:
        return decode(packet)
    except ValueError:  # what `Structure.decode` raises for a packet of another size
        return None
