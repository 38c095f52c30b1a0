"""`Replay`: a recording as a source, which reproduces the received packets bit for bit."""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, field_validator

from ...base.errors import (
    DeclarationError,
    PluginError,
    Problem,
    RecordingError,
    SourceError,
    did_you_mean,
)
from ...base.frames import Array
from ...base.plugins import SOURCES, load_plugin, plugins
from ..receive.intake import Intake
from ..receive.mailbox import Packets
from ..receive.source import LedJoint, LedLinks, Source, log
from ..receive.structure import Structure
from .formats import look_into, open_recording
from .recording import PacketFile, RecordedSource
from .table import is_table

_BATCH = 4096  # packets
_OF_FILES = ("replay", "table")  # kinds that play a file, which a recording may not name


def _as_path(file: Any) -> Path:
    if isinstance(file, str | Path) and str(file):
        return Path(file)
    raise Problem(found=file, expected="the name of a recording, REC.mcap say").error()


class Replay(Source):
    """Plays one source of a recording, through the decoder of that source.

    It has no thread: packets are delivered when the clock that drives it reaches their time. A
    mirror drives it by its own time, so that a film of a recording does not depend on the rendering
    time.

    Attributes:
        file: the recording, made by `sero-mj record`.
        source: name of the recorded source; when empty, the one of this name, or the only one.
        speed: 1 is the original speed, 2 twice as fast.
        loop: whether to restart at the end; else it stays there, and its data become stale.
        topics: what to read of a recording of ROS, as of a source of kind `ros2`: `joint_states`,
            `joints`, `commands`, `wrench`, `frames` and so on.
        start: first time, s since the recording began; that of the first packet of any of its
            sources when None.
        stop: end time, likewise; the recording's end when None.
    """

    name: str = "replay"
    file: Annotated[Path, BeforeValidator(_as_path)]
    topics: dict[str, Any] = {}
    source: str = ""
    speed: float = Field(1.0, gt=0, le=1e6)
    loop: bool = False
    start: float | None = None
    stop: float | None = None
    structure: str = ""

    _structure_is: ClassVar[str] = "what the recording says"

    _recording: PacketFile | None = PrivateAttr(None)
    _of_messages: Source | None = PrivateAttr(None)
    _coming: Iterator[tuple[float, bytes]] = PrivateAttr(default_factory=lambda: iter(()))
    _held: tuple[float, bytes] | None = PrivateAttr(None)
    _position: float = PrivateAttr(0.0)
    _beyond: float = PrivateAttr(0.0)  # s since it ended
    _anchor: tuple[float, float] = PrivateAttr((0.0, 0.0))  # the clock's time, and the position
    _paused: bool = PrivateAttr(False)
    _faults_told: int = PrivateAttr(0)  # of the recording
    _lock: Any = PrivateAttr(default_factory=threading.RLock)

    @field_validator("file")
    @classmethod
    def _file_is_a_recording(cls, file: Path) -> Path:
        if is_table(file):
            raise ValueError(f'{file} is a table; expected a recording, or kind = "table"')
        try:
            look_into(file)
        except RecordingError as error:
            raise ValueError(str(error)) from None
        return file

    @field_validator("topics")
    @classmethod
    def _are_of_messages(cls, topics: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        if topics and "file" in info.data:
            wanted = _message_source(info.data["file"], topics)
            if wanted is None:
                raise ValueError("are for recordings of messages; leave them out")
            if not look_into(info.data["file"], {"": wanted}).sources:
                raise ValueError(f"{info.data['file']} has none of these")
        return topics

    @field_validator("source")
    @classmethod
    def _was_recorded(cls, source: str, info: ValidationInfo) -> str:
        if "file" not in info.data or "topics" not in info.data:
            return source
        topics, name = info.data["topics"], str(info.data.get("name"))
        receiver = _message_source(info.data["file"], topics) if topics else None
        wanted = None if receiver is None else {source or name: receiver}
        recording = look_into(info.data["file"], wanted)
        chosen = recording.choose_source(source, name, 'source = "NAME"')
        try:
            receiver_of(recording.path, recording.sources[chosen], chosen)
        except RecordingError as error:
            raise ValueError(str(error)) from None
        return chosen

    @field_validator("start")
    @classmethod
    def _begins_in_the_recording(cls, start: float | None, info: ValidationInfo) -> float | None:
        if start is not None and "file" in info.data:
            check_start(start, look_into(info.data["file"]))
        return start

    @field_validator("stop")
    @classmethod
    def _ends_after_it_begins(cls, stop: float | None, info: ValidationInfo) -> float | None:
        if stop is None or "file" not in info.data or "start" not in info.data:
            return stop
        if info.data["start"] is not None:
            begin, word = info.data["start"], "start"
        else:
            begin, word = _first_of(look_into(info.data["file"])), "where its first packet came"
        if not begin < stop < np.inf:
            raise Problem(found=stop, expected=f"more than {begin:g}, {word}, in s").error()
        return stop

    def led_to(self, joints: Sequence[LedJoint]) -> None:
        """Takes the joints that routes lead to, for recordings whose messages name them."""
        if joints and (source := self._messages_of_source(is_led=True)) is not None:
            self._of_messages = source
            source.led_to(joints)
            self._forget_original()

    def led_to_links(self, links: LedLinks) -> None:
        """Takes the links of the robot that routes lead to, for transforms in messages."""
        source = self._of_messages or self._messages_of_source(is_led=False)
        if source is not None:
            self._of_messages = source
            source.led_to_links(links)
            self._forget_original()

    def _messages_of_source(self, *, is_led: bool) -> Source | None:
        recording = look_into(self.file, self._wanted)
        declared = {**recording.sources[self.source].declared}
        if is_led and "joints" not in self.topics:
            declared.pop("joints", None)
        return recording.message_source({**declared, **self.topics})

    def _forget_original(self) -> None:
        for key in ("recorded", "original", "layout"):
            self.__dict__.pop(key, None)

    @property
    def of_messages(self) -> Source | None:
        """What it reads of messages, once its joints are known; None for packets."""
        return self._of_messages

    @property
    def _wanted(self) -> Mapping[str, Source] | None:
        if self._of_messages is None and self.topics:
            self._of_messages = _message_source(self.file, self.topics)
        return None if self._of_messages is None else {self.source: self._of_messages}

    @cached_property
    def recorded(self) -> RecordedSource:
        """The source as it was recorded."""
        return look_into(self.file, self._wanted).sources[self.source]

    @cached_property
    def original(self) -> Source:
        """The receiver as it was recorded; never opened, it only decodes."""
        receiver = receiver_of(self.file, self.recorded, self.name)
        receiver.only_latest_packet = self.only_latest_packet
        return receiver

    @cached_property
    def layout(self) -> Structure:
        """The decoder."""
        return self.original.layout

    @property
    def events(self) -> Mapping[str, tuple[int, ...]]:
        """Event name to its shape, as when it was recorded."""
        return self.original.events

    @property
    def about(self) -> str:
        """Kind and address, as shown to the user."""
        if self.recorded.is_unreadable:
            return f"replay of {self.file}, none of whose {self.recorded.count} packets can be used"
        return f"replay of {self.file}, {self.duration:.1f} s"

    @property
    def duration(self) -> float:
        """How long it plays at speed 1, s."""
        return max(self._end - self._begin, 0.0)

    @cached_property
    def _begin(self) -> float:
        if self.start is not None:
            return self.start
        return _first_of(look_into(self.file, self._wanted))

    @property
    def _end(self) -> float:
        last = self.recorded.last
        end = self.stop if self.stop is not None else (0.0 if np.isnan(last) else last)
        return max(end, self._begin)

    @property
    def trouble(self) -> str:
        """That it has ended, as shown to the user; empty while it plays."""
        return super().trouble or ("the recording has ended" if self._beyond > 0.0 else "")

    @property
    def position(self) -> float:
        """Current position, s since the recording began."""
        return self._position

    @property
    def is_live(self) -> bool:
        """False: packets follow `advance_to`."""
        return False

    @property
    def end(self) -> float | None:
        """Its duration, s; None for a loop."""
        return None if self.loop else self.duration / self.speed

    def now(self) -> float:
        """The time on the recording's clock, which continues after the end without packets."""
        return self._position + self._beyond

    def allow_nan(self, events: Collection[str]) -> None:
        """Lets NaN and infinity mean `no data` in these events; see `Source.allow_nan`."""
        super().allow_nan(events)
        self.original.allow_nan(events)  # whose decoder this is

    def limit(self, limits: Mapping[str, Array]) -> None:
        """Sets the largest magnitudes of numbers; see `Source.limit`."""
        super().limit(limits)
        self.original.limit(limits)  # whose decoder this is

    def _new_intake(self) -> Intake:
        return self.original._new_intake()

    def open(self) -> None:
        """Opens the file and goes to the start.

        Raises:
            SourceError: it cannot be read any more.
        """
        self.close()
        try:
            self._recording = self.open_recording()
            self._recording.check_readable(self.source)
        except RecordingError as error:
            self.close()
            raise SourceError(self.name, str(error)) from error
        self.reset()
        self._paused = False
        self._faults_told = 0
        self._anchor = (0.0, self._begin)
        self._go_to(self._begin)

    def open_recording(self) -> PacketFile:
        """Opens the file as this source reads it; raises RecordingError."""
        return open_recording(self.file, self._wanted, self.tell_once)

    def close(self) -> None:
        """Closes the file; harmless when it is not open."""
        if self._recording is not None:
            self._recording.close()
        self._recording, self._held = None, None
        self._coming = iter(())

    def wait(self, timeout: float) -> bool:
        """Whether there are packets at all; returns immediately."""
        return self.recorded.count > 0

    def advance_to(self, time: float) -> None:
        """Plays the packets up to a time.

        Args:
            time: of the driving clock, s; 0 is the start.
        """
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
            if position < self._position:  # the clock was set back, by a new film for example
                self._go_to(position)
            self._play_until(position)
            self._beyond = beyond

    def seek(self, position: float, clock: float = 0.0) -> None:
        """Seeks a position.

        Args:
            position: s since the recording began.
            clock: current time of the driving clock, s.
        """
        with self._lock:
            position = min(max(position, self._begin), self._end)
            self._anchor = (clock, position)
            self._go_to(position)

    def pause(self, clock: float = 0.0) -> None:
        """Pauses; `clock` is the driver's time now."""
        self.advance_to(clock)
        self._paused = True

    def resume(self, clock: float = 0.0) -> None:
        """Resumes at its position; `clock` is the driver's time now."""
        self._paused = False
        self._anchor = (clock, self._position)

    def take(self) -> Packets | None:
        """Returns the good packets since the last call, or None when there is none."""
        with self._lock:
            return super().take()

    def _go_to(self, position: float) -> None:
        """Seeks: discards played packets, and plays the last packet before that time."""
        assert self._recording is not None
        self._intake = self._new_intake()
        self._position, self._beyond = position, 0.0
        name = self.recorded.name
        before = self._recording.last_before(name, position)
        # Times are stored in ns: the next one is the first that is not the same packet.
        after = position if before is None else before[0] + 1e-9
        self._coming = self._recording.packets(name, after)
        self._held = None
        self._mail.forget_last()
        if before is not None:
            self._hand_in([before])
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
                self._hand_in(batch)
                batch = []
        if batch:
            self._hand_in(batch)
        self._log_faults()

    def _log_faults(self) -> None:
        """Logs errors of the recording when they are found."""
        assert self._recording is not None
        faults = self._recording.faults
        for fault in faults[self._faults_told :] if self.debug_level else []:
            log.warning("%s: %s", self.file, fault)
        self._faults_told = len(faults)

    def _hand_in(self, batch: list[tuple[float, bytes]]) -> None:
        arrivals, packets = zip(*batch, strict=True)
        if self._recording is not None and self._recording.malformed:
            self.layout.fault = self._recording.malformed
        self.accept(packets, arrivals)


def _message_source(file: Path, topics: Mapping[str, Any]) -> Source | None:
    return look_into(file).message_source(topics)


def receiver_of(file: Path, recorded: RecordedSource, name: str) -> Source:
    """The receiver that a recording declares; never opened, it only decodes.

    Args:
        file: the recording.
        recorded: its source.
        name: of the receiver.

    Raises:
        RecordingError: its kind is unknown, its fields are invalid, or they result in other events.
    """
    kind, of = recorded.kind, f"source '{recorded.name}'"
    kinds = [known for known in plugins(SOURCES) if known not in _OF_FILES]
    if kind not in kinds:
        raise RecordingError(file, f"{of}: no kind '{kind}'{did_you_mean(kind, kinds)}")
    try:
        receiver: Source = load_plugin(SOURCES, kind)(**{**recorded.declared, "name": name})
    except PluginError as error:
        raise RecordingError(file, str(error)) from error
    except DeclarationError as error:
        wrong = "; ".join(f"{problem.key}: {problem.message}" for problem in error.problems)
        raise RecordingError(file, f"how {of} is decoded: {wrong}") from error
    for event, shape in recorded.events.items():
        if receiver.events.get(event) != shape:
            expected = receiver.events.get(event, "no such event")
            reason = f"events of {of}: found {event} of shape {shape}; expected {expected}"
            raise RecordingError(file, reason)
    return receiver


def _first_of(recording: PacketFile) -> float:
    """Arrival of the first packet of any source, s since the recording began."""
    firsts = [each.first for each in recording.sources.values()]
    return min((first for first in firsts if not np.isnan(first)), default=0.0)


def check_start(start: float, recording: PacketFile) -> None:
    """Raises ValueError for a time, s, at which a recording is over."""
    if not start <= recording.duration:
        raise ValueError(f"found {start:g}; the recording ends at {recording.duration:.2f} s")
