"""Compares two runs of a robot joint by joint, and builds a scene that plays both."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.frames import Array
from ..base.reduction import peak, rms
from ..data.receive.structure import Structure
from ..data.record.csv_files import csv_table
from ..robots.declared.double import Double
from ..robots.declared.robot import SerialRobot
from ..robots.declared.robot_parts import BillboardLine
from ..robots.declared.scene import Scene
from ..simulate.runs.run_log import TIME
from ..simulate.runs.run_source import FinishedRun, RunSource
from .align import Pair
from .explanation import Explanation

if TYPE_CHECKING:
    from rich.table import Table


_MAX_RATE = 240.0  # maximum rows per second, above the frame rate of videos
_GREEN = np.array([0.10, 0.62, 0.30, 0.42])
# For robots with more joints, tables show only the joints that differ most; files contain all.
MANY_JOINTS, MAX_SHOWN = 24, 12
_IN_TABLE = ("joint_angles", "torques")  # the JSON contains all signals


@dataclass(frozen=True)
class Difference:
    """The difference between two runs (first minus second) in one signal of one joint.

    Attributes:
        signal: name: `joint_angles`, `joint_velocities`, `torques` or `commanded_torques`.
        unit: unit of the signal: rad, m, rad/s, m/s, Nm or N.
        peak: signed difference of the largest magnitude; NaN if unknown.
        at: time of the peak, s.
        rms: root mean square of the difference over time.
    """

    joint: str
    signal: str
    unit: str
    peak: float
    at: float
    rms: float


@dataclass(frozen=True)
class Exceeded:
    """A difference above its tolerance."""

    difference: Difference
    tolerance: float

    def __str__(self) -> str:
        found, factor, unit = self.difference, *shown_as(self.difference.unit)
        what = "torque" if found.signal == "torques" else "angle"
        peak, allowed = factor * abs(found.peak), factor * self.tolerance
        return f"{found.joint}: {what} differs by {peak:.4g} {unit} at {found.at:.3f} s; " \
               f"tolerance {allowed:.4g} {unit}"  # fmt: skip


def compare(pair: Pair) -> list[Difference]:
    """Returns the difference of each joint in each signal that both runs have."""
    found = []
    for signal in pair.signals:
        difference = pair.difference(signal)
        for k, joint in enumerate(pair.robot.names):
            unit = unit_of(signal, pair.robot.types[k])
            found.append(_difference(joint, signal, unit, pair.times, difference[:, k]))
    return found


def unit_of(signal: str, joint_type: str) -> str:
    """Returns the unit of a signal for a joint type."""
    is_revolute = joint_type == "revolute"
    if signal.endswith("torques"):
        return "Nm" if is_revolute else "N"
    length = "rad" if is_revolute else "m"
    return f"{length}/s" if signal.endswith("velocities") else length


def one_unit(units: Iterable[str]) -> str:
    """Returns the unit if all units are equal, otherwise an empty string."""
    first, *others = dict.fromkeys(units)
    return "" if others else first


def _difference(joint: str, signal: str, unit: str, times: Array, values: Array) -> Difference:
    row = peak(values)
    if row is None:
        return Difference(joint, signal, unit, np.nan, np.nan, np.nan)
    return Difference(joint, signal, unit, float(values[row]), float(times[row]), rms(values))


def differ_most(pair: Pair) -> list[str]:
    """Returns the names of the joints to show, in order.

    For robots with many joints, these are the joints with the largest peak torque difference as a
    share of the torque limit, or with the largest angle difference if there are no torques.
    """
    names = pair.robot.names
    if len(names) <= MANY_JOINTS:
        return names
    signal = "torques" if "torques" in pair.signals else "joint_angles"
    if signal not in pair.signals:
        return names[:MAX_SHOWN]
    peaks = np.nan_to_num(np.abs(pair.difference(signal))).max(axis=0, initial=0.0)
    limits = pair.robot.torque_bounds if signal == "torques" else np.ones(len(names))
    shares = peaks / np.where(np.isfinite(limits), limits, max(peaks.max(), 1e-9))
    return [names[k] for k in np.sort(np.argsort(-shares, kind="stable")[:MAX_SHOWN])]


def exceeded(
    differences: Sequence[Difference],
    *,
    torque: float | None = None,
    angle: float | None = None,
    travel: float | None = None,
) -> list[Exceeded]:
    """Returns the differences of measured torques and angles that exceed a tolerance.

    Tolerances are in Nm and rad, or in N and m for prismatic joints. NaN exceeds every tolerance.
    A tolerance of None allows any difference.
    """
    found = []
    for each in differences:
        of_joint = travel if each.unit == "m" else angle
        tolerance = {"torques": torque, "joint_angles": of_joint}.get(each.signal)
        if tolerance is not None and not abs(each.peak) <= tolerance:
            found.append(Exceeded(each, tolerance))
    return found


def as_json(
    pair: Pair,
    differences: Sequence[Difference],
    explanations: Sequence[Explanation] | None = None,
) -> dict[str, Any]:
    """Returns the comparison as JSON types."""
    return {
        "a": pair.names[0],
        "b": pair.names[1],
        "robot": pair.robot.name,
        "offset": pair.offset,
        "correlation": pair.correlation,
        "begin": float(pair.times[0]),
        "end": float(pair.times[-1]),
        "rows": len(pair.times),
        "differences": [asdict(each) for each in differences],
        "explanations": None if explanations is None else [
            _explanation_as_json(each) for each in explanations
        ],
    }  # fmt: skip


def _explanation_as_json(explanation: Explanation) -> dict[str, Any]:
    evidence = explanation.evidence
    found = asdict(replace(explanation, evidence=None))
    of_rows = None if evidence is None else evidence.as_json()
    return {**found, "evidence": of_rows, "text": str(explanation)}


def as_table(pair: Pair, differences: Sequence[Difference]) -> Table:
    """Returns a table of the differences for the terminal, with angles in degrees."""
    from rich import box
    from rich.table import Table

    span = f"{pair.times[0]:.3f} s to {pair.times[-1]:.3f} s"
    title = f"{pair.names[0]} minus {pair.names[1]}: {pair.robot.name}, {span}"
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
                  min_width=len(title), caption_justify="left")  # fmt: skip
    table.add_column("joint", no_wrap=True)
    shown = [signal for signal in _IN_TABLE if signal in pair.signals] or pair.signals
    if pair.has_one_motion:
        shown = [signal for signal in shown if signal != "joint_angles"]
    for signal in shown:
        unit = one_unit(unit for _, unit in shown_units(pair.robot, signal))
        unit = unit and f", {unit}"
        table.add_column(f"{signal.replace('_', ' ')}\nrms{unit}", justify="right")
        table.add_column(f"peak{unit}", justify="right")
        table.add_column("at, s", justify="right")
    joints = differ_most(pair)
    if len(joints) < pair.robot.n:
        table.caption = f"the {len(joints)} of {pair.robot.n} joints that differ most"
    for joint in joints:
        cells = [joint]
        for each in differences:
            if each.joint == joint and each.signal in shown:
                units = shown_units(pair.robot, each.signal)
                factor, unit = units[pair.robot.names.index(joint)]
                unit = "" if one_unit(name for _, name in units) else f" {unit}"
                if np.isnan(each.peak):
                    cells += ["no data", "", ""]
                    continue
                peak = f"{factor * each.peak:+.3g}{unit}"
                cells += [f"{factor * each.rms:.3g}{unit}", peak, f"{each.at:.3f}"]
        table.add_row(*cells)
    return table


def explanations_table(pair: Pair, explanations: Sequence[Explanation]) -> Table:
    """Returns a table for the terminal with a row for every joint and explanation."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("joint", no_wrap=True)
    table.add_column("explanation of the difference")
    table.add_column("time")
    table.add_column("confidence", justify="right")
    listed: list[Explanation] = []
    explained = {joint for each in explanations for joint in each.joints}
    shown = {*explained, *differ_most(pair)}
    for joint in [name for name in pair.robot.names if name in shown]:
        name = joint
        for each in explanations:
            if joint in each.joints:
                confidence = f"{100.0 * each.confidence:.0f} %"
                text = f"{each.short}, see above" if each in listed else each.text
                if each.alternatives and each not in listed:
                    text += f"\n{each.or_else}"
                table.add_row(name, text, each.when, confidence)
                name = ""
                listed.append(each)
        if name:
            known = "torques" in pair.signals and np.isfinite(
                pair.difference("torques")[:, pair.robot.names.index(name)]
            ).any()  # fmt: skip
            table.add_row(name, "no difference found" if known else "no torque data", "", "")
    return table


