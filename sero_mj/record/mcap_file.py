"""`McapFile`: an MCAP file that is whole at every moment, also when its process is killed.

`mcap.writer.Writer` cannot be used for that: it learns of a full disk when the chunk is already
gone, and then can neither say what is in the file nor finish it. The records are the library's.

Behind the last chunk there always stands a short ending without an index; the next chunk is written
over it and brings it along. So a process may be killed at any time, and readers find a whole file
without an index; only one that was killed in the midst of a write leaves half a chunk at the end.
On a full disk the same ending has its room already.
"""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from ..errors import RecordingError
from .mcap_chunk import ChunkBuilder
from .mcap_summary import SHORT_ENDING, Summary, Totals, pack_record

CHUNK_BYTES = 1 << 20
FLUSH_AFTER = 0.4  # s: so that no more than half a second is lost with its process

_WHY = {
    errno.ENOSPC: "no space left on the disk",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file has reached the largest size that the system allows",
}


@dataclass(frozen=True)
class _Before:
    """How things stood before the last chunk: what remains when it is given up."""

    end: int
    totals: Totals


class McapFile:
    """Writes an MCAP file. For one thread at a time.

    The memory it takes grows by the chunk index only: about 100 bytes per chunk, so 20 MB in a day
    of chunks that are flushed every 0.4 s.

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
        self._chunk = ChunkBuilder()
        self._oldest = 0.0  # when the first message came into the chunk, on time.monotonic
        self._summary = Summary()
        self._before_last: _Before | None = None
        self._size = 0
        self._end = 0  # where whole records end, and the short ending begins
        try:
            # Unbuffered: what is left in a buffer would be lost with the process.
            self._file = open(self.path, "wb" if overwrite else "xb", buffering=0)  # noqa: SIM115
        except FileExistsError as error:
            reason = "exists already; choose another name, or remove it"
            raise RecordingError(self.path, reason) from error
        except (OSError, ValueError) as error:
            raise RecordingError(self.path, f"cannot be written: {_why(error)}") from error
        self._append(MCAP0_MAGIC + pack_record(Header("", library)))

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self._size

    @property
    def closed(self) -> bool:
        """Whether it is finished, or has failed."""
        return self._file.closed

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Writes a schema and returns its number; raises RecordingError."""
        number = self._summary.count(Opcode.SCHEMA) + 1
        record = pack_record(Schema(id=number, name=name, encoding=encoding, data=data))
        self._append(record)
        self._summary.add(Opcode.SCHEMA, record)
        return number

    def add_channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> int:
        """Writes a channel, outside of chunks: that it is there must not hang on one chunk.

        Args:
            topic: its name.
            encoding: how its messages are encoded.
            schema: the number of its schema; 0 for none.
            metadata: what else there is to know.

        Returns:
            Its number.

        Raises:
            RecordingError: it cannot be written.
        """
        number = self._summary.count(Opcode.CHANNEL) + 1
        record = pack_record(
            Channel(
                id=number,
                topic=topic,
                message_encoding=encoding,
                schema_id=schema,
                metadata=dict(metadata),
            )
        )
        self._append(record)
        self._summary.add(Opcode.CHANNEL, record)
        return number

    def add_metadata(self, name: str, metadata: Mapping[str, str]) -> None:
        """Writes a metadata record; raises RecordingError."""
        record = pack_record(Metadata(name=name, metadata=dict(metadata)))
        index = MetadataIndex(offset=self._end, length=len(record), name=name)
        self._append(record)
        self._summary.add(Opcode.METADATA_INDEX, pack_record(index))

    def add_attachment(self, name: str, media_type: str, data: bytes, log_time: int) -> None:
        """Writes a file into the file; `log_time` in ns since the epoch; raises RecordingError."""
        attachment = Attachment(
            create_time=0, log_time=log_time, name=name, media_type=media_type, data=data
        )
        record = pack_record(attachment)
        index = AttachmentIndex(
            offset=self._end,
            length=len(record),
            log_time=log_time,
            create_time=0,
            data_size=len(data),
            name=name,
            media_type=media_type,
        )
        self._append(record)
        self._summary.add(Opcode.ATTACHMENT_INDEX, pack_record(index))

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
        if not self._chunk.size:
            self._oldest = time.monotonic()
        self._chunk.add(channel, data, log_time, sequence)
        if self._chunk.size >= self._chunk_bytes:
            self.flush()

    def add_rows(
        self, channel: int, rows: NDArray[np.uint8], log_times: NDArray[np.uint64], sequence: int
    ) -> None:
        """Adds messages of one length all at once; see `add_message`.

        Args:
            channel: the channel's number.
            rows: (n, bytes of a message).
            log_times: (n,), ns since the epoch.
            sequence: number of the first one; the others follow.

        Raises:
            RecordingError: a chunk cannot be written.
        """
        if self.error is not None:
            raise self.error
        at_once = max(self._chunk_bytes // max(rows.shape[1], 1), 1)
        for first in range(0, len(rows), at_once):
            if not self._chunk.size:
                self._oldest = time.monotonic()
            part = slice(first, first + at_once)
            self._chunk.add_rows(channel, rows[part], log_times[part], sequence + first)
            if self._chunk.size >= self._chunk_bytes:
                self.flush()

    def flush_if_old(self) -> float:
        """Writes the chunk when it is due; returns the s until it is, infinite when it is empty.

        Raises:
            RecordingError: it cannot be written.
        """
        if not self._chunk.size:
            return float("inf")
        remaining = self._oldest + self._flush_after - time.monotonic()
        if remaining > 0.0:
            return remaining
        self.flush()
        return float("inf")

    def flush(self) -> None:
        """Writes the messages that are not yet in the file; raises RecordingError."""
        if not self._chunk.size:
            return
        sealed = self._chunk.seal(self._end)
        before = _Before(self._end, self._summary.totals)
        self._append(sealed.data)
        self._before_last = before
        self._summary.add_chunk(sealed)

    def finish(self) -> None:
        """Writes what is left and the index, and closes the file; harmless when it is closed.

        Raises:
            RecordingError: there is no room. What was written before is kept.
        """
        if self.closed:
            return
        self.flush()
        try:
            self._write_at(self._end, self._summary.ending(self._end))
        except OSError as error:
            self._rescue(error)
        self._file.close()

    def _append(self, data: bytes) -> None:
        """Writes whole records over the short ending, which follows them."""
        if self.error is not None:
            raise self.error
        try:
            self._write_at(self._end, data + SHORT_ENDING)
        except OSError as error:
            self._rescue(error)
        self._end += len(data)
        self._before_last = None

    def _write_at(self, offset: int, data: bytes) -> None:
        self._file.seek(offset)
        view = memoryview(data)
        while view:
            written = self._file.write(view)
            if not written:
                raise OSError(errno.ENOSPC, "nothing was written")
            view = view[written:]
        self._size = offset + len(data)

    def _rescue(self, error: OSError) -> NoReturn:
        """Takes back what is half written, ends the file as well as there is room, and tells."""
        for ending in (self._end_with_index, self._end_without_last_chunk, self._end_shortly):
            with contextlib.suppress(OSError):
                self._file.truncate(self._end)
                if ending():
                    break
        else:
            self._size = self._end
            with contextlib.suppress(OSError):
                self._file.truncate(self._end)
        with contextlib.suppress(OSError):
            self._file.close()
        totals = self._summary.totals
        kept = "nothing is kept"
        if totals.messages:
            seconds = (totals.last - totals.first) / 1e9
            kept = f"{totals.messages} messages over {seconds:.3f} s are kept in {self._end} bytes"
        reason = f"{_why(error)}; the recording ends here, {kept}"
        self.error = RecordingError(self.path, reason)
        raise self.error from error

    def _end_with_index(self) -> bool:
        self._write_at(self._end, self._summary.ending(self._end))
        return True

    def _end_without_last_chunk(self) -> bool:
        before = self._before_last
        if before is None or self._end - before.end < len(self._summary.ending(self._end)):
            return False  # it would not make room enough
        self._file.truncate(before.end)
        self._end = before.end
        self._summary.drop_last_chunk(before.totals)
        return self._end_with_index()

    def _end_shortly(self) -> bool:
        self._write_at(self._end, SHORT_ENDING)
        return True


def _why(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno is not None:
        return _WHY.get(error.errno) or f"{error.strerror}"
    return str(error)
