"""Lets rosbags read bags that were not closed.

`RepairedMcap` presents an MCAP file without its end as a complete file. It appends an index of the
complete chunks after the last complete record. `with_log` merges the log next to an SQLite database
into a copy of the database.
"""

from __future__ import annotations

import io
import os
import shutil
import sqlite3
from contextlib import closing
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, Footer, Statistics
from mcap.writer import MCAP0_MAGIC

from ...base.paths import make_temporary_folder, open_file
from ...data.record.mcap_reader import (
    BROKEN,
    RECORD_HEAD,
    fault_of_end,
    mcap_reason,
    read_record,
    records_in,
    unpack_chunk,
    walk_records,
)

_CACHED = 8  # files whose repairs are cached, because each is opened several times
_LOGS = ("-wal", "-journal")  # appended to the name of the database
_NUMBER = 2  # bytes of the number at the start of schemas, channels and messages
_INDEX_HEAD, _INDEX_ENTRY = 15, 16  # bytes of the index of a channel's messages in a chunk


class RepairedMcap:
    """A repaired MCAP file with the interface of a path (`RPath` of rosbags); raises OSError."""

    def __init__(self, path: Path) -> None:
        self._path, self.suffix, self.stem = path, ".mcap", path.stem
        status = path.stat()
        found = _complete_part(path, status.st_size, status.st_mtime_ns)
        self._end, self._appended = found.end, found.appended
        self.faults, self.has_topics = list(found.faults), bool(found.channels)

    def __str__(self) -> str:
        return str(self._path)

    def exists(self) -> bool:
        return self._path.exists()

    def is_dir(self) -> bool:
        return False

    def open(self, *_: Any, **__: Any) -> BinaryIO:
        return io.BufferedReader(_Joined(open_file(self._path), self._end, self._appended))


class _Joined(io.RawIOBase):
    def __init__(self, file: BinaryIO, end: int, appended: bytes) -> None:
        super().__init__()
        self._file, self._end, self._appended, self._at = file, end, appended, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        begins = {
            os.SEEK_SET: 0,
            os.SEEK_CUR: self._at,
            os.SEEK_END: self._end + len(self._appended),
        }
        self._at = max(begins[whence] + offset, 0)
        return self._at

    def readinto(self, buffer: Any) -> int:
        if self._at < self._end:
            self._file.seek(self._at)
            found = self._file.read(min(len(buffer), self._end - self._at))
        else:
            begin = self._at - self._end
            found = self._appended[begin : begin + len(buffer)]
        buffer[: len(found)] = found
        self._at += len(found)
        return len(found)

    def close(self) -> None:
        self._file.close()
        super().close()


@dataclass
class _CompletePart:
    end: int = len(MCAP0_MAGIC)
    appended: bytes = b""
    faults: list[str] = field(default_factory=list)
    schemas: dict[bytes, bytes] = field(default_factory=dict)  # records by number
    channels: dict[bytes, bytes] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)  # numbers of messages by channel

    def note(self, opcode: int, record: bytes) -> None:
        kept = {Opcode.SCHEMA: self.schemas, Opcode.CHANNEL: self.channels}.get(Opcode(opcode))
        if kept is not None:
            kept.setdefault(record[RECORD_HEAD.size : RECORD_HEAD.size + _NUMBER], record)

    def add_chunk(self, file: BinaryIO, offset: int, length: int) -> None:
        try:
            self._index_chunk(read_record(file, offset, length).getvalue(), offset, length)
        except BROKEN as error:
            why = f"is damaged ({mcap_reason(error)}) and skipped"
            self.faults.append(f"the chunk at byte {offset} {why}")

    def _index_chunk(self, record: bytes, offset: int, length: int) -> None:
        chunk, data = unpack_chunk(record)
        counts: dict[int, int] = {}
        for opcode, begin, end in records_in(data):
            if opcode == Opcode.MESSAGE:
                number = begin + RECORD_HEAD.size
                channel = int.from_bytes(data[number : number + _NUMBER], "little")
                counts[channel] = counts.get(channel, 0) + 1
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.note(opcode, data[begin:end])
        # rosbags derives message counts from the positions of the message indices.
        places, at = {}, offset + length
        for channel, count in counts.items():
            self.counts[channel] = self.counts.get(channel, 0) + count
            places[channel] = at
            at += _INDEX_HEAD + _INDEX_ENTRY * count
        self.chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=at - offset - length,
                message_index_offsets=places,
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def make_end(self) -> bytes:
        built = RecordBuilder()
        for record in (*self.schemas.values(), *self.channels.values()) if self.chunks else ():
            built.write(record)
        for chunk in self.chunks:
            chunk.write(built)
        if self.chunks:
            Statistics(
                attachment_count=0,
                channel_count=len(self.channels),
                channel_message_counts=self.counts,
                chunk_count=len(self.chunks),
                message_count=sum(self.counts.values()),
                message_end_time=max(chunk.message_end_time for chunk in self.chunks),
                message_start_time=min(chunk.message_start_time for chunk in self.chunks),
                metadata_count=0,
                schema_count=len(self.schemas),
            ).write(built)
        Footer(
            summary_start=self.end if self.chunks else 0, summary_offset_start=0, summary_crc=0
        ).write(built)
        built.write(MCAP0_MAGIC)
        return bytes(built.end())


@lru_cache(_CACHED)
def _complete_part(path: Path, size: int, changed: int) -> _CompletePart:
    found, is_whole = _CompletePart(), False
    with open_file(path) as file:
        try:
            for opcode, offset, length in walk_records(file, size):
                if opcode == Opcode.DATA_END:
                    is_whole = True
                    break
                if opcode == Opcode.CHUNK:
                    found.add_chunk(file, offset, length)
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    file.seek(offset)
                    found.note(opcode, file.read(length))
                found.end = offset + length
        except BROKEN:
            pass  # the part up to here is complete
    found.faults.append(fault_of_end(found.end, size, is_whole=is_whole))
    found.appended = found.make_end()
    return found


def log_of(file: Path) -> Path | None:
    """Returns the log file with messages that are missing in the database, or None."""
    for log in (file.with_name(f"{file.name}{ending}") for ending in _LOGS):
        if log.is_file() and log.stat().st_size:
            return log
    return None


def with_log(file: Path, log: Path) -> Path:
    """Returns a temporary copy of a database that includes its log.

    rosbags opens databases as immutable, and therefore without their log.

    Raises:
        OSError: the database cannot be read, or there is no space for the copy.
        sqlite3.Error: the database is damaged.
    """
    states = [each.stat() for each in (file, log)]
    changed = tuple((each.st_size, each.st_mtime_ns) for each in states)
    return _copied(file.resolve(), log.resolve(), changed)


@lru_cache(_CACHED)
def _copied(file: Path, log: Path, changed: tuple[tuple[int, int], ...]) -> Path:
    folder = make_temporary_folder()
    for each in (file, log):
        shutil.copyfile(each, folder / each.name)
    with closing(sqlite3.connect(folder / file.name)) as database:
        database.execute("PRAGMA journal_mode = DELETE").fetchall()  # SQLite includes the log first
    return folder / file.name
