"""`TriggeredRecorder`: keeps the last seconds of packets, and a recording of each event in them."""

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

from ...base.frames import Array, Bools, Ints
from ..receive.structure import Rows
from .packet_worker import Batch, PacketWorker
from .recorder import SIGNALS_RATE, Decode, PacketWriter
from .recording_format import RecordingClock

KEPT_BYTES = 256 << 20  # of the last seconds
_BLOCK = 512  # packets
_LATE = 0.3  # s that packets may come late from their source's thread
_POLL = 0.1  # s
_GATHER = 0.01  # s; many packets at once are looked at in the time of a few
_SAME = 1e-6  # s; times are kept in ns, and are no further apart than this

# Where packets (n, bytes) of a source fulfil a condition, (n,), and what to say of one of them.
Find = Callable[[str, Rows, Ints], tuple[Bools, Callable[[int], str]]]
Clock = Callable[[], float]


@dataclass(frozen=True)
class RecordedEvent:
    """An event that was recorded.

    Attributes:
        number: from 1.
        time: when it began, s on the clock of arrivals.
        what: what fulfilled the condition: `lwr/A3: abs(lwr.torque_error) = 23.4 > 20`.
        began: when the recording begins, s on the clock of arrivals.
        ended: when it ends, likewise; NaN while it goes on.
        again: how often the condition was fulfilled anew meanwhile, after it was not.
    """

    number: int
    time: float
    what: str
    path: Path
    began: float
    ended: float = math.nan
    packets: int = 0
    again: int = 0


@dataclass(eq=False)
class _Block:
    name: str
    rows: Rows
    lengths: Ints
    arrivals: Array
    count: int = 0

    @property
    def size(self) -> int:
        return self.rows.nbytes + self.lengths.nbytes + self.arrivals.nbytes

    @property
    def last(self) -> float:
        return float(self.arrivals[self.count - 1])


class _Ring:
    def __init__(self, seconds: float, most_bytes: int) -> None:
        self.size = 0
        self.forgotten = 0  # packets that were not old enough, but too many
        self._seconds, self._most = seconds, most_bytes
        self._blocks: deque[_Block] = deque()
        self._open: dict[str, _Block] = {}

    def add(self, name: str, rows: Rows, lengths: Ints, arrivals: Array) -> None:
        while len(rows):
            block = self._open.get(name)
            is_full = block is not None and block.count == len(block.rows)
            if block is None or is_full or block.rows.shape[1] != rows.shape[1]:
                block = _Block(
                    name,
                    np.empty((_BLOCK, rows.shape[1]), np.uint8),
                    np.empty(_BLOCK, lengths.dtype),
                    np.empty(_BLOCK),
                )
                self._open[name] = block
                self._blocks.append(block)
                self.size += block.size
            count = min(len(block.rows) - block.count, len(rows))
            place = slice(block.count, block.count + count)
            block.rows[place], block.lengths[place] = rows[:count], lengths[:count]
            block.arrivals[place] = arrivals[:count]
            block.count += count
            newest = float(arrivals[count - 1])
            rows, lengths, arrivals = rows[count:], lengths[count:], arrivals[count:]
            self._forget(newest)

    def _forget(self, now: float) -> None:
        while len(self._blocks) > 1:
            oldest = self._blocks[0]
            is_old = oldest.last < now - self._seconds - _LATE
            if not is_old and self.size <= self._most:
                return
            if oldest is self._open.get(oldest.name):
                del self._open[oldest.name]
            self.forgotten += 0 if is_old else oldest.count
            self.size -= oldest.size
            self._blocks.popleft()

    def since(self, begin: float) -> list[tuple[float, str, bytes]]:
        found = []
        for block in self._blocks:
            for k in np.flatnonzero(block.arrivals[: block.count] >= begin).tolist():
                packet = block.rows[k, : block.lengths[k]].tobytes()
                found.append((float(block.arrivals[k]), block.name, packet))
        found.sort(key=lambda each: each[0])
        return found


@dataclass(frozen=True)
class TriggerStatistics:
    """What was seen so far.

    Attributes:
        not_seen: source to the packets that came faster than they could be looked at.
    """

    packets: int
    events: int
    seconds: float
    kept_bytes: int
    forgotten: int
    not_seen: Mapping[str, int]
    is_recording: bool


