"""`Tables`: the interface of an extension that reads tables of numbers, such as CSV files."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ...base.errors import UsageError
from ...base.frames import Array
from ...base.plugins import TABLES, load_first
from ...data.receive.source import Source
from ...data.receive.structure import Structure
from ...data.record.csv_files import Columns
from ...data.send.playback import Playback
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from .run_log import RunLog


@dataclass(frozen=True)
class ColumnNames:
    """Column names in tables that a program writes: an entry point of `sero_mj.columns`.

    Attributes:
        names: column names by signal, in lower case, without number, joint and unit.
        opposite: names of columns whose values have the opposite sign.
        prefixes: prefixes that column names may have.
    """

    names: Mapping[str, tuple[str, ...]]
    opposite: tuple[str, ...] = ()
    prefixes: tuple[str, ...] = ()


class Tables(ABC):
    """A reader of tables for use by commands: an entry point in the group `sero_mj.tables`.

    The argument `columns` contains the declared columns of signals. Other signals are recognized by
    the names of their columns. All methods raise CsvError if the table cannot be read or lacks
    columns.
    """

    @abstractmethod
    def move_scene(
        self, scene: Scene, file: Path, columns: Columns, start: float | None, source: str | None
    ) -> None:
        """Replaces the sources of a scene with a table.

        Args:
            start: time after the first row at which playback begins, s.
            source: name of the source whose packets the table contains (default: detected).
        """

    @abstractmethod
    def read_run(self, file: Path, scene: Scene, source: str | None, columns: Columns) -> RunLog:
        """Reads a table with signals of a scene's robots as a run."""

    @abstractmethod
    def read_motion(self, file: Path, robot: SerialRobot) -> tuple[Array, Array]:
        """Returns the times, shape (T,), s, and the joint angles of a robot, shape (T, n)."""

    @abstractmethod
    def open_playback(
        self,
        file: Path,
        scene: Scene,
        source: Source,
        structure: Structure,
        columns: Columns,
        *,
        rate: float | None,
        declared: str | None,
    ) -> Playback:
        """Returns the packets that `send` sends for the rows of a table.

        Args:
            structure: structure of the packets.
            rate: number of rows per second, for a table without times.
            declared: text of the packet structure if it differs from that of the source.
        """


def find_tables(file: Path) -> Tables:
    """Returns the installed reader of tables. Raises UsageError if there is none."""
    found: Tables | None = load_first(TABLES, Tables)
    if found is None:
        raise UsageError(f"{file}: no extension that reads tables is installed")
    return found
