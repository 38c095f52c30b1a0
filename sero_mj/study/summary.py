"""Summarizes the torques, errors, saturation and findings of each joint in a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.frames import Array
from ..base.reduction import peak, rms
from ..robots.declared.torque_units import NM, TorqueUnit, torque_units
from ..simulate.runs.run_log import RunLog, torque_error
from .compare import MANY_JOINTS, MAX_SHOWN, shown_as, unit_of

if TYPE_CHECKING:
    from rich.table import Table

    from ..simulate.runs.monitor import Finding


_ZERO = 5e-4  # limit below which numbers are printed as 0, in the unit of the table
_USED = ("torques", "commanded_torques", "target_angles", "saturated", "actual_angles")


@dataclass(frozen=True)
class JointSummary:
    """The summary of a joint in a run. Peaks are signed values of the largest magnitude.

    Attributes:
        torque_unit: `Nm` or `N`.
        angle_unit: `rad` or `m`.
        peak_torque_error: peak of commanded minus measured torque.
        peak_torque_error_at: time of the peak torque error, s.
        rms_torque_error: root mean square of the torque error over time.
        peak_torque: peak of the measured torque.
        peak_share: magnitude of the peak torque as a share of the limit.
        torque_limit: torque limit, N or Nm.
        peak_position_error: peak of target minus actual joint value; the actual value is the true
            value if known, otherwise the measured value.
        saturated_share: share of the time with a saturated command.
        findings: number of findings of the monitor.
        first_finding: kind of the first finding.
        first_finding_at: time of the first finding, s.
    """

    robot: str
    joint: str
    torque_unit: str
    angle_unit: str
    peak_torque_error: float | None = None
    peak_torque_error_at: float | None = None
    rms_torque_error: float | None = None
    peak_torque: float | None = None
    peak_share: float | None = None
    torque_limit: float | None = None
    peak_position_error: float | None = None
    saturated_share: float | None = None
    findings: int = 0
    first_finding: str | None = None
    first_finding_at: float | None = None


def summarise(log: RunLog, findings: Iterable[Finding] = ()) -> list[JointSummary]:
    """Returns a summary of each joint of each robot in a run; signals may be missing."""
    found = sorted(findings, key=lambda finding: finding.time)
    rows = []
    for robot, declared in log.robots.items():
        has = {signal: log.has(robot, signal) for signal in _USED}
        limits = log.torque_limits(robot)
        error = torque_error(log, robot) if has["torques"] and has["commanded_torques"] else None
        position = None
        if has["target_angles"]:
            angles = log.of(robot, "actual_angles" if has["actual_angles"] else "joint_angles")
            position = log.of(robot, "target_angles") - angles
        for k, joint in enumerate(declared.names):
            mine = [f for f in found if f.robot == robot and f.joint == joint]
            values: dict[str, Any] = {"findings": len(mine)}
            if np.isfinite(limits[k]):
                values["torque_limit"] = float(limits[k])
            if mine:
                values |= {"first_finding": mine[0].kind, "first_finding_at": mine[0].time}
            if error is not None and (row := peak(error[:, k])) is not None:
                values["peak_torque_error"] = float(error[row, k])
                values["peak_torque_error_at"] = float(log.times[row])
                values["rms_torque_error"] = rms(error[:, k])
            if has["torques"]:
                highest = values["peak_torque"] = _signed_peak(log.of(robot, "torques")[:, k])
                if highest is not None and np.isfinite(limits[k]):
                    values["peak_share"] = abs(highest) / float(limits[k])
            if position is not None:
                values["peak_position_error"] = _signed_peak(position[:, k])
            if has["saturated"] and len(log.times):
                values["saturated_share"] = float(np.mean(log.of(robot, "saturated")[:, k] > 0.5))
            kind = declared.types[k]
            rows.append(JointSummary(robot, joint, unit_of("torques", kind),
                                     unit_of("joint_angles", kind), **values))  # fmt: skip
    return rows


def as_json(rows: Sequence[JointSummary]) -> list[dict[str, Any]]:
    """Returns the summaries as JSON types, in SI units."""
    return [asdict(row) for row in rows]


def as_table(rows: Sequence[JointSummary], title: str = "") -> Table:
    """Returns a table of summaries for the terminal, with angles in degrees.

    Empty columns are omitted. For a robot with many joints, only the joints with the largest shares
    of their limits are shown.
    """
    from rich import box
    from rich.table import Table

    count, units = len(rows), _torque_units(rows)
    rows = _most_loaded(rows)
    several = len({row.robot for row in rows}) > 1
    table = Table(title=title or None, title_justify="left", title_style="bold",
                  box=box.SIMPLE_HEAD, padding=(0, 0, 0, 1),
                  caption_justify="left")  # fmt: skip
    table.add_column("joint", no_wrap=True)
    columns = [
        (heading, [cell(row, units[row.robot, row.joint]) for row in rows])
        for heading, cell in _COLUMNS
    ]
    columns = [_with_unit_above(*column) for column in columns if any(column[1])]
    for heading, _ in columns:
        table.add_column(heading, justify="right", no_wrap=True)
    for i, row in enumerate(rows):
        name = f"{row.robot}/{row.joint}" if several else row.joint
        table.add_row(name, *(cells[i] or "-" for _, cells in columns))
    if len(rows) < count:
        table.caption = f"the {len(rows)} most loaded of {count} joints; --json prints all"
    return table


def _most_loaded(rows: Sequence[JointSummary]) -> list[JointSummary]:
    shown: set[int] = set()
    for robot in {row.robot for row in rows}:
        mine = [i for i, row in enumerate(rows) if row.robot == robot]
        if len(mine) > MANY_JOINTS:
            mine = sorted(mine, key=lambda i: -(rows[i].peak_share or 0.0))[:MAX_SHOWN]
        shown.update(mine)
    return [rows[i] for i in sorted(shown)]


def _torque_units(rows: Sequence[JointSummary]) -> dict[tuple[str, str], TorqueUnit]:
    units: dict[tuple[str, str], TorqueUnit] = {}
    for robot in {row.robot for row in rows}:
        mine = [row for row in rows if row.robot == robot]
        limits = np.array([row.torque_limit or np.inf for row in mine])
        found = torque_units(limits, [row.torque_unit == NM.name for row in mine])
        units |= {(robot, row.joint): unit for row, unit in zip(mine, found, strict=True)}
    return units


def _signed_peak(values: Array) -> float | None:
    row = peak(values)
    return None if row is None else float(values[row])


def _with_unit(value: float | None, unit: tuple[float, str], form: str) -> str:
    if value is None:
        return ""
    factor, shown = unit
    number = factor * value
    if abs(number) < _ZERO:
        return f"0 {shown}"
    return f"{number:{'+.0f' if abs(number) >= 1000.0 else form}} {shown}"


def _with_unit_above(heading: str, cells: list[str]) -> tuple[str, list[str]]:
    units = {cell.rpartition(" ")[2] for cell in cells if cell}
    if len(units) > 1 or "s" in units:
        return heading, cells
    return f"{heading}\n{units.pop()}", [cell.rpartition(" ")[0] for cell in cells]


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100.0 * value:.1f} %"


def _found(row: JointSummary) -> str:
    return f"{row.findings}, {row.first_finding_at:.3f} s" if row.findings else ""


_COLUMNS: tuple[tuple[str, Callable[[JointSummary, TorqueUnit], str]], ...] = (
    ("error\npeak", lambda row, unit: _with_unit(row.peak_torque_error, unit, "+.3g")),
    ("error\nrms", lambda row, unit: _with_unit(row.rms_torque_error, unit, ".3g")),
    ("torque\npeak", lambda row, unit: _with_unit(row.peak_torque, unit, "+.3g")),
    ("of\nlimit", lambda row, _: _percent(row.peak_share)),
    (
        "position\nerror",
        lambda row, _: _with_unit(row.peak_position_error, shown_as(row.angle_unit), "+.3g"),
    ),
    ("time\nsaturated", lambda row, _: _percent(row.saturated_share)),
    ("faults,\nfirst at", lambda row, _: _found(row)),
)
