"""The messages of one chunk of an MCAP file, from anybody: sizes are bounded beforehand."""

from __future__ import annotations

import io
import struct
import zlib
from struct import Struct

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk

MAX_CHUNK_BYTES = 64 << 20  # decompressed; writers make chunks of 1 to 4 MiB
_MESSAGE_HEAD = Struct("<BQHIQQ")  # opcode, length, channel, sequence, log and publish time
_RECORD_HEAD = Struct("<BQ")
_CHUNK_FIELDS = 8 + 8 + 8 + 4 + 4 + 8  # bytes of a chunk's fields, but for text and data
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


def unpack_messages(record: bytes, channel: int) -> list[tuple[int, bytes]]:
    """Returns a chunk's messages of one channel: log time in ns, and data.

    `mcap.stream_reader.breakup_chunk` would take five times as long, and decompresses without
    bounds.

    Args:
        record: the chunk's record, without its head.
        channel: the channel's number.

    Raises:
        BROKEN: one of these, where the chunk is damaged, or larger than can be meant.
    """
    chunk = Chunk.read(ReadDataStream(io.BytesIO(record)))
    if len(chunk.data) + _CHUNK_FIELDS + len(chunk.compression) != len(record):
        raise ValueError("it ends early")
    data = _decompressed(chunk)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("its check sum differs")
    found = []
    position, size = 0, len(data)
    while position < size:
        opcode, length = _RECORD_HEAD.unpack_from(data, position)
        end = position + _RECORD_HEAD.size + length
        if opcode == 0 or end > size:
            what = "found opcode 0" if opcode == 0 else f"{length} bytes do not fit"
            raise ValueError(f"record at byte {position} of it: {what}")
        if opcode == Opcode.MESSAGE:
            _, _, number, _, log_time, _ = _MESSAGE_HEAD.unpack_from(data, position)
            if number == channel:
                found.append((log_time, data[position + _MESSAGE_HEAD.size : end]))
        position = end
    return found


def _decompressed(chunk: Chunk) -> bytes:
    """What a chunk contains; never takes more memory than the chunk says, and that is bounded."""
    size = chunk.uncompressed_size
    if size > MAX_CHUNK_BYTES:
        most = f"expected at most {MAX_CHUNK_BYTES}"
        raise ValueError(f"{size} bytes when it is decompressed; {most}")
    if chunk.compression == "zstd":
        stated = zstandard.get_frame_parameters(chunk.data).content_size
        if stated not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError(f"its data are {stated} bytes when decompressed; it says {size}")
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = bytes(reader.read(size + 1))
    elif chunk.compression == "lz4":
        import lz4.frame

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"compression '{chunk.compression}'; expected zstd, lz4 or none")
    else:
        data = chunk.data
    if len(data) != size:
        found = f"more than {size}" if len(data) > size else str(len(data))
        raise ValueError(f"its data are {found} bytes when decompressed; it says {size}")
    return data
