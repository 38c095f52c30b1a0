"""Two runs of a robot in one picture: arrows on the difference, a double for the other one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..assemble.double import Double
from ..assemble.robot import SerialRobot
from ..assemble.robot_parts import BillboardLine
from ..assemble.scene import Scene
from ..receive.structure import Structure
from ..runs.run_log import TIME
from ..runs.run_source import FinishedRun, RunSource
from .align import Pair

Array = NDArray[np.float64]

_MAX_RATE = 240.0  # rows per second; more than any film shows
_GREEN = np.array([0.10, 0.62, 0.30, 0.42])


def compare_scene(pair: Pair) -> Scene:
    """A scene that plays both runs on one clock.

    Arrows show the torques of the first run less those of the second; the robot stands as in the
    first, and a transparent double as in the second.
    """
    robot = pair.robot.name
    other = "b" if robot != "b" else "second"
    routes = {
        f"{robot}.joint_angles": "a.joint_angles",
        f"{other}.joint_angles": "b.joint_angles",
    }
    if "torques" in pair.signals:
        routes |= {f"{robot}.commanded_torques": "a.torques", f"{robot}.torques": "b.torques"}
    return Scene(
        robots=[_shown(pair.robot)],
        doubles=[Double(name=other, of=robot, rgba=_GREEN)],
        sources={
            source: RunSource(name=source, run=_run(name, pair.times, signals))
            for source, name, signals in zip(("a", "b"), pair.names, (pair.a, pair.b), strict=True)
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


def _run(name: str, times: Array, signals: Mapping[str, Array]) -> FinishedRun:
    """One of the runs, with no more rows than a film shows, from the time that both begin at."""
    shown = [signal for signal in ("joint_angles", "torques") if signal in signals]
    n = signals["joint_angles"].shape[1]
    structure = Structure(" ".join([f"{TIME}:1F", *(f"{signal}:{n}F" for signal in shown)]))
    known = np.flatnonzero(np.isfinite(signals["joint_angles"]).all(axis=1))
    nth = np.floor((times[known] - times[0] + 1e-9) * _MAX_RATE)
    known = known[np.diff(nth, prepend=-1.0) > 0]
    rows = np.column_stack([times - times[0], *(signals[signal] for signal in shown)])[known]
    return FinishedRun(f"run {name}", structure, rows)
