"""`TableFile`: a table of numbers as if it were a recording of one source."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import UnknownName
from ...base.frames import Array
from ..receive.structure import Structure
from .recording import PacketFile, RecordedSource
from .table import Table, read_table

SOURCE = "table"
_LATEST = 2.5e11  # s, the end of the last year that `datetime` has
_EPOCH = datetime.fromtimestamp(0.0, UTC)


class TableFile(PacketFile):
    """The rows of a table as packets. Times are s since its first row.

    Args:
        events: the numbers of its rows by event, (T, ...) in the events' shapes; they may be fewer
            than those of the structure.
        declared: how packets are decoded, as fields of a source of kind `udp`.
    """

    def __init__(
        self,
        table: Table,
        events: Mapping[str, Array],
        structure: Structure,
        declared: Mapping[str, Any],
    ) -> None:
        self.path, self.about, self.lost, self.faults = table.path, {}, {}, []
        first = float(table.times[0])  # s since 1970, or since the robot was started
        self.start = datetime.fromtimestamp(first, UTC) if 0 <= first < _LATEST else _EPOCH
        self._times = table.times - first
        self.duration = float(self._times[-1])
        self._events, self._structure = events, structure
        count = len(self._times)
        self.sources = {
            SOURCE: RecordedSource(
                SOURCE, "udp", dict(declared), structure.events, structure.size, count, 0.0,
                self.duration,
            )
        }  # fmt: skip

    def packets(
        self, name: str, start: float = -math.inf, stop: float | None = None
    ) -> Iterator[tuple[float, bytes]]:
        self._check(name)
        first = int(np.searchsorted(self._times, start))
        last = None if stop is None else int(np.searchsorted(self._times, stop))
        for k in range(len(self._times))[first:last]:
            yield float(self._times[k]), self._packet(k)

    def last_before(self, name: str, t: float) -> tuple[float, bytes] | None:
        self._check(name)
        k = int(np.searchsorted(self._times, t, side="right")) - 1
        return None if k < 0 else (float(self._times[k]), self._packet(k))

    def _check(self, name: str) -> None:
        if name != SOURCE:
            raise UnknownName("source", name, [SOURCE])

    def _packet(self, k: int) -> bytes:
        shapes = self._structure.events
        frames = {
            event: np.broadcast_to(np.eye(4), shapes[event]) for event in self._structure.matrices
        }
        return self._structure.encode(
            {**frames, **{event: rows[k] for event, rows in self._events.items()}}
        )

    @property
    def attachments(self) -> tuple[str, ...]:
        return ()

    def read_attachment(self, name: str) -> bytes:
        raise UnknownName("file", name, [])

    def close(self) -> None:
        """Does nothing: all rows have been read."""


def cached_table(
    path: Path, *, rate: float | None = None, time: str = "", instead: str = ""
) -> Table:
    """Reads a table, or returns it as it was read before if the file has not changed.

    Args:
        rate: see `read_table`.

    Raises:
        CsvError: it cannot be read.
    """
    try:
        about = path.stat()
    except OSError:
        return read_table(path)  # which says why
    state = path.absolute(), about.st_mtime_ns, about.st_size
    return _cached(path, state, rate, time, instead)


@lru_cache(4)  # opening a scene asks for it many times
def _cached(path: Path, _: tuple[Any, ...], rate: float | None, time: str, instead: str) -> Table:
    return read_table(path, rate=rate, time=time, instead=instead)
