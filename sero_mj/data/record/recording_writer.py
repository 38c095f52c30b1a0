"""Writes packets and decoded values to an MCAP file that is always valid.

The records are always followed by a short ending without an index. Each write overwrites the ending
and appends it again. If the process is killed, readers find a valid file without an index, or with
an incomplete last chunk if it was killed during a write. On a full disk, the space for the ending
is already allocated.
"""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, DataEnd, Footer, McapRecord, Schema
from mcap.writer import MCAP0_MAGIC, Writer
from numpy.typing import NDArray

from ... import __version__
from ...base.errors import RecordingError, UnknownName
from .joint_state_messages import (
    ENCODING,
    SCHEMA,
    SCHEMA_ENCODING,
    SCHEMA_NAME,
    JointStateMessages,
)
from .recording_format import (
    ABOUT,
    CLOCK,
    LIBRARY,
    LOST,
    RAW_SCHEMA,
    RAW_SCHEMA_NAME,
    SOURCE_KEY,
    RecordingClock,
    Signals,
    SourceDeclaration,
    message_type,
    pack_raw,
)

CHUNK_BYTES = 1 << 20
FLUSH_AFTER = 0.4  # s; at most half a second is lost if the process is killed
_MESSAGE_HEAD = 31  # bytes of a message's record, without its data
_NO_LIMIT = 1 << 62  # chunk size, so large that the library never ends a chunk
_WHY = {
    errno.ENOSPC: "no space left on the disk",
    errno.EDQUOT: "the disk quota is exceeded",
    errno.EFBIG: "the file has reached the maximum size of the system",
}


