"""Reads the index and the chunks of MCAP files, including damaged files of any program.

The index is the summary of the file. If it is missing because the process was killed, the file is
scanned. This scan skips the contents of chunks, which `mcap.stream_reader` would decompress. Sizes
are checked before data are read or decompressed, unlike in the readers of `mcap`.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import Channel, Chunk, Metadata
from mcap.stream_reader import MAGIC_SIZE

from ...base.errors import mismatch

MAX_CHUNK_BYTES = 64 << 20  # maximum size of a decompressed chunk; writers use 1 to 4 MiB
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log and publish time
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length
_CHUNK_FIELDS = 8 + 8 + 8 + 4 + 4 + 8  # bytes of a chunk's fields, without text and data
# Exceptions of the mcap library and the decompressors for damaged data.
BROKEN = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    OverflowError,
    MemoryError,
    RuntimeError,
)
_ATTACHMENT_HEAD = 4096  # bytes that include the name of an attachment
_CRC_BYTES = 4 + MAGIC_SIZE  # checksum of the summary and magic number at the end of the file
NOT_CLOSED = "its process was killed, the disk was full, or it is still being written"


@dataclass(frozen=True)
class ChunkPlace:
    """The location of a chunk in an MCAP file.

    Attributes:
        length: length of its record in bytes.
        first: log time of the earliest message in ns.
        last: log time of the latest message in ns.
        channels: numbers of the channels that have messages in the chunk; None if unknown.
    """

    offset: int
    length: int
    first: int
    last: int
    channels: frozenset[int] | None


@dataclass
class FileIndex:
    """The index of an MCAP file.

    Attributes:
        counts: number of messages by channel, without the messages in `uncounted`.
        uncounted: chunks with an unknown number of messages.
        attachments: offset and length in bytes by name of the attachment.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    uncounted: list[ChunkPlace] = field(default_factory=list)
    metadata: dict[str, Mapping[str, str]] = field(default_factory=dict)
    attachments: dict[str, tuple[int, int]] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)


def read_index(file: BinaryIO) -> FileIndex:
    """Returns the index of a file with an MCAP header; raises OSError."""
    size = file.seek(0, os.SEEK_END)
    try:
        index = _from_summary(file, size)
    except BROKEN as error:
        index = _scan(file, size)
        index.faults.append(
            f"its index is damaged ({mcap_reason(error)}), so the whole file was scanned"
        )
        return index
    return index or _scan(file, size)


def read_record(file: BinaryIO, offset: int, length: int) -> io.BytesIO:
    """Returns the content of a record without its header; raises ValueError.

    Args:
        offset: position of the record in bytes.
        length: length of the record with its header in bytes.
    """
    size = file.seek(0, os.SEEK_END)
    if not 0 <= offset <= offset + length <= size:
        raise ValueError(f"{length} bytes at byte {offset} are beyond the end of the file")
    file.seek(offset + RECORD_HEAD.size)
    return io.BytesIO(file.read(max(length - RECORD_HEAD.size, 0)))


def _from_summary(file: BinaryIO, size: int) -> FileIndex | None:
    ending = FOOTER_SIZE + MAGIC_SIZE
    if size < MAGIC_SIZE + ending:
        return None
    file.seek(size - ending)
    opcode, length, start = struct.unpack("<BQQ", file.read(RECORD_HEAD.size + 8))
    if (opcode, length) != (Opcode.FOOTER, FOOTER_SIZE - RECORD_HEAD.size) or not start:
        return None
    if not MAGIC_SIZE <= start <= size - ending:
        raise ValueError("its position in the footer is wrong")
    file.seek(start)
    found = zlib.crc32(file.read(size - start - _CRC_BYTES))
    (expected,) = struct.unpack("<I", file.read(4))
    if expected and found != expected:
        raise ValueError("its checksum is wrong")
    file.seek(0)
    summary = SeekingReader(file, record_size_limit=size).get_summary()
    if summary is None:
        return None
    index = FileIndex(channels=dict(summary.channels))
    for each in summary.chunk_indexes:
        index.chunks.append(
            ChunkPlace(
                each.chunk_start_offset,
                each.chunk_length,
                each.message_start_time,
                each.message_end_time,
                frozenset(each.message_index_offsets) or None,
            )
        )
    for attachment in summary.attachment_indexes:
        index.attachments[attachment.name] = (attachment.offset, attachment.length)
    for place in summary.metadata_indexes:
        metadata = _metadata(file, place.offset, place.length)
        index.metadata[metadata.name] = metadata.metadata
    if summary.statistics is None:
        index.uncounted = list(index.chunks)
    else:
        index.counts = dict(summary.statistics.channel_message_counts)
    return index


