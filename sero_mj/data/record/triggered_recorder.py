"""Recorder that buffers the packets of the last seconds, and records those around each event."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from ...base.frames import Bools, Ints
from ..receive.structure import Rows
from .packet_worker import Batch, PacketWorker
from .recorder import SIGNALS_RATE, Decode, PacketWriter
from .recording_format import RecordingClock

MAX_BUFFER_BYTES = 256 << 20  # maximum size of the buffer
_BATCH_BYTES = 600  # memory for the objects of a batch
_LATE = 0.3  # s; maximum delay of packets from the thread of their source
_POLL = 0.1  # s
_GATHER = 0.01  # s; packets are checked together, because many take as long as a few
_SAME = 1e-6  # s; rounding errors of times are smaller

# Function of a source name, rows (n, bytes) and lengths (n,). It returns a mask (n,) of the packets
# that fulfill the condition, and a function that describes a packet by its row.
Find = Callable[[str, Rows, Ints], tuple[Bools, Callable[[int], str]]]
Clock = Callable[[], float]


@dataclass(frozen=True)
class RecordedEvent:
    """An event and its recording. Times are in seconds, on the same clock as arrival times.

    Attributes:
        number: number of the event, counted from 1.
        time: time at which the event began.
        what: values that fulfill the condition: `lwr/A3: abs(lwr.torque_error) = 23.4 > 20`.
        began: start time of the recording.
        ended: end time of the recording; NaN until it ends.
        again: number of times that the condition was fulfilled again during the recording.
    """

    number: int
    time: float
    what: str
    path: Path
    began: float
    ended: float = math.nan
    packets: int = 0
    again: int = 0


class _Ring:
    def __init__(self, seconds: float, max_bytes: int) -> None:
        self.size = 0
        self.evicted = 0  # packets that were removed early because of `max_bytes`
        self._seconds, self._max_bytes = seconds, max_bytes
        self._batches: deque[Batch] = deque()

    def add(self, batch: Batch) -> None:
        self._batches.append(batch)
        self.size += _size_of(batch)
        now = batch.arrivals[-1]
        while len(self._batches) > 1:
            oldest = self._batches[0]
            is_old = oldest.arrivals[-1] < now - self._seconds - _LATE
            if not is_old and self.size <= self._max_bytes:
                return
            self.evicted += 0 if is_old else len(oldest)
            self.size -= _size_of(oldest)
            self._batches.popleft()

    def since(self, begin: float) -> list[tuple[float, str, bytes]]:
        found = []
        for batch in self._batches:
            for k in np.flatnonzero(batch.arrivals >= begin).tolist():
                packet = batch.rows[k, : batch.lengths[k]].tobytes()
                found.append((float(batch.arrivals[k]), batch.name, packet))
        found.sort(key=lambda each: each[0])
        return found


def _size_of(batch: Batch) -> int:
    return _BATCH_BYTES + batch.rows.nbytes + batch.lengths.nbytes + batch.arrivals.nbytes


@dataclass(frozen=True)
class TriggerStatistics:
    """Counts of packets and events so far.

    Attributes:
        buffer_bytes: size of the buffer in bytes.
        evicted: number of packets that were removed early because the buffer was full.
        unchecked: number of packets by source that were not checked because the queue was full.
    """

    packets: int
    events: int
    seconds: float
    buffer_bytes: int
    evicted: int
    unchecked: Mapping[str, int]
    is_recording: bool


class TriggeredRecorder(PacketWorker):
    """Records the packets before and after a condition is fulfilled, with bounded memory.

    Each event has its own recording. An event during a recording extends that recording.

    Args:
        path_of: function that returns the file for the number (from 1) and time of an event.
        find: function that checks the condition, called in the recorder's thread.
        before: time in seconds to record before an event.
        after: time in seconds to record after the condition was last fulfilled.
        overwrite: whether to replace existing files; otherwise, an existing file is an error.
        signals_rate: maximum number of packets per second and source whose decoded values are
            recorded as well.
        buffer_bytes: maximum size of the buffer in bytes.
        clock_at: function that returns the clock of a recording for the arrival time of its first
            packet; None for live sources.
        now: function that returns the current time on the same clock as arrival times; None if the
            packets do not arrive in real time, for example in a replay.

    Attributes:
        on_event: function called when an event begins, and when its recording is complete.
    """

    def __init__(
        self,
        path_of: Callable[[int, float], Path],
        find: Find,
        *,
        about: Mapping[str, str],
        before: float,
        after: float,
        overwrite: bool = False,
        signals_rate: float = SIGNALS_RATE,
        buffer_bytes: int = MAX_BUFFER_BYTES,
        clock_at: Callable[[float], RecordingClock] | None = None,
        now: Clock | None = time.monotonic,
    ) -> None:
        self.events: list[RecordedEvent] = []
        self.on_event: Callable[[RecordedEvent], None] = lambda _: None
        self._path_of, self._find, self._about = path_of, find, dict(about)
        self._before, self._after, self._overwrite = before, after, overwrite
        self._signals_rate, self._clock_at, self._now = signals_rate, clock_at or live_clock, now
        self._ring = _Ring(before, buffer_bytes)
        self._sources: dict[str, tuple[Decode, dict[str, Any]]] = {}  # with their declarations
        self._files: list[tuple[str, str, bytes]] = []
        self._writer: PacketWriter | None = None
        self._until = self._last = math.nan
        self._count = 0  # packets of the current recording
        self._packets = 0
        self._last_seen = math.nan  # arrival of the last packet
        # Whether the last packet of each source fulfilled the condition.
        self._was_fulfilled: dict[str, bool] = {}
        self._requested: list[str] = []  # descriptions of events from `record_now`
        super().__init__("triggered recorder")

    def add_source(self, name: str, *, decode: Decode, **declaration: Any) -> None:
        with self._changed:
            self._sources[name] = decode, declaration
            self._lost[name] = 0

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Adds a file to all recordings; see `RecordingWriter.attach`."""
        self._files.append((name, media_type, data))

    def record_now(self, what: str) -> None:
        """Records the packets around now as an event, even if the condition does not hold."""
        with self._changed:
            self._requested.append(what)
            self._changed.notify_all()

    @property
    def statistics(self) -> TriggerStatistics:
        with self._changed:
            return TriggerStatistics(
                self._packets,
                len(self.events),
                self.seconds,
                self._ring.size,
                self._ring.evicted,
                dict(self._lost),
                self._writer is not None,
            )

    def _next(self) -> list[Batch] | None:
        with self._changed:
            if not (self._queue or self._requested or self._closing):
                self._changed.wait(_POLL if self._writer is not None else None)
            if not self._closing:
                self._changed.wait_for(lambda: self._closing, _GATHER)
            found = [*self._queue]
            self._queue.clear()
            if not (found or self._requested) and self._closing:
                return None
        return _joined(found)

    def _handle(self, batches: list[Batch]) -> None:
        for batch in batches:
            self._process(batch)
            self._packets += len(batch)
        with self._changed:
            requested, self._requested = self._requested, []
        for what in requested:
            self._end()
            self._begin(self._last_seen if self._now is None else self._now(), what)
        if self._writer is None:
            return
        self._writer.flush_if_old()
        if self._now is not None and self._now() > self._until + _LATE:
            self._end()

    def _finish(self, error: Exception | None) -> None:
        self._end()

    def _process(self, batch: Batch) -> None:
        holds, describe = self._find(batch.name, batch.rows, batch.lengths)
        hits = np.flatnonzero(holds)
        is_new = holds & ~np.append(self._was_fulfilled.get(batch.name, False), holds[:-1])
        self._was_fulfilled[batch.name] = bool(holds[-1])
        row = 0
        while row < len(batch.rows):
            rest = hits[hits >= row]
            if self._writer is None:
                if not len(rest):
                    self._buffer(_part(batch, slice(row, None)))
                    return
                # The packet that fulfills the condition is the first one of the recording.
                self._buffer(_part(batch, slice(row, int(rest[0]))))
                row = int(rest[0])
                self._begin(float(batch.arrivals[row]), describe(row))
            # Packets up to the end of the recording, which each further hit extends.
            end = row
            for hit in [*rest.tolist(), len(batch.rows)]:
                inside = batch.arrivals[row:hit] <= self._until
                end = row + int(inside.argmin()) if not inside.all() else hit
                if end < hit or hit == len(batch.rows) or batch.arrivals[hit] > self._until:
                    break
                self._extend(float(batch.arrivals[hit]), is_new=bool(is_new[hit]))
            part = _part(batch, slice(row, end))
            self._buffer(part)
            self._write(part)
            row = end
            if row < len(batch.rows):
                self._end()

    def _buffer(self, batch: Batch) -> None:
        if len(batch.rows):
            self._last_seen = float(batch.arrivals[-1])
            self._ring.add(batch)

    def _begin(self, arrival: float, what: str) -> None:
        earlier = self._ring.since(arrival - self._before - _SAME)
        began = min([arrival, *(each[0] for each in earlier[:1])])
        number = len(self.events) + 1
        path = self._path_of(number, arrival)
        about = {**self._about, "event": what, "event_time": f"{arrival - began:.6f}"}
        self._writer = writer = PacketWriter(
            path,
            about=about,
            overwrite=self._overwrite,
            clock=self._clock_at(began),
            signals_rate=self._signals_rate,
        )
        for name, (decode, declaration) in self._sources.items():
            writer.add_decoded(name, decode, **declaration)
        for file in self._files:
            writer.attach(*file)
        event = RecordedEvent(number, arrival, what, path, began)
        with self._changed:
            self.events.append(event)
        self._count = 0
        for at, name, packet in earlier:
            self._put(name, packet, at)
        self._until = arrival + self._after + _SAME
        self.on_event(event)

    def _extend(self, arrival: float, *, is_new: bool) -> None:
        event = self.events[-1]
        self._until = arrival + self._after + _SAME
        if is_new and arrival > event.time:
            self._change(again=event.again + 1)

    def _change(self, **fields: Any) -> None:
        with self._changed:
            self.events[-1] = replace(self.events[-1], **fields)

    def _write(self, batch: Batch) -> None:
        for row, end, arrival in zip(
            batch.rows, batch.lengths.tolist(), batch.arrivals.tolist(), strict=True
        ):
            self._put(batch.name, row[:end].tobytes(), arrival)

    def _put(self, name: str, packet: bytes, arrival: float) -> None:
        assert self._writer is not None
        self._writer.write_raw(name, packet, arrival)
        self._writer.write_values(name, packet, arrival)
        self._count += 1
        self._last = arrival

    def _end(self) -> None:
        writer, self._writer = self._writer, None
        if writer is None:
            return
        writer.close(lost=self._lost)
        self._change(ended=self._last, packets=self._count)
        self.on_event(self.events[-1])


def _part(batch: Batch, rows: slice) -> Batch:
    return replace(
        batch, rows=batch.rows[rows], lengths=batch.lengths[rows], arrivals=batch.arrivals[rows]
    )


def _joined(batches: list[Batch]) -> list[Batch]:
    found: list[Batch] = []
    for _, group in groupby(batches, key=lambda each: (each.name, each.rows.shape[1])):
        parts = list(group)
        found.append(
            Batch(
                parts[0].name,
                np.concatenate([part.rows for part in parts]),
                np.concatenate([part.lengths for part in parts]),
                np.concatenate([part.arrivals for part in parts]),
                sum(part.size for part in parts),
            )
        )
    return found


def live_clock(arrival: float) -> RecordingClock:
    """Returns the clock of a live recording that starts at a time of `time.monotonic` in s."""
    ago = round((time.monotonic() - arrival) * 1e9)
    return RecordingClock(time.time_ns() - ago, round(arrival * 1e9))