def next_lines(explanations: Sequence[Explanation]) -> list[str]:
    """Returns a line for each next experiment, with the explanations that it decides about."""
    wanted: dict[str, list[str]] = {}
    for each in explanations:
        if each.next:
            known = each.kind != "unexplained"  # others are only similar
            causes = ", or ".join((each.kind, *(each.alternatives if known else ())))
            wanted.setdefault(each.next, []).append(f"{each.joint} ({causes})")
    return [f"next for {', '.join(dict.fromkeys(faults))}: {text}"
            for text, faults in wanted.items()]  # fmt: skip


def shown_as(unit: str) -> tuple[float, str]:
    """Returns the factor from an SI unit to the displayed unit (degrees or mm), and this unit."""
    if unit.startswith("rad"):
        return float(np.rad2deg(1.0)), unit.replace("rad", "deg")
    if unit.startswith("m"):
        return 1e3, unit.replace("m", "mm", 1)
    return 1.0, unit


def shown_units(robot: SerialRobot, signal: str) -> Sequence[tuple[float, str]]:
    """Returns the factor from SI units to the displayed unit, and this unit, for each joint."""
    if signal.endswith("torques"):
        return robot.torque_units
    return [shown_as(unit_of(signal, kind)) for kind in robot.types]


def write_csv(pair: Pair, path: Path | str) -> None:
    """Writes both runs and their difference as a table with columns such as `torques_A1_diff`."""
    names, columns = ["time"], [pair.times]
    for signal in pair.signals:
        difference = pair.difference(signal)
        for k, joint in enumerate(pair.robot.names):
            for suffix, values in (
                ("a", pair.a[signal]), ("b", pair.b[signal]), ("diff", difference),
            ):  # fmt: skip
                names.append(f"{signal}_{joint}_{suffix}")
                columns.append(values[:, k])
    with csv_table(path) as table:
        table.writerow(names)
        table.writerows(np.column_stack(columns).tolist())


def compare_scene(pair: Pair) -> Scene:
    """Returns a scene that plays both runs on one clock.

    The robot shows the first run, and a transparent double shows the second run. Arrows
    show the torques of the first run minus the torques of the second run.
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
        name=f"{pair.names[0]} minus {pair.names[1]}",
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
    shown = [signal for signal in ("joint_angles", "torques") if signal in signals]
    n = signals["joint_angles"].shape[1]
    structure = Structure(" ".join([f"{TIME}:1F", *(f"{signal}:{n}F" for signal in shown)]))
    known = np.flatnonzero(np.isfinite(signals["joint_angles"]).all(axis=1))
    nth = np.floor((times[known] - times[0] + 1e-9) * _MAX_RATE)
    known = known[np.diff(nth, prepend=-1.0) > 0]
    rows = np.column_stack([times - times[0], *(signals[signal] for signal in shown)])[known]
    return FinishedRun(f"run {name}", structure, rows)
