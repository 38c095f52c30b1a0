"""A motion from a recording or a table as a target for a simulated robot."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from ..errors import CsvError, DeclarationError, Problem, SeroError, did_you_mean
from ..record.csv_files import read_csv
from ..runs.run_recording import read_run

Array = NDArray[np.float64]

# s between two rows that are kept: encoders are not that good that more would tell accelerations.
_EVERY = 0.02


def with_motion(table: Mapping[str, Any], robot: SerialRobot, beside: Path) -> dict[str, Any]:
    """Puts the motion that `file` names into a table of kind `recorded`.

    A recording (`.mcap`) has the angles of the robot of the same name, of that named `of`, or of
    the only one. A table (`.csv`) has a column `time`, in s, and one for every joint, in order.

    Args:
        table: of the target; others than such with a `file` come back as they are.
        robot: that is to follow.
        beside: folder that the file is relative to.

    Returns:
        the table with `times` and `angles` instead, averaged over 20 ms and beginning at 0 s.

    Raises:
        DeclarationError: the file cannot be read, or has no such motion.
    """
    fields = dict(table)
    file, of = fields.pop("file", None), fields.pop("of", None)
    if table.get("kind") != "recorded":
        return dict(table)
    if file is None:
        if "times" not in table:
            raise _wrong("file", "is required; expected RUN.mcap or TABLE.csv, or times and angles")
        return dict(table)
    if not isinstance(file, str):
        raise _wrong("file", f"found {file!r}; expected the name of a recording or a table")
    for key in ("times", "angles", "angles_deg"):
        if key in fields:
            raise _wrong(key, "is what the file says; leave it or `file` out")
    try:
        read = _from_table if file.lower().endswith(".csv") else _from_recording
        times, angles = read(beside / file, robot, of)
    except SeroError as error:
        if isinstance(error, DeclarationError):
            raise
        raise _wrong("file", str(error)) from None
    rows = ((times - times[0]) / _EVERY).astype(int)
    _, first, counts = np.unique(rows, return_index=True, return_counts=True)
    means = np.add.reduceat(angles, first) / counts[:, None]
    moments = np.add.reduceat(times - times[0], first) / counts
    if len(moments) < 2:
        raise _wrong("file", f"{file} is shorter than {2 * _EVERY:g} s")
    return {**fields, "times": moments - moments[0], "angles": means}


def _from_table(file: Path, robot: SerialRobot, of: object) -> tuple[Array, Array]:
    if of is not None:
        raise _wrong("of", "is for recordings, which may have several robots; leave it out")
    times, columns = read_csv(file)
    if len(columns) != robot.n:
        found = f"found {len(columns)} columns beside time; expected {robot.n}, one per joint"
        raise CsvError(file, found)
    return times, np.stack(list(columns.values()), axis=1)


def _from_recording(file: Path, robot: SerialRobot, of: object) -> tuple[Array, Array]:
    log = read_run(file)
    names = list(log.robots)
    name = of or (robot.name if robot.name in names or len(names) != 1 else names[0])
    if name not in names:
        key = "file" if of is None else "of"
        raise _wrong(key, f"no robot '{name}' in {file}{did_you_mean(str(name), names)}")
    if log.robots[str(name)].n != robot.n:
        found = f"robot '{name}' in {file} has {log.robots[str(name)].n} joints"
        raise _wrong("file", f"{found}; '{robot.name}' has {robot.n}")
    return log.times, log.of(str(name), "joint_angles")


def _wrong(key: str, message: str) -> DeclarationError:
    return DeclarationError([Problem(key, message)])
