"""`RecordingWriter`: packets and what they mean, into an MCAP file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..errors import UnknownName
from .mcap_file import CHUNK_BYTES, FLUSH_AFTER, McapFile
from .recording_format import (
    ABOUT,
    CLOCK,
    LOST,
    RAW_ENCODING,
    SCHEMA_ENCODING,
    SIGNALS_ENCODING,
    SOURCE_KEY,
    Clock,
    SourceDeclaration,
    raw_topic,
    signals_topic,
)
from .signals_json import Signals


@dataclass
class _Channels:
    """The numbers of a source's two channels, what the second holds, and the next packet's."""

    raw: int
    decoded: int
    signals: Signals
    number: int = 0


class RecordingWriter:
    """Writes a recording. For one thread at a time; `Recorder` is the front for several.

    The process may be killed at any time: what came more than `flush_after` before is in the file,
    as long as something is written or `flush_if_old` is called now and then. The file can be read
    while it is written.

    Args:
        path: the file.
        about: what it is a recording of, e.g. `{"scene": "lwr_udp"}`.
        overwrite: write over a file that exists; else that is an error.
        chunk_bytes: a chunk is written when its messages are larger than this.
        flush_after: s until a chunk is written though it is not full.

    Attributes:
        clock: when the recording began.

    Raises:
        RecordingError: the file exists already, or cannot be written.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        about: Mapping[str, str],
        overwrite: bool = False,
        chunk_bytes: int = CHUNK_BYTES,
        flush_after: float = FLUSH_AFTER,
    ) -> None:
        self.clock = Clock()
        self._channels: dict[str, _Channels] = {}
        self._file = McapFile(
            path,
            library=f"sero-mj {__version__}",
            overwrite=overwrite,
            chunk_bytes=chunk_bytes,
            flush_after=flush_after,
        )
        self._file.add_metadata(CLOCK, self.clock.to_metadata())
        self._file.add_metadata(ABOUT, about)

    @property
    def path(self) -> Path:
        """The file."""
        return self._file.path

    @property
    def size(self) -> int:
        """Bytes of the file so far."""
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
        """Makes room for a source's packets and for what they mean.

        Args:
            name: the source's name in routes.
            kind: its kind, e.g. `udp`.
            declared: its fields in the scene, of JSON's types; a replay makes its decoder of them.
            events: event name to its shape, (n,), (n, 3) or (n, 4, 4).
            size: bytes of a packet.
            signals: what is kept of the decoded packets; their events when None.

        Raises:
            RecordingError: it cannot be written.
            TypeError: a field that is not of JSON's types.
            ValueError: there is a source of this name already.
        """
        if name in self._channels:
            raise ValueError(f"source '{name}' is in the recording already")
        declaration = SourceDeclaration(name, kind, declared, events, size).to_json()
        raw = self._file.add_channel(raw_topic(name), RAW_ENCODING, 0, {SOURCE_KEY: declaration})
        signals = signals or Signals(dict(events))
        schema = self._file.add_schema(f"sero-mj.{name}", SCHEMA_ENCODING, signals.schema(name))
        decoded = self._file.add_channel(
            signals_topic(name), SIGNALS_ENCODING, schema, signals.origins, counts=False
        )
        self._channels[name] = _Channels(raw, decoded, signals)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Puts a file into the recording: the scene, a robot; raises RecordingError.

        Args:
            name: the file's name, with folders where that matters.
            media_type: e.g. `application/toml`.
            data: its contents.
        """
        self._file.add_attachment(name, media_type, data, self.clock.epoch_ns)

    def write_raw(
        self, name: str, packet: bytes, arrival: float, sequence: int | None = None
    ) -> None:
        """Keeps a packet as it came.

        Args:
            name: its source.
            packet: its bytes, well-formed or not.
            arrival: when it arrived, s on the clock of `time.monotonic`.
            sequence: its number; kept in 32 bits. Counted from 0 when it is not given.

        Raises:
            RecordingError: there is no room. What was written before is kept.
            UnknownName: no such source was added.
            ValueError: the arrival is not a time.
        """
        channels = self._find(name)
        number = channels.number if sequence is None else sequence
        channels.number = number + 1
        self._file.add_message(
            channels.raw, packet, self.clock.log_time(arrival), number & 0xFFFFFFFF
        )

    def write_rows(self, name: str, rows: NDArray[np.uint8], arrivals: NDArray[np.float64]) -> None:
        """Keeps packets of one length all at once.

        Args:
            name: their source.
            rows: (n, bytes of a packet).
            arrivals: when each arrived, (n,), s on the clock of `time.monotonic`.

        Raises:
            RecordingError: there is no room. What was written before is kept.
            UnknownName: no such source was added.
            ValueError: an arrival is not a time.
        """
        channels = self._find(name)
        number = channels.number
        channels.number = number + len(rows)
        self._file.add_rows(channels.raw, rows, self.clock.log_times(arrivals), number)

    def write_signals(
        self, name: str, values: Mapping[str, NDArray[np.float64]], arrival: float
    ) -> None:
        """Keeps what a good packet means, for other programs; call it behind its `write_raw`.

        Args:
            name: its source.
            values: key of `Signals.shapes` to its array; events by default.
            arrival: when the packet arrived, s on the clock of `time.monotonic`.

        Raises:
            RecordingError: there is no room. What was written before is kept.
            UnknownName: no such source was added.
            ValueError: the arrival is not a time.
        """
        channels = self._find(name)
        self._file.add_message(
            channels.decoded,
            channels.signals.encode(values),
            self.clock.log_time(arrival),
            max(0, channels.number - 1) & 0xFFFFFFFF,
        )

    def write_signal_rows(
        self,
        name: str,
        table: NDArray[np.float64],
        arrivals: NDArray[np.float64],
        sequences: Sequence[int],
    ) -> None:
        """Keeps what many packets mean at once.

        Args:
            name: their source.
            table: (n, k), the numbers of all its signals in their order; matrices row by row.
            arrivals: when each packet arrived, (n,), s on the clock of `time.monotonic`.
            sequences: the packets' numbers, n, counted from 0.

        Raises:
            RecordingError: there is no room. What was written before is kept.
            UnknownName: no such source was added.
            ValueError: an arrival is not a time.
        """
        channels = self._find(name)
        messages = channels.signals.encode_table(table)
        times = self.clock.log_times(arrivals).tolist()
        for message, time, sequence in zip(messages, times, sequences, strict=True):
            self._file.add_message(channels.decoded, message, time, sequence & 0xFFFFFFFF)

    def _find(self, name: str) -> _Channels:
        channels = self._channels.get(name)
        if channels is None:
            raise UnknownName("source", name, self._channels)
        return channels

    def flush(self) -> None:
        """Brings all that was written into the file; raises RecordingError."""
        self._file.flush()

    def flush_if_old(self) -> float:
        """Flushes when the oldest message waits for `flush_after`; returns the s until then.

        Raises:
            RecordingError: there is no room.
        """
        return self._file.flush_if_old()

    def close(self, *, lost: Mapping[str, int] | None = None) -> None:
        """Finishes the file; harmless when it is finished.

        Args:
            lost: source to the number of its packets that never came here, to be told by readers.

        Raises:
            RecordingError: there is no room for the rest. What was written before is kept.
        """
        if self._file.closed:
            return
        self._file.flush()
        told = {name: str(count) for name, count in (lost or {}).items() if count}
        if told:
            self._file.add_metadata(LOST, told)
        self._file.finish()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
