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
    """Column names in the tables of a program; an entry point in the group `sero_mj.columns`.

    Attributes:
        names: signal to column names, in lower case and without number, joint and unit.
        opposite: names of columns whose numbers have the opposite sign of ours.
        prefixes: prefixes that column names may have.
    """

    names: Mapping[str, tuple[str, ...]]
    opposite: tuple[str, ...] = ()
    prefixes: tuple[str, ...] = ()


class Tables(ABC):
    """Reads tables for the commands; an entry point in the group `sero_mj.tables`.

    `columns` are the declared columns of signals; signals without an entry are recognized by the
    names of their columns. All methods raise CsvError if the table cannot be read or has no such
    columns.
    """

    @abstractmethod
    def move_scene(
        self, scene: Scene, file: Path, columns: Columns, start: float | None, source: str | None
    ) -> None:
        """Replaces the sources of a scene by a table.

        Args:
            start: time after the first row at which playback begins, s.
            source: name of the source whose packets the table has; None to find it.
        """

    @abstractmethod
    def read_run(self, file: Path, scene: Scene, source: str | None, columns: Columns) -> RunLog:
        """Reads a table of the robots of a scene as a run."""

    @abstractmethod
    def read_motion(self, file: Path, robot: SerialRobot) -> tuple[Array, Array]:
        """Returns the times (T,) and joint angles (T, n) of a robot."""

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
            rate: rows per second, for a table without times.
            declared: structure of the packets as text, if it is not that of the source.
        """


def find_tables(file: Path) -> Tables:
    """Returns the installed reader for a table; raises UsageError if there is none."""
    found: Tables | None = load_first(TABLES, Tables)
    if found is None:
        raise UsageError(f"{file}: no extension that reads tables is installed")
    return found
