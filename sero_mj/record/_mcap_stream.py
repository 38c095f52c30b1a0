"""`McapStream`: what the `mcap` library writes to, so that the file is whole at every moment.

Behind the last record there always stands a short ending without an index, which the next records
are written over and bring along. So a process may be killed at any time, and readers find a whole
file without an index; only one that was killed in the midst of a write leaves half a chunk at the
end. On a full disk the same ending has its room already.
"""

from __future__ import annotations

import contextlib
import errno
from pathlib import Path
from typing import NoReturn

from mcap.data_stream import RecordBuilder
from mcap.records import DataEnd, Footer, McapRecord
from mcap.writer import MCAP0_MAGIC

from ..errors import RecordingError

_WHY = {
    errno.ENOSPC: "no space left on the disk",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file has reached the largest size that the system allows",
}


def pack_record(record: McapRecord) -> bytes:
    """Returns a record as it stands in a file."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


SHORT_ENDING = pack_record(DataEnd(0)) + pack_record(Footer(0, 0, 0)) + MCAP0_MAGIC


class McapStream:
    """A stream for `mcap.writer.Writer`: records wait until `flush` writes them with an ending.

    Args:
        path: the file.
        overwrite: write over a file that exists; else that is an error.

    Attributes:
        path: the file.
        size: bytes of the file.
        kept: what is in the file up to the last `flush`, for the error; empty for nothing.
        error: why nothing more can be written, or None.

    Raises:
        RecordingError: it exists already, or cannot be written.
    """

    def __init__(self, path: Path | str, *, overwrite: bool = False) -> None:
        self.path = Path(path)
        self.size, self.kept = 0, ""
        self.error: RecordingError | None = None
        self._end = 0  # where the records in the file end, and its ending begins
        self._records = bytearray()
        try:
            # Unbuffered: what is left in a buffer would be lost with the process.
            self._file = open(self.path, "wb" if overwrite else "xb", buffering=0)  # noqa: SIM115
        except FileExistsError as error:
            reason = "exists already; choose another name, or remove it"
            raise RecordingError(self.path, reason) from error
        except (OSError, ValueError) as error:
            raise RecordingError(self.path, f"cannot be written: {_why(error)}") from error

    @property
    def closed(self) -> bool:
        """Whether it is finished, or has failed."""
        return self._file.closed

    def write(self, data: bytes) -> int:
        """Takes whole records."""
        self._records += data
        return len(data)

    def tell(self) -> int:
        """Where the next record will stand."""
        return self._end + len(self._records)

    def flush(self) -> None:
        """Writes the records over the ending, which follows them.

        Raises:
            RecordingError: there is no room. What was written before is kept.
        """
        if self.error is not None:
            raise self.error
        if self._records:
            self._put(self._records + SHORT_ENDING)
            self._end += len(self._records)
            self._records.clear()

    def finish(self) -> None:
        """Writes records of which the last is an ending, and closes; raises as `flush` does."""
        self._put(self._records)
        self._file.close()

    def _put(self, data: bytearray) -> None:
        try:
            self._put_at_end(data)
        except OSError as error:
            self._rescue(error)

    def _put_at_end(self, data: bytes | bytearray) -> None:
        self._file.seek(self._end)
        view = memoryview(bytes(data))
        while view:
            written = self._file.write(view)
            if not written:
                raise OSError(errno.ENOSPC, "nothing was written")
            view = view[written:]
        self.size = self._end + len(data)

    def _rescue(self, error: OSError) -> NoReturn:
        """Removes what is half written, closes the file, and raises the error."""
        with contextlib.suppress(OSError):
            # The ending keeps its room on the disk throughout.
            self._file.truncate(self._end + len(SHORT_ENDING))
            self._put_at_end(SHORT_ENDING)
        with contextlib.suppress(OSError):
            self._file.close()
        kept = f"{self.kept} are kept in {self.size} bytes" if self.kept else "nothing is kept"
        reason = f"{_why(error)}; the recording ends here, {kept}"
        self.error = RecordingError(self.path, reason)
        raise self.error from error


def _why(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno is not None:
        return _WHY.get(error.errno) or f"{error.strerror}"
    return str(error)
