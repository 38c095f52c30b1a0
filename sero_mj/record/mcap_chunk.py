"""Messages on their way into one chunk of an MCAP file, and out of it again.

Only what is there once per message is packed and unpacked here by hand, because that has to be
fast; all other records are those of the `mcap` library.
"""

from __future__ import annotations

import io
import struct
import sys
from array import array
from dataclasses import dataclass
from struct import Struct

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex
from mcap.stream_reader import get_chunk_data_stream
from numpy.typing import NDArray

# Operation code, length of what follows, channel, sequence, log time, publish time.
_MESSAGE_HEAD = Struct("<BQHIQQ")
_MESSAGE_DTYPE = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"),
     ("log_time", "<u8"), ("publish_time", "<u8")]
)  # fmt: skip
_MESSAGE_FIELDS = _MESSAGE_HEAD.size - 9  # bytes of the fields that count into a record's length
_INDEX_HEAD = Struct("<BQHI")
_RECORD_HEAD = Struct("<BQ")
_CHUNK_FIELDS = 8 + 8 + 8 + 4 + 4 + 8  # bytes of a chunk's fields, but for text and data
_COMPRESSION = "zstd"
# What the mcap library and the decompressors raise where bytes are not what they should be.
BROKEN = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    OverflowError,
    MemoryError,
    RuntimeError,
)


def reason_of(error: BaseException) -> str:
    """What one of BROKEN says; those of the mcap library often say nothing."""
    return str(error) or {"EndOfFile": "it ends early"}.get(name := type(error).__name__, name)


@dataclass(frozen=True)
class SealedChunk:
    """A chunk as it goes into the file.

    Attributes:
        data: the chunk record and the message index records behind it.
        index: the chunk index record for the file's summary.
        first: log time of the earliest message, ns.
        last: log time of the latest message, ns.
        counts: channel to its number of messages.
    """

    data: bytes
    index: bytes
    first: int
    last: int
    counts: dict[int, int]


class ChunkBuilder:
    """Collects messages until they are sealed into a chunk.

    Attributes:
        size: bytes of the message records so far.
    """

    def __init__(self) -> None:
        self._compressor = zstandard.ZstdCompressor(
            level=-6, write_checksum=True
        )  # more than twice as fast as 1, 11 % larger
        # Kept from chunk to chunk: fresh memory costs more than what is written into it.
        self._records = bytearray(1 << 16)
        self.clear()

    def clear(self) -> None:
        """Forgets all messages."""
        self.size = 0
        self._index: dict[int, array[int]] = {}  # channel to time, offset, time, offset, ...

    def _make_room(self, size: int) -> tuple[int, int]:
        """Counts so many bytes in; returns where they begin and end."""
        begin, end = self.size, self.size + size
        if end > len(self._records):
            self._records += bytes(max(size, len(self._records)))
        self.size = end
        return begin, end

    def add(self, channel: int, data: bytes, log_time: int, sequence: int) -> None:
        """Adds a message.

        Args:
            channel: the channel's number.
            data: the message itself.
            log_time: ns since the epoch.
            sequence: its number, 32 bits.
        """
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = array("Q")
        index.append(log_time)
        index.append(self.size)
        length = _MESSAGE_FIELDS + len(data)
        record = _MESSAGE_HEAD.pack(Opcode.MESSAGE, length, channel, sequence, log_time, log_time)
        begin, end = self._make_room(len(record) + len(data))
        self._records[begin:end] = record + data

    def add_rows(
        self, channel: int, rows: NDArray[np.uint8], log_times: NDArray[np.uint64], sequence: int
    ) -> None:
        """Adds messages of one length all at once, which takes a tenth of the time.

        Args:
            channel: the channel's number.
            rows: (n, bytes of a message).
            log_times: (n,), ns since the epoch.
            sequence: number of the first one; the others follow.
        """
        index = self._index.setdefault(channel, array("Q"))
        count, size = rows.shape
        head = _MESSAGE_HEAD.size
        entries = np.empty((count, 2), np.uint64)
        entries[:, 0] = log_times
        entries[:, 1] = self.size + np.arange(count) * (head + size)
        begin, end = self._make_room(count * (head + size))
        room = np.frombuffer(self._records, np.uint8, end - begin, begin)
        records = room.reshape(count, head + size)
        fields = records[:, :head].view(_MESSAGE_DTYPE)[:, 0]
        fields["opcode"], fields["length"] = Opcode.MESSAGE, _MESSAGE_FIELDS + size
        fields["channel"], fields["sequence"] = channel, (sequence + np.arange(count)) & 0xFFFFFFFF
        fields["log_time"] = fields["publish_time"] = log_times
        records[:, head:] = rows
        index.frombytes(entries.tobytes())

    def seal(self, offset: int) -> SealedChunk:
        """Returns the chunk of all messages so far, at least one, and forgets them.

        Args:
            offset: where in the file the chunk will stand.
        """
        times = [np.frombuffer(index, np.uint64)[::2] for index in self._index.values()]
        first, last = min(int(each.min()) for each in times), max(int(each.max()) for each in times)
        size = self.size
        packed = self._compressor.compress(memoryview(self._records)[:size])
        builder = RecordBuilder()
        Chunk(
            compression=_COMPRESSION,
            data=packed,
            message_start_time=first,
            message_end_time=last,
            uncompressed_crc=0,  # zstd has a checksum of its own, which is ten times as fast
            uncompressed_size=size,
        ).write(builder)
        chunk_length = builder.count
        places = {}
        for channel, index in self._index.items():
            places[channel] = offset + builder.count
            _write_message_index(builder, channel, index)
        index_length = builder.count - chunk_length
        data = builder.end()
        ChunkIndex(
            chunk_length=chunk_length,
            chunk_start_offset=offset,
            compression=_COMPRESSION,
            compressed_size=len(packed),
            message_end_time=last,
            message_index_length=index_length,
            message_index_offsets=places,
            message_start_time=first,
            uncompressed_size=size,
        ).write(builder)
        counts = {channel: len(index) // 2 for channel, index in self._index.items()}
        self.clear()
        return SealedChunk(data, builder.end(), first, last, counts)


def _write_message_index(builder: RecordBuilder, channel: int, index: array[int]) -> None:
    # mcap.records.MessageIndex packs number by number, which would take longer than all the rest.
    entries = index
    if sys.byteorder == "big":
        entries = index[:]
        entries.byteswap()
    packed = entries.tobytes()
    length = _INDEX_HEAD.size - 9 + len(packed)
    builder.write(_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, length, channel, len(packed)))
    builder.write(packed)


def unpack_messages(record: bytes, channel: int) -> list[tuple[int, bytes]]:
    """Returns a chunk's messages of one channel: log time in ns, and data.

    Args:
        record: the chunk's record, without its head.
        channel: the channel's number.

    Raises:
        BROKEN: one of these, where the chunk is damaged.
    """
    chunk = Chunk.read(ReadDataStream(io.BytesIO(record)))
    if len(chunk.data) + _CHUNK_FIELDS + len(chunk.compression) != len(record):
        raise ValueError("it ends early")
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data = stream.read(size)
    found = []
    position = 0
    while position < size:
        opcode, length = _RECORD_HEAD.unpack_from(data, position)
        end = position + _RECORD_HEAD.size + length
        if opcode == Opcode.MESSAGE:
            _, _, number, _, log_time, _ = _MESSAGE_HEAD.unpack_from(data, position)
            if number == channel:
                found.append((log_time, data[position + _MESSAGE_HEAD.size : end]))
        position = end
    return found
