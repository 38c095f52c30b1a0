"""Recorder that accepts packets from receiving threads, and writes them in its own thread."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...base.errors import RecordingError
from ...base.frames import Array
from .packet_worker import QUEUE_BYTES, Batch, PacketWorker
from .recording_format import RecordingClock
from .recording_writer import RecordingWriter

Decode = Callable[[bytes], Mapping[str, Array] | None]

SIGNALS_RATE = 20.0  # decoded packets per second and source; adds 10 % to the file size at 1 kHz
_BURST = 0.05  # s; packets of this interval may be decoded at once, because they form batches


@dataclass(frozen=True)
class RecorderStatistics:
    """Counts of packets and bytes in a recording so far.

    Attributes:
        packets: number of written packets of all sources. If the disk is full, up to one chunk (1
            MiB, or 0.4 s) is lost, and the error reports the number of packets in the file.
        signals: number of packets whose decoded values were written as well.
        seconds: duration of the recording in seconds.
        not_recorded: number of packets by source that were lost because the queue was full or the
            recording had ended.
    """

    packets: int
    bytes: int
    signals: int
    seconds: float
    not_recorded: Mapping[str, int]
    file_size: int


class RateLimiter:
    """Limits the number of packets per second with a token bucket. `rate` may be infinite."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._max_credit = max(1.0, rate * _BURST)
        self._credit = self._max_credit
        self._last = -math.inf

    def allow(self, arrival: float) -> bool:
        """Returns whether a packet that arrives at a time in seconds is within the rate."""
        if not 0.0 < self._rate < math.inf:
            return self._rate > 0.0
        if arrival > self._last:
            earned = (arrival - self._last) * self._rate
            self._credit, self._last = min(self._max_credit, self._credit + earned), arrival
        if self._credit < 1.0:
            return False
        self._credit -= 1.0
        return True


class PacketWriter(RecordingWriter):
    """Writes packets, and the decoded values of some of them for other programs.

    Args:
        signals_rate: maximum number of decoded packets per second and source.
        **options: options of `RecordingWriter`.
    """

    def __init__(self, path: Path | str, *, signals_rate: float, **options: Any) -> None:
        super().__init__(path, **options)
        self._signals_rate = signals_rate
        self._decoders: dict[str, tuple[Decode, RateLimiter]] = {}

    def add_decoded(self, name: str, decode: Decode, **declaration: Any) -> None:
        """Adds a source whose packets are decoded; see `Recorder.add_source`."""
        self.add_source(name, **declaration)
        self._decoders[name] = (decode, RateLimiter(self._signals_rate))

    def write_values(self, name: str, packet: bytes, arrival: float) -> bool:
        """Writes the values of a packet after `write_raw`. Returns false if they are skipped."""
        decode, limiter = self._decoders[name]
        if not limiter.allow(arrival):
            return False
        try:
            values = decode(packet)
        except ValueError:  # from `Structure.decode`, for a packet of another size
            return False
        if values is not None:
            self.write_signals(name, values, arrival)
        return values is not None


class Recorder(PacketWorker):
    """Records packets from any number of threads to a file, with bounded memory.

    If the disk is too slow, packets are lost. They are counted in `statistics` and in the file.
    Raises RecordingError if the file exists or cannot be written.

    Args:
        about: description of the recording, such as `{"scene": "lwr_udp"}`.
        overwrite: whether to replace an existing file.
        signals_rate: maximum number of packets per second and source whose decoded values are
            recorded as well, for other programs; 0 for none.
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
        self._packets = self._bytes = self._signals = 0
        self._writing = threading.Lock()  # guards the file
        self._writer = PacketWriter(
            path, about=about, overwrite=overwrite, signals_rate=signals_rate
        )
        super().__init__("recorder", queue_bytes)

    def add_source(self, name: str, *, decode: Decode, **declaration: Any) -> None:
        """Adds a source. Call this before `take`.

        Args:
            decode: function that converts a packet to its signals, called in the recorder's thread.
                For a malformed packet, it returns None or raises ValueError.
            **declaration: arguments of `RecordingWriter.add_source`.
        """
        with self._writing:
            self._writer.add_decoded(name, decode, **declaration)
        with self._changed:
            self._lost[name] = 0

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        with self._writing:
            self._writer.attach(name, media_type, data)

    @property
    def clock(self) -> RecordingClock:
        """Start time of the recording on both clocks."""
        return self._writer.clock

    @property
    def statistics(self) -> RecorderStatistics:
        """Counts of packets and bytes so far."""
        with self._changed:
            return RecorderStatistics(
                self._packets,
                self._bytes,
                self._signals,
                self.seconds,
                dict(self._lost),
                self._writer.size,
            )

    def _next(self) -> list[Batch] | None:
        with self._writing:
            due = self._writer.flush_if_old()
        with self._changed:
            if not (self._queue or self._closing):
                self._changed.wait(None if math.isinf(due) else due)
            if self._queue:
                return [self._queue.popleft()]
            return None if self._closing else []

    def _handle(self, batches: list[Batch]) -> None:
        for batch in batches:
            with self._writing:
                self._write(batch)

    def _write(self, batch: Batch) -> None:
        before = self._packets
        try:
            ends, times = batch.lengths.tolist(), batch.arrivals.tolist()
            for row, end, arrival in zip(batch.rows, ends, times, strict=True):
                packet = row[:end].tobytes()
                self._writer.write_raw(batch.name, packet, arrival)
                self._packets += 1
                self._bytes += len(packet)
                self._signals += self._writer.write_values(batch.name, packet, arrival)
        except Exception:
            with self._changed:
                self._lost[batch.name] += len(batch) - (self._packets - before)
            raise

    def _finish(self, error: Exception | None) -> None:
        if not isinstance(error, RecordingError):  # after that, the file cannot be written
            with self._writing:
                self._writer.close(lost=self._lost)
