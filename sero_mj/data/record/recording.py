"""`Recording`: reads files of `RecordingWriter`, even truncated or damaged ones."""

from __future__ import annotations

import math
import threading
import zlib
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from mcap.data_stream import ReadDataStream
from mcap.records import Attachment
from mcap.writer import MCAP0_MAGIC

from ...base.errors import Problem, RecordingError, UnknownName, UsageError, reason_of
from ...base.paths import open_file
from .joint_state_messages import ENCODING
from .mcap_reader import (
    BROKEN,
    ChunkPlace,
    FileIndex,
    mcap_reason,
    read_index,
    read_record,
    unpack_messages,
)
from .recording_format import (
    ABOUT,
    CLOCK,
    FORMAT,
    LOST,
    SOURCE_KEY,
    RecordingClock,
    SourceDeclaration,
    unpack_raw,
)

if TYPE_CHECKING:
    from ..receive.source import Source

_LATEST_NS = 2**64
_EXPECTED = "a file that sero-mj record wrote"


@dataclass(frozen=True)
class RecordedSource(SourceDeclaration):
    """A source in a recording.

    Attributes:
        first: when its first packet arrived, s since the recording began; NaN without packets.
    """

    count: int
    first: float
    last: float

    @property
    def is_unreadable(self) -> bool:
        """Whether it has packets, but none of them is readable."""
        return self.count > 0 and math.isnan(self.first)


