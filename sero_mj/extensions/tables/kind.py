"""Reads tables for `sero-mj` commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...base.errors import CsvError
from ...base.frames import Array
from ...data.receive.source import Source
from ...data.receive.structure import Structure
from ...data.record.csv_files import Columns, column_names
from ...data.send.playback import Playback
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from ...simulate.runs.run_log import RunLog
from ...simulate.runs.tables import Tables
from .joints import move_by_table, robots_in
from .replay import has_numbers
from .run import read_run_table
from .send import JointRows, TablePackets
from .table import read_cached, read_csv, read_table


class TableReader(Tables):
    """The reader of tables for commands."""

    def move_scene(
        self, scene: Scene, file: Path, columns: Columns, start: float | None, source: str | None
    ) -> None:
        move_by_table(scene, file, columns, start, source)

    def read_run(self, file: Path, scene: Scene, source: str | None, columns: Columns) -> RunLog:
        return read_run_table(file, scene, source, columns)

    def read_motion(self, file: Path, robot: SerialRobot) -> tuple[Array, Array]:
        try:
            table = read_table(file)
            found = robots_in(table, {robot.name: robot}, {})[robot.name]
            return table.times, found["joint_angles"]
        except CsvError:  # if no column is recognized, all columns are joint angles
            times, columns = read_csv(file)
        if len(columns) != robot.n:
            expected = f"expected {robot.n}, one for each joint"
            reason = f"found {len(columns)} columns in addition to time; {expected}"
            raise CsvError(file, reason)
        return times, np.stack(list(columns.values()), axis=1)

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
        table = read_cached(file, columns, rate, ", or --rate")
        if has_numbers(table, structure.events) and not columns:
            return TablePackets(file, structure, rate)
        try:
            return JointRows(table, scene, columns, source.name, declared)
        except CsvError as error:
            if columns:
                raise
            count = len(column_names(structure.events))
            if len(table.columns) != count:
                others = f"or the {count} numbers of packets '{structure.text}', in order"
                raise CsvError(file, f"{error.reason}; {others}") from None
        return TablePackets(file, structure, rate)
