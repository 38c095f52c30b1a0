"""Where in an MCAP file everything is: from its summary, or else by looking through it.

Looking through skips what chunks contain, so it takes about as long as there are chunks.
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    Metadata,
    MetadataIndex,
    Statistics,
)
from mcap.stream_reader import MAGIC_SIZE, StreamReader
from mcap.writer import MCAP0_MAGIC

from .mcap_chunk import BROKEN, reason_of
from .mcap_summary import summary_crc

_HEAD = struct.Struct("<BQ")
_ATTACHMENT_HEAD = 4096  # bytes that surely hold an attachment's name
_NOT_CLOSED = "its process was killed, the disk was full, or it is still being written"


@dataclass(frozen=True)
class ChunkPlace:
    """A chunk in the file.

    Attributes:
        offset: where its record begins.
        length: bytes of its record.
        first: log time of its earliest message, ns.
        last: log time of its latest message, ns.
        channels: those that it has messages of; None when that is not known.
    """

    offset: int
    length: int
    first: int
    last: int
    channels: frozenset[int] | None


@dataclass
class FileIndex:
    """Where everything is.

    Attributes:
        channels: number to channel.
        chunks: in the order of the file.
        counts: channel to its number of messages, but for those in `uncounted`.
        uncounted: chunks that nothing tells the messages of.
        metadata: name to what a metadata record says.
        attachments: name to where its record stands and how long it is.
        faults: what is wrong with the file.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    uncounted: list[ChunkPlace] = field(default_factory=list)
    metadata: dict[str, Mapping[str, str]] = field(default_factory=dict)
    attachments: dict[str, tuple[int, int]] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)


def read_index(file: BinaryIO) -> FileIndex:
    """Returns where everything is in a file that begins as an MCAP file does; raises OSError."""
    size = file.seek(0, os.SEEK_END)
    try:
        index = _from_summary(file, size)
    except BROKEN as error:
        index = _look_through(file, size)
        index.faults.append(
            f"its index is damaged ({reason_of(error)}), so all of it was looked through"
        )
        return index
    return index or _look_through(file, size)


def read_record(file: BinaryIO, offset: int, length: int) -> io.BytesIO:
    """Returns what a record says, without its head."""
    file.seek(offset + _HEAD.size)
    return io.BytesIO(file.read(length - _HEAD.size))


def _find_footer(file: BinaryIO, size: int) -> tuple[Footer, bytes] | None:
    """Returns the footer and its bytes with all behind it; None where it names no summary."""
    ending = FOOTER_SIZE + MAGIC_SIZE
    if size < MAGIC_SIZE + ending:
        return None
    file.seek(size - ending)
    tail = file.read(ending)
    opcode, length = _HEAD.unpack_from(tail)
    if not tail.endswith(MCAP0_MAGIC) or (opcode, length) != (Opcode.FOOTER, 20):
        return None
    footer = Footer.read(ReadDataStream(io.BytesIO(tail[_HEAD.size :])))
    return (footer, tail) if footer.summary_start else None


def _from_summary(file: BinaryIO, size: int) -> FileIndex | None:
    """Reads the summary; None where there is none; raises one of BROKEN when it is damaged."""
    found = _find_footer(file, size)
    if found is None:
        return None
    footer, tail = found
    if not MAGIC_SIZE <= footer.summary_start <= size - len(tail):
        raise ValueError("it is not where the end of the file says")
    file.seek(footer.summary_start)
    summary = file.read(size - len(tail) - footer.summary_start)
    if footer.summary_crc and footer.summary_crc != summary_crc(summary, footer):
        raise ValueError("its check sum differs")
    index, statistics = FileIndex(), None
    for record in StreamReader(io.BytesIO(summary + tail), skip_magic=True).records:
        if isinstance(record, Channel):
            index.channels[record.id] = record
        elif isinstance(record, ChunkIndex):
            place = ChunkPlace(
                record.chunk_start_offset,
                record.chunk_length,
                record.message_start_time,
                record.message_end_time,
                frozenset(record.message_index_offsets) or None,
            )
            index.chunks.append(place)
        elif isinstance(record, AttachmentIndex):
            index.attachments[record.name] = (record.offset, record.length)
        elif isinstance(record, Statistics):
            statistics = record
        elif isinstance(record, MetadataIndex):
            metadata = Metadata.read(
                ReadDataStream(read_record(file, record.offset, record.length))
            )
            index.metadata[metadata.name] = metadata.metadata
    if statistics is None:
        index.uncounted = list(index.chunks)
    else:
        index.counts = dict(statistics.channel_message_counts)
    return index


class _Chunks:
    """Chunks as they are met, and their messages as the records behind them tell."""

    def __init__(self) -> None:
        self.places: list[tuple[int, int, int, int]] = []
        self.counts: list[dict[int, int]] = []

    def into(self, index: FileIndex, *, cut: bool) -> None:
        """Puts them into the index.

        Args:
            index: where to.
            cut: the file ends early: some of the records behind the last chunk may be missing.
        """
        if cut and self.counts:
            self.counts[-1].clear()
        for place, counts in zip(self.places, self.counts, strict=True):
            chunk = ChunkPlace(*place, frozenset(counts) or None)
            index.chunks.append(chunk)
            if not counts:
                index.uncounted.append(chunk)
            for channel, count in counts.items():
                index.counts[channel] = index.counts.get(channel, 0) + count


def _look_through(file: BinaryIO, size: int) -> FileIndex:
    """Walks from record to record, up to the end of the data or to where that is not possible."""
    index, chunks = FileIndex(), _Chunks()
    position, opcode = MAGIC_SIZE, 0
    while opcode != Opcode.DATA_END:
        file.seek(position)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            break
        opcode, length = _HEAD.unpack(head)
        end = position + _HEAD.size + length
        if opcode == 0 or end > size:
            break
        try:
            _note(file, opcode, position, end - position, index, chunks)
        except BROKEN:
            break
        position = end
    whole = opcode == Opcode.DATA_END and position <= size
    chunks.into(index, cut=not whole)
    if whole:
        index.faults.append(f"was not closed ({_NOT_CLOSED}), so it has no index")
    else:
        rest = size - position
        index.faults.append(
            f"is cut off or damaged at byte {position} ({_NOT_CLOSED}): {rest} bytes are left out"
        )
    return index


def _note(
    file: BinaryIO, opcode: int, offset: int, length: int, index: FileIndex, chunks: _Chunks
) -> None:
    """Notes what a record is; the file stands behind the record's head."""
    if opcode == Opcode.CHUNK:
        first, last = struct.unpack("<QQ", file.read(16))
        chunks.places.append((offset, length, first, last))
        chunks.counts.append({})
    elif opcode == Opcode.MESSAGE_INDEX:
        channel, entries = struct.unpack("<HI", file.read(6))
        if entries and chunks.counts:
            chunks.counts[-1][channel] = entries // 16
    elif opcode == Opcode.CHANNEL:
        found = Channel.read(ReadDataStream(read_record(file, offset, length)))
        index.channels[found.id] = found
    elif opcode == Opcode.METADATA:
        metadata = Metadata.read(ReadDataStream(read_record(file, offset, length)))
        index.metadata[metadata.name] = metadata.metadata
    elif opcode == Opcode.ATTACHMENT:
        stream = ReadDataStream(io.BytesIO(file.read(min(length, _ATTACHMENT_HEAD))))
        stream.read(16)  # two times
        index.attachments[stream.read_prefixed_string()] = (offset, length)
