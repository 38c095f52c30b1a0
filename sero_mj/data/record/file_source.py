"""Base class of sources that play a file."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr

from ...base.errors import RecordingError, SourceError, mismatch
from ...base.frames import Array
from ..receive.intake import Intake
from ..receive.mailbox import Packets
from ..receive.reception import log
from ..receive.source import Source
from ..receive.structure import Structure
from .recording import PacketFile, RecordedSource

_BATCH = 4096  # packets


def _as_path(file: Any) -> Path:
    if isinstance(file, str | Path) and str(file):
        return Path(file)
    raise mismatch(file, "the name of a recording, such as REC.mcap")


class FileSource(Source):
    """Base class of sources that play the packets of a file, decoded by their original source.

    It has no thread: `advance_to` delivers the packets up to the time of a driving clock, so that
    videos of a recording do not depend on the rendering time.

    Attributes:
        file: file name of the recording.
        speed: playback speed; 2 is twice as fast.
        loop: whether playback restarts at the end. Otherwise, the data become stale.
        start: time at which playback begins, in seconds since the start of the recording; None for
            the first packet of any source.
        stop: time at which playback ends, in seconds since the start of the recording; None for
            its end.
    """

    file: Annotated[Path, BeforeValidator(_as_path)]
    speed: float = Field(1.0, gt=0, le=1e6)
    loop: bool = False
    start: float | None = None
    stop: float | None = None
    structure: str = ""

    _recording: PacketFile | None = PrivateAttr(None)
    _coming: Iterator[tuple[float, bytes]] = PrivateAttr(default_factory=lambda: iter(()))
    _held: tuple[float, bytes] | None = PrivateAttr(None)
    _position: float = PrivateAttr(0.0)
    _beyond: float = PrivateAttr(0.0)  # time since the end in s
    _anchor: tuple[float, float] = PrivateAttr((0.0, 0.0))  # time of the driving clock and position
    _paused: bool = PrivateAttr(False)
    _logged_faults: int = PrivateAttr(0)
    _lock: Any = PrivateAttr(default_factory=threading.RLock)

    @property
    @abstractmethod
    def recorded(self) -> RecordedSource:
        """Declaration and times of the recorded source."""

    @property
    @abstractmethod
    def original(self) -> Source:
        """Receiver that decodes the packets. It is never opened."""

    @abstractmethod
    def open_recording(self) -> PacketFile:
        """Opens the recording for playback; raises RecordingError."""

    @property
    @abstractmethod
    def _begin(self) -> float:
        """Time at which playback begins, in seconds since the start of the recording."""

    @cached_property
    def layout(self) -> Structure:
        return self.original.layout

    @property
    def events(self) -> Mapping[str, tuple[int, ...]]:
        return self.original.events

    @property
    def about(self) -> str:
        if self.recorded.is_unreadable:
            return f"replay of {self.file}, {self.recorded.count} unusable packets"
        return f"replay of {self.file}, {self.duration:.1f} s"

    @property
    def duration(self) -> float:
        """Playback time in seconds at speed 1."""
        return max(self._end - self._begin, 0.0)

    @property
    def _end(self) -> float:
        last = self.recorded.last
        end = self.stop if self.stop is not None else (0.0 if np.isnan(last) else last)
        return max(end, self._begin)

    @property
    def trouble(self) -> str:
        return super().trouble or ("the recording has ended" if self._beyond > 0.0 else "")

    @property
    def position(self) -> float:
        """Current position in seconds since the start of the recording."""
        return self._position

    @property
    def is_live(self) -> bool:
        return False

    @property
    def end(self) -> float | None:
        return None if self.loop else self.duration / self.speed

    def now(self) -> float:
        return self._position + self._beyond

    def allow_nan(self, events: Collection[str]) -> None:
        super().allow_nan(events)
        self.original.allow_nan(events)  # it decodes the packets

    def limit(self, limits: Mapping[str, Array]) -> None:
        super().limit(limits)
        self.original.limit(limits)

    def _new_intake(self) -> Intake:
        return self.original._new_intake()

    def open(self) -> None:
        self.close()
        try:
            self._recording = self.open_recording()
            self._recording.check_readable(self.recorded.name)
        except RecordingError as error:
            self.close()
            raise SourceError(self.name, str(error)) from error
        self.reset()
        self._paused = False
        self._logged_faults = 0
        self._anchor = (0.0, self._begin)
        self._go_to(self._begin)

    def close(self) -> None:
        if self._recording is not None:
            self._recording.close()
        self._recording, self._held = None, None
        self._coming = iter(())

    def wait(self, timeout: float) -> bool:
        return self.recorded.count > 0

    def advance_to(self, time: float) -> None:
        """Plays the packets up to a time in seconds of the driving clock, which begins at 0."""
        clock = time
        with self._lock:
            if self._recording is None or self._paused:
                return
            position = self._anchor[1] + (clock - self._anchor[0]) * self.speed
            if self.loop and position > self._end and self.duration > 0:
                rounds = (position - self._begin) // self.duration
                position -= rounds * self.duration
                self._anchor = (clock, position)
                self._go_to(self._begin)
            beyond = max(position - self._end, 0.0)
            position = min(position, self._end)
            if position < self._position:  # the clock was set back, for example by a new video
                self._go_to(position)
            self._play_until(position)
            self._beyond = beyond

    def seek(self, position: float, clock: float = 0.0) -> None:
        """Continues playback at another position.

        Args:
            position: time in seconds since the start of the recording.
            clock: current time of the driving clock in seconds.
        """
        with self._lock:
            position = min(max(position, self._begin), self._end)
            self._anchor = (clock, position)
            self._go_to(position)

    def pause(self, clock: float = 0.0) -> None:
        """Pauses playback. `clock` is the current time of the driving clock in seconds."""
        self.advance_to(clock)
        self._paused = True

    def resume(self, clock: float = 0.0) -> None:
        """Resumes playback. `clock` is the current time of the driving clock in seconds."""
        self._paused = False
        self._anchor = (clock, self._position)

    def take(self) -> Packets | None:
        with self._lock:
            return super().take()

    def _go_to(self, position: float) -> None:
        assert self._recording is not None
        self._intake = self._new_intake()
        self._position, self._beyond = position, 0.0
        name = self.recorded.name
        before = self._recording.last_before(name, position)
        # Times are stored in ns.
        after = position if before is None else before[0] + 1e-9
        self._coming = self._recording.packets(name, after)
        self._held = None
        self._mail.forget_last()
        if before is not None:
            self._accept_batch([before])
        self._log_faults()

    def _play_until(self, position: float) -> None:
        self._position = position
        batch: list[tuple[float, bytes]] = []
        while True:
            packet = self._held or next(self._coming, None)
            self._held = None
            if packet is None or packet[0] > position:
                self._held = packet
                break
            batch.append(packet)
            if len(batch) == _BATCH:
                self._accept_batch(batch)
                batch = []
        if batch:
            self._accept_batch(batch)
        self._log_faults()

    def _log_faults(self) -> None:
        assert self._recording is not None
        faults = self._recording.faults
        for fault in faults[self._logged_faults :] if self.debug_level else []:
            log.warning("%s: %s", self.file, fault)
        self._logged_faults = len(faults)

    def _accept_batch(self, batch: list[tuple[float, bytes]]) -> None:
        arrivals, packets = zip(*batch, strict=True)
        if self._recording is not None and self._recording.malformed:
            self.layout.fault = self._recording.malformed
        self.accept(packets, arrivals)