class PacketFile(ABC):
    """A file with the packets of sources. Times are s since it begins.

    Attributes:
        duration: s from its beginning to its last packet.
        lost: source to the number of its lost packets.
        faults: its errors, a sentence each; some are found when they are read.
        malformed: why the last message that contradicts itself makes no packet; empty where packets
            were recorded.
        names_joints: whether its packets are made of messages that name joints, so that it can move
            a robot without routes.
    """

    path: Path
    about: dict[str, str]
    start: datetime
    duration: float
    sources: dict[str, RecordedSource]
    lost: dict[str, int]
    faults: list[str]
    malformed: str = ""

    names_joints: ClassVar[bool] = False
    _why_unreadable: ClassVar[str] = "its index is wrong"  # where no fault says it

    def choose_source(self, name: str = "", default: str = "", by: str = "") -> str:
        """Returns the name of one of its sources; raises UsageError.

        Args:
            name: which; empty for `default`, or the only one.
            default: used if there is a source of this name and no other is requested.
            by: how the user chooses one called NAME, by an option say; for the error.
        """
        names = list(self.sources)
        chosen = name or (default if default in names or len(names) != 1 else names[0])
        if chosen in names:
            return chosen
        if name:
            where = f"in {self.path}"
            raise UsageError(Problem("", "no source", found=name, of=where, available=names))
        if not names:
            raise UsageError(f"{self.path}: {self.why_no_source()}")
        how = f"choose with {by.replace('NAME', names[0])}, say" if by else "choose one"
        raise UsageError(f"{self.path} has several sources: {self.about_sources()}; {how}")

    def why_no_source(self) -> str:
        """Describes why it has no sources."""
        return "; ".join(["has no source", *self.faults])

    def about_sources(self) -> str:
        """Its sources in words, for a user who has to choose one."""
        return ", ".join(self.sources)

    @abstractmethod
    def packets(
        self, name: str, start: float = -math.inf, stop: float | None = None
    ) -> Iterator[tuple[float, bytes]]:
        """Iterates over a source's packets in file order; reads only the required chunks.

        Args:
            start: first time, s since the recording began.
            stop: end time, exclusive, likewise; None for the end.

        Returns:
            Arrival of each, s since the recording began, and its bytes.

        Raises:
            RecordingError: the file cannot be read.
            UnknownName: no such source was recorded.
        """

    @abstractmethod
    def last_before(self, name: str, t: float) -> tuple[float, bytes] | None:
        """Returns a source's newest packet at or before a time, or None; used by seeking.

        Args:
            t: s since the recording began.

        Returns:
            When it arrived, s since the recording began, and its bytes.

        Raises:
            RecordingError: the file cannot be read.
            UnknownName: no such source was recorded.
        """

    @property
    @abstractmethod
    def attachments(self) -> tuple[str, ...]:
        """Names of the files in the recording."""

    @abstractmethod
    def read_attachment(self, name: str) -> bytes:
        """Returns a file that is in the recording; raises RecordingError and UnknownName."""

    def check_readable(self, name: str) -> None:
        """Raises RecordingError if none of a source's packets is readable."""
        source = self.sources[name]
        if source.is_unreadable:
            why, *others = self.faults or [self._why_unreadable]
            more = f" (and {len(others)} more of the kind)" if others else ""
            reason = f"none of the {source.count} packets of '{name}' can be read: {why}{more}"
            raise RecordingError(self.path, reason)

    def message_source(self, fields: Mapping[str, Any]) -> Source | None:
        """Returns the receiver with these fields; None if the recording has packets."""
        return None

    def replay_table(self, name: str, source: Source | None) -> dict[str, Any]:
        """Returns the table of a source that plays one of its sources instead of a scene's own.

        Args:
            source: what the scene reads of messages; see `Source.of_messages`.
        """
        return {"kind": "replay", "file": str(self.path), "source": name}

    def lead(self, scene: Any, source: str | None = None) -> Any:
        """Returns a scene without sources with its only robot led by this recording.

        Other scenes are returned unchanged, and so are scenes for which no source is the obvious
        one, and scenes for recordings of packets.

        Args:
            scene: a `Scene`, whose module imports MuJoCo.
            source: of the recording, that leads the robot; found by joint names when None.
        """
        return scene

    def scenes(
        self, choose: str, source: str | None = None, wanted: Collection[str] = ()
    ) -> Iterator[str]:
        """Yields scenes of the robot that messages name; raises RecordingError or UsageError.

        Args:
            source: of the recording, that moves the robot; any when None.
            wanted: names of robots, one of which it is; any when empty.
        """
        return iter(())

    def described_scene(self) -> Path | None:
        """Writes a scene of the robot that the recording describes; None if it describes none."""
        return None

    def shipped_robots(self, source: str | None = None) -> list[str]:
        """Returns the shipped robots with the joints that it, or one of its sources, names."""
        return []

    @abstractmethod
    def close(self) -> None:
        """Closes the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class Recording(PacketFile):
    """A finished recording, or one still being written. For any number of threads.

    Damaged chunks, which are detected when they are read, are left out and reported in `faults`,
    like all other tolerable errors.

    Raises:
        RecordingError: it cannot be read, or is not a recording.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.faults: list[str] = []
        self._lock = threading.Lock()
        self._damaged: set[int] = set()
        self._cached: tuple[int, int, list[tuple[int, bytes]]] = (-1, -1, [])
        try:
            self._file = open_file(self.path)
        except (OSError, ValueError) as error:
            raise self._unreadable(error) from error
        try:
            self._read_all_but_messages()
        except RecordingError:
            self._file.close()
            raise
        except (OSError, *BROKEN) as error:
            self._file.close()
            raise self._unreadable(error) from error

    def _read_all_but_messages(self) -> None:
        begin = self._file.read(len(MCAP0_MAGIC))
        if begin != MCAP0_MAGIC:
            reason = f"is no MCAP file: found {begin!r} at its beginning" if begin else "is empty"
            raise RecordingError(self.path, Problem("", reason, expected=_EXPECTED))
        index = read_index(self._file)
        self._index = index
        self.faults += index.faults
        declarations = self._declarations(index)
        self._chunks = index.chunks
        # Chunks are almost sorted by time. These two are strictly sorted, so that they can be
        # searched: the latest message up to a chunk, and the earliest one from a chunk on.
        self._latest = list(accumulate((chunk.last for chunk in self._chunks), max))
        earliest = accumulate((chunk.first for chunk in reversed(self._chunks)), min)
        self._earliest = list(earliest)[::-1]
        self._clock = self._read_clock(index)
        self.start = datetime.fromtimestamp(self._clock.epoch_ns / 1e9, UTC)
        self.about = dict(index.metadata.get(ABOUT, {}))
        self.lost = {name: int(count) for name, count in index.metadata.get(LOST, {}).items()}
        for name, count in self.lost.items():
            self.faults.append(f"{count} packets of source '{name}' could not be kept")
        self._channels = {source.name: channel for channel, source in declarations.items()}
        counts = self._counts(index)
        self.sources: dict[str, RecordedSource] = {}
        for channel, source in declarations.items():
            first, last = self._ends(channel)
            self.sources[source.name] = RecordedSource(
                **vars(source), count=counts.get(channel, 0), first=first, last=last
            )
        ends = [each.last for each in self.sources.values() if not math.isnan(each.last)]
        self.duration = max(ends, default=0.0)

    def _declarations(self, index: FileIndex) -> dict[int, SourceDeclaration]:
        found = {}
        for number, channel in index.channels.items():
            text = channel.metadata.get(SOURCE_KEY)
            if text is not None:
                try:
                    found[number] = SourceDeclaration.from_json(text)
                except (KeyError, TypeError, AttributeError, ValueError) as error:
                    reason = f"channel {channel.topic}: its declaration: {reason_of(error)}"
                    raise RecordingError(self.path, reason) from error
        if found or (CLOCK in index.metadata and not index.channels):
            return found
        if not index.channels:
            why = "; ".join(index.faults) or "has no channels"
            raise RecordingError(self.path, Problem("", why, expected=_EXPECTED))
        topics = ", ".join(
            sorted(f"{each.topic} ({each.message_encoding})" for each in index.channels.values())[
                :10
            ]
        )
        reason = f"is an MCAP file of another program: found the topics {topics}"
        raise RecordingError(self.path, Problem("", reason, expected=_EXPECTED))

    def _read_clock(self, index: FileIndex) -> RecordingClock:
        metadata = index.metadata.get(CLOCK)
        if metadata is None:  # other tools may omit it when they rewrite a file
            self.faults.append("does not say when it began; times count from its first packet")
            return RecordingClock(min(self._earliest, default=0), 0)
        try:
            number = int(metadata["format"])
            clock = RecordingClock.from_metadata(metadata)
        except (KeyError, ValueError) as error:
            problem = Problem(f"metadata {CLOCK}", reason_of(error), expected=_EXPECTED)
            raise RecordingError(self.path, problem) from error
        if number > FORMAT:
            reason = f"is of format {number}; this version of sero-mj reads up to {FORMAT}"
            raise RecordingError(self.path, reason)
        return clock

    def _counts(self, index: FileIndex) -> dict[int, int]:
        counts = dict(index.counts)
        for chunk in index.uncounted:
            for channel in self._channels.values():
                found = len(self._messages(chunk, channel))
                counts[channel] = counts.get(channel, 0) + found
        return counts

    def _ends(self, channel: int) -> tuple[float, float]:
        first = next((found[0][0] for _, found in self._of(channel, self._chunks)), None)
        backwards = reversed(self._chunks)
        last = next((found[-1][0] for _, found in self._of(channel, backwards)), None)
        if first is None or last is None:
            return math.nan, math.nan
        return self._seconds(first), self._seconds(last)

    def packets(
        self, name: str, start: float = -math.inf, stop: float | None = None
    ) -> Iterator[tuple[float, bytes]]:
        channel = self._find(name)
        begin, end = self._log_time(start), self._log_time(math.inf if stop is None else stop)
        # After the last chunk entirely before the start, and before the first one entirely after
        # the end.
        chunks = (
            self._chunks[i]
            for i in range(bisect_right(self._latest, begin - 1), len(self._chunks))
            if self._chunks[i].last >= begin and self._chunks[i].first < end
        )
        for _, found in self._of(channel, chunks):
            for log_time, data in found:
                if begin <= log_time < end:
                    yield self._seconds(log_time), data

    def last_before(self, name: str, t: float) -> tuple[float, bytes] | None:
        channel, at = self._find(name), self._log_time(t)
        best: tuple[int, bytes] | None = None
        for i in range(bisect_right(self._earliest, at) - 1, -1, -1):
            if best is not None and self._latest[i] <= best[0]:
                break
            for _, found in self._of(channel, [self._chunks[i]]):
                newest = max((time for time, _ in found if time <= at), default=None)
                if newest is not None and (best is None or newest > best[0]):
                    best = [entry for entry in found if entry[0] == newest][-1]
        return None if best is None else (self._seconds(best[0]), best[1])

    @property
    def attachments(self) -> tuple[str, ...]:
        return tuple(self._index.attachments)

    def read_attachment(self, name: str) -> bytes:
        if name not in self._index.attachments:
            raise UnknownName("file in the recording", name, self._index.attachments)
        offset, length = self._index.attachments[name]
        try:
            with self._lock:
                record = read_record(self._file, offset, length)
            data = record.getvalue()
            if zlib.crc32(data[:-4]).to_bytes(4, "little") != data[-4:]:
                raise ValueError("its check sum differs")
            return bytes(Attachment.read(ReadDataStream(record)).data)
        except BROKEN as error:
            raise RecordingError(
                self.path, f"file '{name}' in it is damaged: {mcap_reason(error)}"
            ) from error
        except OSError as error:
            raise self._unreadable(error) from error

    def close(self) -> None:
        self._file.close()

    def _find(self, name: str) -> int:
        if name not in self._channels:
            raise UnknownName("source", name, self._channels)
        return self._channels[name]

    def _seconds(self, log_time: int) -> float:
        return (log_time - self._clock.epoch_ns) / 1e9

    def _log_time(self, seconds: float) -> int:
        if not math.isfinite(seconds):
            return 0 if seconds < 0.0 else _LATEST_NS
        return self._clock.epoch_ns + round(seconds * 1e9)

    def _of(
        self, channel: int, chunks: Iterator[ChunkPlace] | list[ChunkPlace]
    ) -> Iterator[tuple[ChunkPlace, list[tuple[int, bytes]]]]:
        for chunk in chunks:
            if chunk.channels is None or channel in chunk.channels:
                found = self._messages(chunk, channel)
                if found:
                    yield chunk, found

    def _messages(self, chunk: ChunkPlace, channel: int) -> list[tuple[int, bytes]]:
        with self._lock:
            if self._cached[:2] == (chunk.offset, channel):
                return self._cached[2]
            if chunk.offset in self._damaged:
                return []
            try:
                record = read_record(self._file, chunk.offset, chunk.length)
            except OSError as error:
                raise self._unreadable(error) from error
        try:
            found = unpack_messages(record.getvalue(), channel)
            if self._index.channels[channel].message_encoding == ENCODING:
                found = [(time, unpack_raw(message)) for time, message in found]
        except BROKEN as error:
            self._report_damaged(chunk, error)
            return []
        with self._lock:
            self._cached = (chunk.offset, channel, found)
        return found

    def _report_damaged(self, chunk: ChunkPlace, error: BaseException) -> None:
        with self._lock:
            if chunk.offset in self._damaged:
                return
            self._damaged.add(chunk.offset)
        first, last = self._seconds(chunk.first), self._seconds(chunk.last)
        self.faults.append(
            f"the chunk at byte {chunk.offset} is damaged ({mcap_reason(error)}): "
            f"what arrived from {first:.3f} s to {last:.3f} s is left out"
        )

    def _unreadable(self, error: Exception) -> RecordingError:
        reason = error.strerror if isinstance(error, OSError) else mcap_reason(error)
        return RecordingError(self.path, f"cannot be read: {reason}")
