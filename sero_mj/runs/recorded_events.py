"""All good packets of a recorded source at once, as numbers over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ..receive.intake import pad_packets
from ..receive.source import Packets, Source
from ..record.recording import Recording
from ..record.replay import Replay

Array = NDArray[np.float64]

_AT_ONCE = 8192  # packets


@dataclass(frozen=True, eq=False)
class Series:
    """Numbers over time.

    Attributes:
        times: (T,), s, rising.
        events: event to its numbers, (T, count), flat behind the first axis.
    """

    times: Array
    events: dict[str, Array]

    def held_at(self, event: str, times: Array) -> Array:
        """An event's newest numbers at other times, (T', count); NaN before the first."""
        at = np.searchsorted(self.times, times, side="right") - 1
        values = self.events[event][np.maximum(at, 0)].copy()
        values[at < 0] = np.nan
        return values


def read_events(recording: Recording, receiver: Source, name: str) -> Series:
    """Decodes a source's packets; malformed ones are left out, as they were when they came.

    Where packets carry the time at which they were sent, and it only rises, that is their time,
    moved so that the first has the time of its arrival; else it is the time of their arrival.

    Args:
        recording: where from.
        receiver: that knows how to decode it; NaN is allowed in what it was told.
        name: of the source.

    Raises:
        RecordingError: the file cannot be read.
        UnknownName: no such source was recorded.
    """
    parts = list(_decoded(recording, receiver, name))
    if not parts:
        events = {event: np.empty((0, *shape)) for event, shape in receiver.events.items()}
        return Series(np.empty(0), {key: _flat(values) for key, values in events.items()})
    events = {
        event: _flat(np.concatenate([part.values[event] for part in parts]))
        for event in receiver.events
    }
    times = np.concatenate([part.arrivals for part in parts])
    if receiver.time:
        sent = events[receiver.time][:, 0] * receiver.time_scale
        if np.isfinite(sent).all() and (np.diff(sent) > 0).all():
            times = sent - sent[0] + times[0]
    # Of packets that came at once the last is what was shown.
    later = np.minimum.accumulate(times[::-1])[::-1]
    keep = np.append(times[:-1] < later[1:], True)
    return Series(times[keep], {event: values[keep] for event, values in events.items()})


def receiver_of(recording: Recording, name: str) -> Source:
    """A receiver that decodes the packets of a recorded source."""
    receiver = Replay(file=recording.path, source=name).original
    receiver.debug_level = 0
    return receiver


def _decoded(recording: Recording, receiver: Source, name: str) -> Iterator[Packets]:
    intake, number = receiver.intake, 0
    packets = recording.packets(name)
    while batch := list(islice(packets, _AT_ONCE)):
        times, packed = zip(*batch, strict=True)
        rows, arrivals = intake.take(*pad_packets(packed, receiver.size), np.array(times))
        intake.count()
        number += len(rows)
        if len(rows):
            yield Packets(intake.decode(rows), arrivals, number)


def _flat(values: Array) -> Array:
    return values.reshape(len(values), int(np.prod(values.shape[1:])))
