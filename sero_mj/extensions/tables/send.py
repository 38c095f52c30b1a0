"""Converts the rows of a table to packets, for `send`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ...base.frames import Array
from ...data.receive.structure import Structure
from ...data.record.csv_files import Columns
from ...data.send.play import MotionPackets
from ...data.send.playback import Playback
from ...robots.declared.scene import Scene
from .joints import robots_in
from .replay import events_of
from .table import Table, read_table


class TablePackets(Playback):
    """A playback of a table with the numbers of packets, in columns as in `events_of`.

    Raises CsvError.

    Args:
        rate: rows per second; replaces the time column.
    """

    def __init__(self, file: Path, structure: Structure, rate: float | None = None) -> None:
        table = read_table(file, rate=rate, instead=", or --rate")
        self._times, self._columns = table.times, events_of(table, structure)
        about = f"{file}, {', '.join(self._columns)}"
        duration = float(self._times[-1] - self._times[0])
        super().__init__(structure, about, len(self._times), duration)
        self._note_absent(self._columns)

    def packets(self) -> Iterator[tuple[float, bytes]]:
        for k, time in enumerate((self._times - self._times[0]).tolist()):
            packet = self._encode({event: rows[k] for event, rows in self._columns.items()})
            if packet is not None:
                yield time, packet


class JointRows(Playback):
    """A playback of a table with joint signals, which are converted to packets by inverse routes.

    Args:
        columns: declared columns; see `robots_in`.
        source: source whose packets are created; None for the only source of the scene.
        structure: structure of the packets; None for the declared structure of the source.

    Raises:
        CsvError: no robot has columns, or a column is missing or has text.
        DeclarationError: the scene's sources or routes are invalid.
        UsageError: no route uses the source.
    """

    def __init__(
        self,
        table: Table,
        scene: Scene,
        columns: Columns,
        source: str | None = None,
        structure: str | None = None,
    ) -> None:
        moved = robots_in(table, scene.robots, columns)
        self._times = table.times - table.times[0]
        players = {name: _RowPlayer(self._times, signals) for name, signals in moved.items()}
        self._packets = MotionPackets(scene, source, structure, players=players)
        about = "; ".join(f"{name}: {', '.join(signals)}" for name, signals in moved.items())
        count, duration = len(self._times), float(self._times[-1])
        super().__init__(self._packets.structure, f"{table.path}, {about}", count, duration)

    def packets(self) -> Iterator[tuple[float, bytes]]:
        for time in self._times.tolist():
            try:
                packet = self._packets.at(time)
            except ValueError:  # a number is out of the range of its type
                self.skipped += 1
                continue
            yield time, packet


class _RowPlayer:
    def __init__(self, times: Array, signals: Mapping[str, Array]) -> None:
        angles = signals["joint_angles"]
        self._times = times
        self._signals = {"commanded_angles": angles, "further": np.zeros_like(angles), **signals}

    def signals(self, t: float) -> Mapping[str, Array]:
        k = int(np.searchsorted(self._times, t, side="right")) - 1
        return {name: values[k] for name, values in self._signals.items()}
