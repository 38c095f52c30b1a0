"""`McapFile`: an MCAP file that is whole at every moment, also when its process is killed.

The file is written by the `mcap` library; what is ours is the stream below it. Behind the last
record there always stands a short ending without an index, which the next records are written over
and bring along. So a process may be killed at any time, and readers find a whole file without an
index; only one that was killed in the midst of a write leaves half a chunk at the end. On a full
disk the same ending has its room already.
"""

from __future__ import annotations

import contextlib
import errno
import io
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NoReturn

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, DataEnd, Footer, McapRecord, Schema
from mcap.writer import MCAP0_MAGIC, Writer
from numpy.typing import NDArray

from ..errors import RecordingError

CHUNK_BYTES = 1 << 20
FLUSH_AFTER = 0.4  # s: so that no more than half a second is lost with its process

_MESSAGE_HEAD = 31  # bytes of a message's record beside its data
_BY_US = 1 << 62  # larger than any chunk: the library shall not end one when we do not know it
_WHY = {
    errno.ENOSPC: "no space left on the disk",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file has reached the largest size that the system allows",
}


def _pack(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


SHORT_ENDING = _pack(DataEnd(0)) + _pack(Footer(0, 0, 0)) + MCAP0_MAGIC


class _WholeFile:
    """What the library writes to: records are kept until `flush` writes them with an ending.

    Attributes:
        end: where the records that are in the file end, and its ending begins.
        size: bytes of the file.
    """

    def __init__(self, file: io.FileIO) -> None:
        self.end = self.size = 0
        self._file = file
        self._records = bytearray()

    def write(self, data: bytes) -> int:
        self._records += data
        return len(data)

    def tell(self) -> int:
        return self.end + len(self._records)

    def flush(self) -> None:
        """Writes whole records over the ending, which follows them; raises OSError."""
        if self._records:
            self._put(self._records + SHORT_ENDING)
            self.end += len(self._records)
            self._records.clear()

    def finish(self) -> None:
        """Writes records of which the last is an ending; raises OSError."""
        self._put(self._records)

    def take_back(self) -> None:
        """Restores what stood there before a write that failed; raises OSError."""
        # The ending keeps its room on the disk throughout.
        self._file.truncate(self.end + len(SHORT_ENDING))
        self._records.clear()
        self._put(SHORT_ENDING)

    def _put(self, data: bytes | bytearray) -> None:
        self._file.seek(self.end)
        view = memoryview(bytes(data))
        while view:
            written = self._file.write(view)
            if not written:
                raise OSError(errno.ENOSPC, "nothing was written")
            view = view[written:]
        self.size = self.end + len(data)


class McapFile:
    """Writes an MCAP file. For one thread at a time.

    The memory it takes grows by the library's chunk index only: less than 1 kB per chunk, so 7 MB
    in an hour of chunks that are flushed every 0.4 s.

    Args:
        path: the file.
        library: what writes it, for the header.
        overwrite: write over a file that exists; else that is an error.
        chunk_bytes: a chunk is written when its messages are larger than this.
        flush_after: s after its first message a chunk is written in any case, by `flush_if_old`.

    Attributes:
        path: the file.
        error: why nothing more can be written, or None.

    Raises:
        RecordingError: it exists already, or cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        library: str,
        overwrite: bool = False,
        chunk_bytes: int = CHUNK_BYTES,
        flush_after: float = FLUSH_AFTER,
    ) -> None:
        self.path = Path(path)
        self.error: RecordingError | None = None
        self._chunk_bytes = chunk_bytes
        self._flush_after = flush_after
        self._waiting = 0  # bytes of the messages that are not yet in the file
        self._oldest = 0.0  # when the first of them came, on time.monotonic
        self._counted: set[int] = set()  # channels of packets
        self._span: tuple[int, int] | None = None  # log times of all packets, ns
        self._count = 0
        self._kept: tuple[int, tuple[int, int] | None] = (0, None)  # of those in the file
        try:
            # Unbuffered: what is left in a buffer would be lost with the process.
            self._file = open(self.path, "wb" if overwrite else "xb", buffering=0)  # noqa: SIM115
        except FileExistsError as error:
            reason = "exists already; choose another name, or remove it"
            raise RecordingError(self.path, reason) from error
        except (OSError, ValueError) as error:
            raise RecordingError(self.path, f"cannot be written: {_why(error)}") from error
        self._stream = _WholeFile(self._file)
        self._writer = Writer(self._stream, chunk_size=_BY_US)  # type: ignore[arg-type]
        self._writer.start(library=library)
        self._flush_stream()

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self._stream.size

    @property
    def closed(self) -> bool:
        """Whether it is finished, or has failed."""
        return self._file.closed

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Writes a schema and returns its number; raises RecordingError."""
        number: int = self._writer.register_schema(name, encoding, data)
        self._append(Schema(id=number, name=name, encoding=encoding, data=data))
        return number

    def add_channel(
        self,
        topic: str,
        encoding: str,
        schema: int,
        metadata: Mapping[str, str],
        *,
        counts: bool = True,
    ) -> int:
        """Writes a channel.

        Args:
            topic: its name.
            encoding: how its messages are encoded.
            schema: the number of its schema; 0 for none.
            metadata: what else there is to know.
            counts: whether its messages are packets, which are counted where the file ends early.

        Returns:
            Its number.

        Raises:
            RecordingError: it cannot be written.
        """
        number: int = self._writer.register_channel(topic, encoding, schema, dict(metadata))
        if counts:
            self._counted.add(number)
        self._append(
            Channel(
                id=number,
                topic=topic,
                message_encoding=encoding,
                schema_id=schema,
                metadata=dict(metadata),
            )
        )
        return number

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Writes a metadata record; raises RecordingError."""
        self._writer.add_metadata(name, dict(metadata))
        self._flush_stream()

    def add_attachment(self, name: str, media_type: str, data: bytes, log_time: int) -> None:
        """Writes a file into the file; `log_time` in ns since the epoch; raises RecordingError."""
        self._writer.add_attachment(0, log_time, name, media_type, data)
        self._flush_stream()

    def add_message(self, channel: int, data: bytes, log_time: int, sequence: int) -> None:
        """Adds a message to the chunk, and writes that when it is full.

        Args:
            channel: the channel's number.
            data: the message itself.
            log_time: ns since the epoch.
            sequence: its number, 32 bits.

        Raises:
            RecordingError: the chunk cannot be written.
        """
        if self.error is not None:
            raise self.error
        if not self._waiting:
            self._oldest = time.monotonic()
        self._writer.add_message(channel, log_time, data, log_time, sequence)
        self._waiting += _MESSAGE_HEAD + len(data)
        if channel in self._counted:
            self._count += 1
            first, last = self._span or (log_time, log_time)
            self._span = min(first, log_time), max(last, log_time)
        if self._waiting >= self._chunk_bytes:
            self.flush()

    def add_rows(
        self, channel: int, rows: NDArray[np.uint8], log_times: NDArray[np.uint64], sequence: int
    ) -> None:
        """Adds messages of one length; see `add_message`.

        Args:
            channel: the channel's number.
            rows: (n, bytes of a message).
            log_times: (n,), ns since the epoch.
            sequence: number of the first one; the others follow.

        Raises:
            RecordingError: a chunk cannot be written.
        """
        for i, (row, log_time) in enumerate(zip(rows, log_times.tolist(), strict=True), sequence):
            self.add_message(channel, row.tobytes(), log_time, i & 0xFFFFFFFF)

    def flush_if_old(self) -> float:
        """Writes the chunk when it is due; returns the s until it is, infinite when it is empty.

        Raises:
            RecordingError: it cannot be written.
        """
        if not self._waiting:
            return float("inf")
        remaining = self._oldest + self._flush_after - time.monotonic()
        if remaining > 0.0:
            return remaining
        self.flush()
        return float("inf")

    def flush(self) -> None:
        """Writes the messages that are not yet in the file; raises RecordingError."""
        if not self._waiting:
            return
        try:
            self._writer.flush()
        except OSError as error:
            self._rescue(error)
        self._waiting = 0
        self._kept = self._count, self._span

    def finish(self) -> None:
        """Writes what is left and the index, and closes the file; harmless when it is closed.

        Raises:
            RecordingError: there is no room. What was written before is kept.
        """
        if self.closed:
            return
        self.flush()
        self._writer.finish()
        try:
            self._stream.finish()
        except OSError as error:
            self._rescue(error)
        self._file.close()

    def _append(self, record: McapRecord) -> None:
        """Writes a record outside of chunks as well: that it is there must not hang on a chunk."""
        self._stream.write(_pack(record))
        self._flush_stream()

    def _flush_stream(self) -> None:
        if self.error is not None:
            raise self.error
        try:
            self._stream.flush()
        except OSError as error:
            self._rescue(error)

    def _rescue(self, error: OSError) -> NoReturn:
        """Takes back what is half written, closes the file, and tells."""
        with contextlib.suppress(OSError):
            self._stream.take_back()
        with contextlib.suppress(OSError):
            self._file.close()
        count, span = self._kept
        kept = "nothing is kept"
        if span is not None:
            seconds = (span[1] - span[0]) / 1e9
            kept = f"{count} packets over {seconds:.3f} s are kept in {self._stream.size} bytes"
        reason = f"{_why(error)}; the recording ends here, {kept}"
        self.error = RecordingError(self.path, reason)
        raise self.error from error


def _why(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno is not None:
        return _WHY.get(error.errno) or f"{error.strerror}"
    return str(error)
