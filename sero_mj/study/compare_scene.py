"""Two runs of a robot in one picture: arrows on the difference, a double for the other one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..assemble.double import Double
from ..assemble.robot import SerialRobot
from ..assemble.robot_parts import BillboardLine
from ..assemble.scene import Scene
from ..receive.structure import Structure
from ..record.recording_writer import RecordingWriter
from ..runs.run_log import TIME
from .align import Pair

Array = NDArray[np.float64]

_MOST_PER_SECOND = 240.0  # rows; more than any film shows
_GREEN = np.array([0.10, 0.62, 0.30, 0.42])


def compare_scene(pair: Pair, folder: Path) -> Scene:
    """A scene that plays both runs on one clock.

    Arrows show the torques of the first run less those of the second; the robot stands as in the
    first, and a transparent double as in the second.

    Args:
        pair: the runs.
        folder: where the two recordings are written that it plays, `a.mcap` and `b.mcap`.

    Raises:
        RecordingError: they cannot be written.
    """
    robot = pair.robot.name
    other = "b" if robot != "b" else "second"
    for source, run in (("a", pair.a), ("b", pair.b)):
        _write(folder / f"{source}.mcap", source, pair.times, run)
    routes = {f"{robot}.joint_angles": "a.joint_angles", f"{other}.joint_angles": "b.joint_angles"}
    if "torques" in pair.signals:
        routes |= {f"{robot}.commanded_torques": "a.torques", f"{robot}.torques": "b.torques"}
    return Scene(
        robots=[_shown(pair.robot)],
        doubles=[Double(name=other, of=robot, rgba=_GREEN)],
        sources={
            name: {"kind": "replay", "file": str(folder / f"{name}.mcap")} for name in ("a", "b")
        },
        routes=routes,
        name=f"{pair.names[0]} less {pair.names[1]}",
    )


def _shown(robot: SerialRobot) -> SerialRobot:
    lines = [
        BillboardLine(value="commanded_torques", label="A", decimals=1),
        BillboardLine(value="torques", label="B", decimals=1),
        BillboardLine(value="torque_error", label="A - B", decimals=1),
    ]
    changed = {
        "show_arrows": True,
        "arrow_quantity": "torque_error",
        "show_billboards": True,
        "billboard_lines": lines,
    }
    return robot.model_copy(update=changed)


def _write(path: Path, source: str, times: Array, run: Mapping[str, Array]) -> None:
    """Writes a run as a recording whose packets come at its own times."""
    signals = [signal for signal in ("joint_angles", "torques") if signal in run]
    n = run["joint_angles"].shape[1]
    structure = Structure(" ".join([f"{TIME}:1F", *(f"{signal}:{n}F" for signal in signals)]))
    known = np.flatnonzero(np.isfinite(run["joint_angles"]).all(axis=1))
    shown = times[known]
    nth = np.floor((shown - shown[0] + 1e-9) * _MOST_PER_SECOND) if len(shown) else shown
    known = known[np.append(True, np.diff(nth) > 0)] if len(shown) else known
    rows = np.column_stack([times, *(run[signal] for signal in signals)])[known]
    with RecordingWriter(path, about={}, overwrite=True) as writer:
        writer.add_source(
            source,
            kind="udp",
            declared={"structure": structure.text},
            events=structure.events,
            size=structure.size,
        )
        begin = writer.clock.monotonic_ns / 1e9
        for row in rows:
            writer.write_raw(source, row.tobytes(), begin + row[0] - times[0])
