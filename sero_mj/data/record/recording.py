"""Reads the files of `RecordingWriter`, including truncated and damaged files."""

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
_EXPECTED = "a file from sero-mj record"


@dataclass(frozen=True)
class RecordedSource(SourceDeclaration):
    """A source in a recording.

    Attributes:
        count: number of packets.
        first: arrival time of the first packet in seconds since the start of the recording; NaN if
            there are no packets.
        last: arrival time of the last packet, like `first`.
    """

    count: int
    first: float
    last: float

    @property
    def is_unreadable(self) -> bool:
        """Whether the source has packets, but none of them can be read."""
        return self.count > 0 and math.isnan(self.first)


class PacketFile(ABC):
    """Base class of files with packets of sources. Times are in seconds since the start.

    Attributes:
        duration: time of the last packet.
        lost: number of lost packets by source.
        faults: tolerated errors, one sentence each. Some are detected when packets are read.
        malformed: reason why the last malformed message could not be converted to a packet; empty
            for recordings of packets.
        names_joints: whether messages name joints, so that the recording can move a robot without
            routes.
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
    _why_unreadable: ClassVar[str] = "its index is wrong"  # used if there is no fault

    def choose_source(self, name: str = "", default: str = "", by: str = "") -> str:
        """Chooses a source and returns its name; raises UsageError.

        Args:
            name: requested name; empty for `default`, or for the only source.
            default: name to use if the recording has a source of this name.
            by: option that chooses a source, such as `--source NAME`, for the error message.
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
        how = f"choose one with {by.replace('NAME', names[0])}" if by else "choose one"
        raise UsageError(f"{self.path} has several sources: {self.about_sources()}; {how}")

    def why_no_source(self) -> str:
        """Returns the reason why the recording has no sources."""
        return "; ".join(["has no source", *self.faults])

    def about_sources(self) -> str:
        """Returns a list of the sources as text, for users who have to choose one."""
        return ", ".join(self.sources)

    @abstractmethod
    def packets(
        self, name: str, start: float = -math.inf, stop: float | None = None
    ) -> Iterator[tuple[float, bytes]]:
        """Yields the arrival time and bytes of a source's packets with start <= time < stop.

        The packets are in the order of the file. Raises RecordingError or UnknownName.
        """

    @abstractmethod
    def last_before(self, name: str, t: float) -> tuple[float, bytes] | None:
        """Returns the arrival time and bytes of a source's newest packet up to a time, or None.

        Raises RecordingError or UnknownName.
        """

    @property
    @abstractmethod
    def attachments(self) -> tuple[str, ...]:
        """Names of the attached files."""

    @abstractmethod
    def read_attachment(self, name: str) -> bytes:
        """Returns the contents of an attached file; raises RecordingError or UnknownName."""

    def check_readable(self, name: str) -> None:
        """Raises RecordingError if none of a source's packets can be read."""
        source = self.sources[name]
        if source.is_unreadable:
            why, *others = self.faults or [self._why_unreadable]
            more = f" (and {len(others)} more errors)" if others else ""
            reason = f"none of the {source.count} packets of '{name}' can be read: {why}{more}"
            raise RecordingError(self.path, reason)

    def message_source(self, fields: Mapping[str, Any]) -> Source | None:
        """Returns a source that converts recorded messages; None if packets are recorded."""
        return None

    def replay_table(self, name: str, source: Source | None) -> dict[str, Any]:
        """Returns the table of a `replay` source that replaces a source of a scene.

        Args:
            source: receiver of messages in the scene, see `Source.of_messages`.
        """
        return {"kind": "replay", "file": str(self.path), "source": name}

    def move_robot(self, scene: Any, source: str | None = None) -> Any:
        """Returns a copy of a `Scene` in which this recording moves the only robot.

        Other scenes are returned unchanged: scenes with sources or several robots, and scenes whose
        robot no source matches. A recording of packets returns every scene unchanged.

        Args:
            source: source of the recording that moves the robot; None to find it by joint names.
        """
        return scene

    def scenes(
        self, choose: str, source: str | None = None, wanted: Collection[str] = ()
    ) -> Iterator[str]:
        """Yields scenes whose robots have the joints in the messages; raises SeroError.

        Args:
            choose: option that chooses a scene, such as `--scene NAME`, for the error message.
            source: source of the recording; None for any source.
            wanted: names of the allowed robots; empty for any robot.
        """
        return iter(())

    def described_scene(self) -> Path | None:
        """Writes a scene from the robot description in the recording; None if there is none."""
        return None

    def shipped_robots(self, source: str | None = None) -> list[str]:
        """Returns the included robots with the joint names of the recording, or of one source."""
        return []

    @abstractmethod
    def close(self) -> None:
        """Closes the file."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class Recording(PacketFile):
    """A recording that is complete or is being written. Several threads can use it.

    Damaged chunks are skipped and reported in `faults`. Raises RecordingError if the file cannot be
    read or is not a recording.
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
            reason = f"is not an MCAP file: it begins with {begin!r}" if begin else "is empty"
            raise RecordingError(self.path, Problem("", reason, expected=_EXPECTED))
        index = read_index(self._file)
        self._index = index
        self.faults += index.faults
        declarations = self._declarations(index)
        self._chunks = index.chunks
        # Chunks may overlap in time. These two lists are sorted, so that they can be searched: time
        # of the latest message up to a chunk, and of the earliest message from a chunk on.
        self._latest = list(accumulate((chunk.last for chunk in self._chunks), max))
        earliest = accumulate((chunk.first for chunk in reversed(self._chunks)), min)
        self._earliest = list(earliest)[::-1]
        self._clock = self._read_clock(index)
        self.start = datetime.fromtimestamp(self._clock.epoch_ns / 1e9, UTC)
        self.about = dict(index.metadata.get(ABOUT, {}))
        self.lost = {name: int(count) for name, count in index.metadata.get(LOST, {}).items()}
        for name, count in self.lost.items():
            self.faults.append(f"{count} packets of source '{name}' were lost")
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
                    reason = f"invalid declaration of channel {channel.topic}: {reason_of(error)}"
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
        reason = f"is an MCAP file of another program with the topics {topics}"
        raise RecordingError(self.path, Problem("", reason, expected=_EXPECTED))

    def _read_clock(self, index: FileIndex) -> RecordingClock:
        metadata = index.metadata.get(CLOCK)
        if metadata is None:  # other tools may omit it when they rewrite a file
            self.faults.append("has no start time; times are relative to its first packet")
            return RecordingClock(min(self._earliest, default=0), 0)
        try:
            number = int(metadata["format"])
            clock = RecordingClock.from_metadata(metadata)
        except (KeyError, ValueError) as error:
            problem = Problem(f"metadata {CLOCK}", reason_of(error), expected=_EXPECTED)
            raise RecordingError(self.path, problem) from error
        if number > FORMAT:
            reason = f"has format {number}; this version of sero-mj reads formats up to {FORMAT}"
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
                raise ValueError("its checksum is wrong")
            return bytes(Attachment.read(ReadDataStream(record)).data)
        except BROKEN as error:
            raise RecordingError(
                self.path, f"the attached file '{name}' is damaged: {mcap_reason(error)}"
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
            f"packets from {first:.3f} s to {last:.3f} s are missing"
        )

    def _unreadable(self, error: Exception) -> RecordingError:
        reason = error.strerror if isinstance(error, OSError) else mcap_reason(error)
        return RecordingError(self.path, f"cannot be read: {reason}")