class TriggeredRecorder(PacketWorker):
    """Records what comes shortly before and after a condition is fulfilled, with bounded memory.

    Each event is a recording of its own; one that comes while another is recorded prolongs that.

    Args:
        path_of: the file of an event, by its number from 1 and its time.
        find: where packets fulfil the condition; called on the recorder's thread.
        before: s that are kept of before an event.
        after: s that are recorded after the condition was last fulfilled.
        overwrite: write over files that exist; else that ends it.
        signals_rate: of how many packets per second and source the decoded values are kept as well.
        kept_bytes: most memory of what is kept.
        clock_at: when, on both clocks, a recording that begins at an arrival begins; of live
            sources when None.
        now: the clock of arrivals; None where that does not go on by itself.

    Attributes:
        on_event: called when an event begins, and again when its recording is complete.
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
        kept_bytes: int = KEPT_BYTES,
        clock_at: Callable[[float], RecordingClock] | None = None,
        now: Clock | None = time.monotonic,
    ) -> None:
        self.events: list[RecordedEvent] = []
        self.on_event: Callable[[RecordedEvent], None] = lambda _: None
        self._path_of, self._find, self._about = path_of, find, dict(about)
        self._before, self._after, self._overwrite = before, after, overwrite
        self._signals_rate, self._clock_at, self._now = signals_rate, clock_at or live_clock, now
        self._ring = _Ring(before, kept_bytes)
        self._sources: dict[str, tuple[Decode, dict[str, Any]]] = {}  # with their declarations
        self._files: list[tuple[str, str, bytes]] = []
        self._writer: PacketWriter | None = None
        self._until = self._last = math.nan
        self._count = 0  # packets of the recording that goes on
        self._packets = 0
        self._last_seen = math.nan  # arrival of the last packet
        self._held: dict[str, bool] = {}  # whether the last packet of a source fulfilled it
        self._asked: list[str] = []  # events to be recorded regardless of the condition
        super().__init__("triggered recorder")

    def add_source(self, name: str, *, decode: Decode, **declaration: Any) -> None:
        with self._changed:
            self._sources[name] = decode, declaration
            self._lost[name] = 0

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Puts a file into every recording; see `RecordingWriter.attach`."""
        self._files.append((name, media_type, data))

    def record_now(self, what: str) -> None:
        """Records this moment as an event, whatever the condition; returns at once."""
        with self._changed:
            self._asked.append(what)
            self._changed.notify_all()

    @property
    def statistics(self) -> TriggerStatistics:
        with self._changed:
            return TriggerStatistics(
                self._packets,
                len(self.events),
                self.seconds,
                self._ring.size,
                self._ring.forgotten,
                dict(self._lost),
                self._writer is not None,
            )

    def _next(self) -> list[Batch] | None:
        with self._changed:
            if not (self._queue or self._asked or self._closing):
                self._changed.wait(_POLL if self._writer is not None else None)
            if not self._closing:
                self._changed.wait_for(lambda: self._closing, _GATHER)
            found = [*self._queue]
            self._queue.clear()
            if not (found or self._asked) and self._closing:
                return None
        return _joined(found)

    def _handle(self, batches: list[Batch]) -> None:
        for batch in batches:
            self._look(batch)
            self._packets += len(batch)
        with self._changed:
            asked, self._asked = self._asked, []
        for what in asked:
            self._end()
            self._begin(self._last_seen if self._now is None else self._now(), what)
        if self._writer is None:
            return
        self._writer.flush_if_old()
        if self._now is not None and self._now() > self._until + _LATE:
            self._end()

    def _finish(self, error: Exception | None) -> None:
        self._end()

    def _look(self, batch: Batch) -> None:
        holds, describe = self._find(batch.name, batch.rows, batch.lengths)
        hits = np.flatnonzero(holds)
        is_new = holds & ~np.append(self._held.get(batch.name, False), holds[:-1])
        self._held[batch.name] = bool(holds[-1])
        row = 0
        while row < len(batch.rows):
            rest = hits[hits >= row]
            if self._writer is None:
                if not len(rest):
                    self._keep(_part(batch, slice(row, None)))
                    return
                # Up to what fulfils it; that itself is the first packet of what follows.
                self._keep(_part(batch, slice(row, int(rest[0]))))
                row = int(rest[0])
                self._begin(float(batch.arrivals[row]), describe(row))
            # As far as the recording reaches, which every hit within it prolongs.
            end = row
            for hit in [*rest.tolist(), len(batch.rows)]:
                inside = batch.arrivals[row:hit] <= self._until
                end = row + int(inside.argmin()) if not inside.all() else hit
                if end < hit or hit == len(batch.rows) or batch.arrivals[hit] > self._until:
                    break
                self._prolong(float(batch.arrivals[hit]), is_new=bool(is_new[hit]))
            part = _part(batch, slice(row, end))
            self._keep(part)
            self._write(part)
            row = end
            if row < len(batch.rows):
                self._end()

    def _keep(self, batch: Batch) -> None:
        if len(batch.rows):
            self._last_seen = float(batch.arrivals[-1])
        self._ring.add(batch.name, batch.rows, batch.lengths, batch.arrivals)

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

    def _prolong(self, arrival: float, *, is_new: bool) -> None:
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
    """When an arrival, s on `time.monotonic`, was, on both clocks."""
    ago = round((time.monotonic() - arrival) * 1e9)
    return RecordingClock(time.time_ns() - ago, round(arrival * 1e9))