def _scan(file: BinaryIO, size: int) -> FileIndex:
    index = FileIndex()
    # Chunks, with the counts of the message indices after them.
    chunks: list[tuple[tuple[int, int, int, int], dict[int, int]]] = []
    position, is_whole = MAGIC_SIZE, False
    try:
        for opcode, offset, length in walk_records(file, size):
            if opcode == Opcode.CHUNK:
                first, last = struct.unpack("<QQ", file.read(16))
                chunks.append(((offset, length, first, last), {}))
            elif opcode == Opcode.MESSAGE_INDEX:
                channel, entries = struct.unpack("<HI", file.read(6))
                if entries and chunks:
                    chunks[-1][1][channel] = entries // 16
            else:
                _note(file, opcode, offset, length, index)
            position, is_whole = offset + length, opcode == Opcode.DATA_END
    except BROKEN:
        pass  # the rest of the file is left out
    if chunks and not is_whole:
        chunks[-1][1].clear()  # some of its message indices may be missing
    for place, counts in chunks:
        chunk = ChunkPlace(*place, frozenset(counts) or None)
        index.chunks.append(chunk)
        if not counts:
            index.uncounted.append(chunk)
        for channel, count in counts.items():
            index.counts[channel] = index.counts.get(channel, 0) + count
    index.faults.append(fault_of_end(position, size, is_whole=is_whole))
    return index


def fault_of_end(position: int, size: int, *, is_whole: bool) -> str:
    """Describes why a file has no index; `position` is the end of its last complete record."""
    if is_whole:
        return f"was not closed ({NOT_CLOSED}), so it has no index"
    return (
        f"is truncated or damaged at byte {position} ({NOT_CLOSED}): "
        f"{size - position} bytes are ignored"
    )


def walk_records(file: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Yields opcode, offset and length of the records up to the end of the data."""
    position, opcode = MAGIC_SIZE, 0
    while opcode != Opcode.DATA_END:
        file.seek(position)
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
        end = position + RECORD_HEAD.size + length
        if opcode == 0 or end > size:
            return
        yield opcode, position, end - position
        position = end


def _note(file: BinaryIO, opcode: int, offset: int, length: int, index: FileIndex) -> None:
    if opcode == Opcode.CHANNEL:
        found = Channel.read(ReadDataStream(read_record(file, offset, length)))
        index.channels[found.id] = found
    elif opcode == Opcode.METADATA:
        metadata = _metadata(file, offset, length)
        index.metadata[metadata.name] = metadata.metadata
    elif opcode == Opcode.ATTACHMENT:
        stream = ReadDataStream(io.BytesIO(file.read(min(length, _ATTACHMENT_HEAD))))
        stream.read(16)  # two times
        index.attachments[stream.read_prefixed_string()] = (offset, length)


def _metadata(file: BinaryIO, offset: int, length: int) -> Metadata:
    found: Metadata = Metadata.read(ReadDataStream(read_record(file, offset, length)))
    return found


def mcap_reason(error: BaseException) -> str:
    """Returns the message of an error in `BROKEN`, or its type if there is no message."""
    return str(error) or {"EndOfFile": "it ends early"}.get(name := type(error).__name__, name)


def unpack_messages(record: bytes, channel: int) -> list[tuple[int, bytes]]:
    """Returns the log times in ns and data of a channel's messages in a chunk; raises BROKEN.

    `mcap.stream_reader.breakup_chunk` would take five times as long and decompresses without a
    limit.

    Args:
        record: record of the chunk without its header.
    """
    _, data = unpack_chunk(record)
    found = []
    for opcode, begin, end in records_in(data):
        if opcode == Opcode.MESSAGE:
            _, _, number, _, log_time, _ = _MESSAGE_HEAD.unpack_from(data, begin)
            if number == channel:
                found.append((log_time, data[begin + _MESSAGE_HEAD.size : end]))
    return found


def unpack_chunk(record: bytes) -> tuple[Chunk, bytes]:
    """Returns the chunk of a record and its decompressed contents; raises BROKEN."""
    chunk = Chunk.read(ReadDataStream(io.BytesIO(record)))
    if len(chunk.data) + _CHUNK_FIELDS + len(chunk.compression) != len(record):
        raise ValueError("it ends early")
    data = _decompressed(chunk)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its checksum is wrong")
    return chunk, data


def records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yields the opcode, the start and the end of each record in a chunk; raises BROKEN."""
    position, size = 0, len(data)
    while position < size:
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        end = position + RECORD_HEAD.size + length
        if opcode == 0 or end > size:
            what = "found opcode 0" if opcode == 0 else f"{length} bytes do not fit"
            raise ValueError(f"record at byte {position} of its contents: {what}")
        yield opcode, position, end
        position = end


def _decompressed(chunk: Chunk) -> bytes:
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        raise ValueError(f"{size} bytes when decompressed; expected at most {MAX_CHUNK_BYTES}")
    if chunk.compression == "zstd":
        stated = zstandard.get_frame_parameters(chunk.data).content_size
        if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError(f"found {stated} bytes when decompressed; expected {size}")
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = bytes(reader.read(size + 1))
    elif chunk.compression == "lz4":
        import lz4.frame

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression:
        raise mismatch(chunk.compression, "zstd, lz4 or none", "compression")
    else:
        data = chunk.data
    if len(data) != size:
        found = f"more than {size}" if len(data) > size else str(len(data))
        raise ValueError(f"found {found} bytes when decompressed; expected {size}")
    return data
