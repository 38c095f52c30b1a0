"""Plays recordings as packets with their send times."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ...base.errors import RecordingError, UsageError
from ...base.frames import Array
from ..receive.structure import Structure
from ..record.formats import open_recording
from ..record.replay import Replay


@dataclass
class Playback(ABC):
    """A sequence of packets to send.

    Attributes:
        about: text about the packets, for messages.
        count: maximum number of packets.
        duration: time from the first to the last packet, s.
        skipped: number of packets so far that were malformed, or had numbers out of the range of
            their type in the structure.
        notes: warnings for the user.
    """

    structure: Structure
    about: str
    count: int
    duration: float
    skipped: int = field(default=0, init=False)
    notes: list[str] = field(default_factory=list, init=False)

    @abstractmethod
    def packets(self) -> Iterator[tuple[float, bytes]]:
        """Yields the time from the first packet to each packet (s), and the bytes of the packet."""

    def _encode(self, values: Mapping[str, ArrayLike]) -> bytes | None:
        try:
            return self.structure.encode({**_identities(self.structure), **values})
        except ValueError:  # a number is out of the range of its type
            self.skipped += 1
            return None

    def _note_absent(self, events: Collection[str]) -> None:
        blank = self.structure.decode(self.structure.encode({}))  # constants are not zero
        absent = [
            event
            for event in blank
            if event not in events
            and not blank[event].any()
            and not self.structure.field(event).checksum
        ]
        frames = [event for event in absent if event in self.structure.matrices]
        numbers = [event for event in absent if event not in frames]
        missing = [f"{', '.join(numbers)} (sent as zeros)"] * bool(numbers)
        missing += [f"{', '.join(frames)} (sent as identity)"] * bool(frames)
        if missing:
            self.notes.append(f"missing events: {', '.join(missing)}")


class RecordedPackets(Playback):
    """The packets of one source of a recording, unchanged or converted to another structure.

    Raises RecordingError, or UsageError if the source or all events of the structure are missing.

    Args:
        source: name of the recorded source; may be empty if there is only one source.
        structure: structure of the sent packets; None for the recorded packets. Events that are not
            in the recording are zero, or identity matrices.
        only_whole: skip recorded packets of a wrong size.
    """

    def __init__(
        self,
        file: Path,
        source: str = "",
        structure: Structure | None = None,
        *,
        only_whole: bool = False,
    ) -> None:
        self.file, self._only_whole = file, only_whole
        with open_recording(file) as recording:
            name = recording.choose_source(source, by="--recorded NAME")
            recording.check_readable(name)
        self._replay = Replay(file=file, source=name)
        recorded = self._replay.recorded
        if not recorded.count:
            raise RecordingError(file, f"has no packets of '{name}'")
        layout = structure or self._replay.layout
        self.is_raw = _is_same(layout, self._replay.layout)
        events = self._replay.events
        self._events = [] if self.is_raw else _common(layout, events, f"'{name}' in {file}")
        how = "bit for bit" if self.is_raw else f"events {', '.join(self._events)}"
        about = f"{file}, source {name}, {how}"
        super().__init__(layout, about, recorded.count, recorded.last - recorded.first)
        self._note(recording.faults)
        if not self.is_raw:
            self._note_absent(self._events)

    def packets(self) -> Iterator[tuple[float, bytes]]:
        recorded = self._replay.recorded
        with open_recording(self.file) as recording:
            for arrival, packet in recording.packets(recorded.name):
                sent = packet if self.is_raw else self._again(packet)
                if self._only_whole and self.is_raw and len(packet) != self.structure.size:
                    self.skipped += 1
                elif sent is not None:
                    yield arrival - recorded.first, sent
            self._note(recording.faults)

    def _note(self, faults: list[str]) -> None:
        found = [f"{self.file}: {fault}" for fault in faults]
        self.notes += [note for note in found if note not in self.notes]

    def _again(self, packet: bytes) -> bytes | None:
        values = self._replay.decode(packet)
        if values is None:
            self.skipped += 1
            return None
        return self._encode({event: values[event] for event in self._events})


def timed(
    playback: Playback, *, speed: float = 1.0, loop: bool = False, duration: float | None = None
) -> Iterator[tuple[float, bytes]]:
    """Yields send times (s) and packets at another speed, in a loop, or for a limited time.

    Each repetition begins one average interval after the end of the previous one.

    Args:
        speed: playback speed relative to the original speed.
        duration: time limit in s; None for no limit.
    """
    pause = playback.duration / max(playback.count - 1, 1) or 1e-3
    end = math.inf if duration is None else duration
    begin = 0.0
    while True:
        sent = 0
        for time, packet in playback.packets():
            due = (begin + time) / speed
            if due >= end:
                return
            yield due, packet
            sent += 1
        if not loop or not sent:
            return
        begin += playback.duration + pause


def _identities(structure: Structure) -> dict[str, Array]:
    shapes = {event: structure.events[event] for event in structure.matrices}
    return {event: np.broadcast_to(np.eye(4), shape) for event, shape in shapes.items()}


def _is_same(one: Structure, other: Structure) -> bool:
    return type(one) is type(other) and all(
        getattr(one, key) == getattr(other, key)
        for key in ("fields", "column_major", "alignment", "scale")
    )


def _common(to: Structure, events: Mapping[str, tuple[int, ...]], of: str) -> list[str]:
    common = [event for event in to.events if event in events]
    if not common:
        has, wanted = ", ".join(events), ", ".join(to.events)
        raise UsageError(f"{of} has the events {has}, but '{to.text}' has {wanted}")
    for event in common:
        if to.events[event] != events[event]:
            found, expected = (" x ".join(map(str, each[event])) for each in (events, to.events))
            raise UsageError(f"{event} of {of} is {found}; '{to.text}' expects {expected}")
    return common