def pack_record(record: McapRecord) -> bytes:
    """Encodes an MCAP record as bytes."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


SHORT_ENDING = pack_record(DataEnd(0)) + pack_record(Footer(0, 0, 0)) + MCAP0_MAGIC


class McapStream:
    """A stream for `mcap.writer.Writer` that buffers records until `flush` writes them.

    Raises RecordingError if the file exists and `overwrite` is not set, or if it cannot be written.

    Attributes:
        contents: description of the data up to the last `flush`, for errors; empty without data.
        error: error after which nothing can be written, or None.
    """

    def __init__(self, path: Path | str, *, overwrite: bool = False) -> None:
        self.path = Path(path)
        self.size, self.contents = 0, ""
        self.error: RecordingError | None = None
        self._end = 0  # end of the records in the file, where its ending begins
        self._records = bytearray()
        try:
            # Unbuffered: buffered data would be lost with the process.
            self._file = open(self.path, "wb" if overwrite else "xb", buffering=0)  # noqa: SIM115
        except FileExistsError as error:
            reason = "already exists. Choose another name, or remove it"
            raise RecordingError(self.path, reason) from error
        except (OSError, ValueError) as error:
            raise RecordingError(self.path, f"cannot be written: {_why(error)}") from error

    @property
    def closed(self) -> bool:
        return self._file.closed

    def write(self, data: bytes) -> int:
        self._records += data
        return len(data)

    def tell(self) -> int:
        return self._end + len(self._records)

    def flush(self) -> None:
        """Overwrites the ending with the buffered records and a new ending; raises RecordingError.

        After an error, the file still contains the data written before.
        """
        if self.error is not None:
            raise self.error
        if self._records:
            self._put(self._records + SHORT_ENDING)
            self._end += len(self._records)
            self._records.clear()

    def finish(self) -> None:
        """Writes the buffered records, which include an ending, and closes the file."""
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
        with contextlib.suppress(OSError):
            # The space of the ending remains allocated throughout.
            self._file.truncate(self._end + len(SHORT_ENDING))
            self._put_at_end(SHORT_ENDING)
        with contextlib.suppress(OSError):
            self._file.close()
        contents = (
            f"it has {self.contents} in {self.size} bytes" if self.contents else "it has no packets"
        )
        reason = f"{_why(error)}. The recording has ended; {contents}"
        self.error = RecordingError(self.path, reason)
        raise self.error from error


def _why(error: Exception) -> str:
    if isinstance(error, OSError) and error.errno is not None:
        return _WHY.get(error.errno) or f"{error.strerror}"
    return str(error)


@dataclass
class _Channels:
    raw: int
    decoded: int
    signals: Signals
    joints: list[tuple[int, JointStateMessages]]
    number: int = 0


class RecordingWriter:
    """Writes a recording from one thread at a time. For several threads, use `Recorder`.

    If the process is killed, the file contains all data older than `flush_after`, provided that
    `flush_if_old` is called regularly. The file can be read while it is written. Memory grows by
    less than 1 kB per chunk, which is 7 MB per hour with chunks of 0.4 s. All methods raise
    RecordingError if the file cannot be written, and `__init__` if it exists.

    Args:
        about: description of the recording, such as `{"scene": "lwr_udp"}`.
        overwrite: whether to replace an existing file.
        flush_after: time in seconds after which an incomplete chunk is written.
        clock: start of the recording (default: now).
    """

    def __init__(
        self,
        path: Path | str,
        *,
        about: Mapping[str, str],
        overwrite: bool = False,
        chunk_bytes: int = CHUNK_BYTES,
        flush_after: float = FLUSH_AFTER,
        clock: RecordingClock | None = None,
    ) -> None:
        self.clock = RecordingClock() if clock is None else clock
        self._channels: dict[str, _Channels] = {}
        self._schemas: dict[str, int] = {}  # numbers by name
        self._chunk_bytes, self._flush_after = chunk_bytes, flush_after
        self._waiting = 0  # bytes of messages that are not in the file
        self._oldest = 0.0  # time of the first of these messages in s on time.monotonic
        self._count = 0  # number of all packets
        self._span = (2**64, 0)  # log times of the first and the last packet, ns
        self._file = McapStream(path, overwrite=overwrite)
        self._writer = Writer(self._file, chunk_size=_NO_LIMIT)  # type: ignore[arg-type]
        self._writer.start(profile="ros2", library=f"{LIBRARY} {__version__}")
        self._writer.add_metadata(CLOCK, self.clock.to_metadata())
        self._writer.add_metadata(ABOUT, dict(about))
        self._file.flush()

    @property
    def path(self) -> Path:
        return self._file.path

    @property
    def size(self) -> int:
        return self._file.size

    def add_source(
        self,
        name: str,
        *,
        kind: str,
        declared: Mapping[str, Any],
        events: Mapping[str, tuple[int, ...]],
        size: int,
        signals: Signals | None = None,
    ) -> None:
        """Adds channels for the packets of a source, and for their decoded values.

        Args:
            declared: fields of the source, as JSON types, from which a replay builds its decoder.
            events: shape (n,), (n, 3) or (n, 4, 4) of each event.
            size: size of a packet in bytes.
            signals: signals of decoded packets (default: the events).
        """
        if name in self._channels:
            raise ValueError(f"the recording already has a source '{name}'")
        declaration = SourceDeclaration(name, kind, declared, events, size).to_json()
        signals = signals or Signals(dict(events))
        of_raw = self._add_schema(RAW_SCHEMA_NAME, RAW_SCHEMA.encode())
        raw = self._add_channel(f"/{name}/raw", of_raw, {SOURCE_KEY: declaration})
        of_signals = self._add_schema(message_type(name, self._schemas), signals.schema())
        decoded = self._add_channel(f"/{name}/signals", of_signals, signals.origins)
        joints = []
        for robot, states in signals.joint_states.items():
            of_joints = self._add_schema(SCHEMA_NAME, SCHEMA)
            number = self._add_channel(f"/{robot}/joint_states", of_joints, {})
            joints.append((number, JointStateMessages(states, signals.shapes)))
        self._channels[name] = _Channels(raw, decoded, signals, joints)
        self._file.flush()

    def _add_schema(self, name: str, text: bytes) -> int:
        if name not in self._schemas:
            number: int = self._writer.register_schema(name, SCHEMA_ENCODING, text)
            self._repeat(Schema(id=number, name=name, encoding=SCHEMA_ENCODING, data=text))
            self._schemas[name] = number
        return self._schemas[name]

    def _add_channel(self, topic: str, schema: int, metadata: Mapping[str, str]) -> int:
        number: int = self._writer.register_channel(topic, ENCODING, schema, dict(metadata))
        self._repeat(
            Channel(
                id=number,
                topic=topic,
                message_encoding=ENCODING,
                schema_id=schema,
                metadata=dict(metadata),
            )
        )
        return number

    def _repeat(self, record: McapRecord) -> None:
        """Writes a record again outside of chunks, so that it can be read if a chunk is lost."""
        self._file.write(pack_record(record))

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Adds a file, such as the scene. Its name can include folders."""
        self._writer.add_attachment(0, self.clock.epoch_ns, name, media_type, data)
        self._file.flush()

    def write_raw(self, name: str, packet: bytes, arrival: float) -> None:
        """Writes a valid or malformed packet; `arrival` is in seconds on `time.monotonic`."""
        channels = self._find(name)
        log_time = self.clock.log_time(arrival)
        number = channels.number
        channels.number = number + 1
        self._count += 1
        first, last = self._span
        self._span = min(first, log_time), max(last, log_time)
        self._add(channels.raw, pack_raw(packet), log_time, number)

    def write_rows(self, name: str, rows: NDArray[np.uint8], arrivals: NDArray[np.float64]) -> None:
        """Writes n packets of one size, shape (n, bytes), with their arrival times in seconds."""
        for row, arrival in zip(rows, arrivals.tolist(), strict=True):
            self.write_raw(name, row.tobytes(), arrival)

    def write_signals(
        self, name: str, values: Mapping[str, NDArray[np.float64]], arrival: float
    ) -> None:
        """Writes the values of a packet, with keys of `Signals.shapes`, after `write_raw`."""
        channels = self._find(name)
        table, number = channels.signals.table(values), max(0, channels.number - 1)
        self.write_signal_rows(name, table, np.array([arrival]), [number])

    def write_signal_rows(
        self,
        name: str,
        table: NDArray[np.float64],
        arrivals: NDArray[np.float64],
        sequences: Sequence[int],
    ) -> None:
        """Writes the decoded values of n packets.

        Args:
            table: numbers of all signals in their order, shape (n, k); matrices row by row.
            arrivals: arrival times in seconds on the clock of `time.monotonic`, shape (n,).
            sequences: numbers of the n packets, counted from 0.
        """
        channels = self._find(name)
        log_times = [self.clock.log_time(arrival) for arrival in arrivals.tolist()]
        encoded = [(channels.decoded, channels.signals.encode_table(table))]
        for channel, joints in channels.joints:
            encoded.append((channel, joints.encode(table, log_times)))
        for channel, messages in encoded:
            for message, log_time, number in zip(messages, log_times, sequences, strict=True):
                self._add(channel, message, log_time, number)

    def _find(self, name: str) -> _Channels:
        channels = self._channels.get(name)
        if channels is None:
            raise UnknownName("source", name, self._channels)
        return channels

    def _add(self, channel: int, data: bytes, log_time: int, number: int) -> None:
        if self._file.error is not None:
            raise self._file.error
        if not self._waiting:
            self._oldest = time.monotonic()
        self._writer.add_message(channel, log_time, data, log_time, number & 0xFFFFFFFF)
        self._waiting += _MESSAGE_HEAD + len(data)
        if self._waiting >= self._chunk_bytes:
            self.flush()

    def flush(self) -> None:
        """Writes all buffered data to the file."""
        if not self._waiting:
            return
        self._writer.flush()
        self._waiting = 0
        seconds = max(self._span[1] - self._span[0], 0) / 1e9
        self._file.contents = f"{self._count} packets over {seconds:.3f} s" if self._count else ""

    def flush_if_old(self) -> float:
        """Flushes if the oldest buffered message is older than `flush_after`.

        Returns the time until the next flush in seconds, or infinity without buffered data.
        """
        remaining = self._oldest + self._flush_after - time.monotonic()
        if self._waiting and remaining > 0.0:
            return remaining
        self.flush()
        return float("inf")

    def close(self, *, lost: Mapping[str, int] | None = None) -> None:
        """Completes the file; `lost` is the number of lost packets by source."""
        if self._file.closed:
            return
        self.flush()
        counts = {name: str(count) for name, count in (lost or {}).items() if count}
        if counts:
            self._writer.add_metadata(LOST, counts)
            self._file.flush()
        self._writer.finish()
        self._file.finish()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
