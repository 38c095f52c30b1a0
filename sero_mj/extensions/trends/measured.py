"""`Measured`: the parameters of a robot in one recording, for trends over many recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from ...base.frames import Array
from ...base.reduction import rms
from ...data.record.csv_files import is_table
from ...data.record.formats import look_into
from ...simulate.runs.run_log import RunLog, event_of, torque_error
from ...study.compare import unit_of
from ...study.explanation import Parameter, find_explainer

_MIN_CHANGE = 1e-3  # share of the torque limit, smallest change of a torque error that matters
_MIN_HEATING = 5.0  # smallest change of a temperature that matters, K
DEGREES = "°C"
# Motions differ if a mean angle (rad or m) or the rms velocity, as a share of that of the fastest
# joint, differs by more.
_OTHER_ANGLE, _OTHER_SPEED = 0.1, 0.2
_FIRST_YEAR = 2000  # of a clock that was set


def date_of(path: Path) -> tuple[datetime, bool]:
    """Returns the local start time of a recording, and whether it is the date of the file.

    Tables contain no date, and some robots have no clock. In these cases, the time of the last
    modification of the file is used.
    """
    start = None if is_table(path) else look_into(path).start
    if start is not None and start.year >= _FIRST_YEAR:
        return start.astimezone(), False
    return datetime.fromtimestamp(path.stat().st_mtime).astimezone(), True


@dataclass(frozen=True)
class Measured:
    """A recording of a robot and its parameters.

    Attributes:
        date: local start time, see `date_of`.
        is_date_of_file: whether the date is that of the file.
        joints: names of the joints.
        parameters: parameters, always in the same order.
        motion: mean angle (rad or m) and rms velocity of each joint, shape (2, n).
    """

    path: str
    date: datetime
    is_date_of_file: bool
    robot: str
    joints: Sequence[str]
    parameters: Sequence[Parameter]
    motion: Array


def measure(path: Path, log: RunLog, robot: str) -> Measured:
    """Returns the parameters of a robot in a recording.

    These are the parameters of the installed explainer, the root mean square of commanded minus
    measured torques, and the mean of each input whose name contains `temperature`.

    Raises:
        UsageError: the explainer rejects the run, for example because it is too short.
    """
    date, is_of_file = date_of(path)
    angles, velocities = log.of(robot, "joint_angles"), log.of(robot, "joint_velocities")
    motion = np.array([np.nanmean(angles, axis=0), [rms(each) for each in velocities.T]])
    joints, parameters = log.robots[robot].names, _parameters(log, robot)
    return Measured(str(path), date, is_of_file, robot, joints, parameters, motion)


def _parameters(log: RunLog, robot: str) -> list[Parameter]:
    explainer = find_explainer()
    found = [] if explainer is None else explainer.parameters(log, robot)
    declared = log.robots[robot]
    has = log.has(robot, "torques") and log.has(robot, "commanded_torques")
    errors = torque_error(log, robot) if has else None
    for k, joint in enumerate(declared.names):
        value = np.nan if errors is None else rms(errors[:, k])
        reason = None if has else "the run has no measured or no commanded torques"
        limit = float(log.torque_limits(robot)[k])
        least = _MIN_CHANGE * limit if np.isfinite(limit) else 0.0
        unit = unit_of("torques", declared.types[k])
        found.append(
            Parameter(joint, "rms_torque_error", unit, _number(value), None, reason, least)
        )
    for name in declared.inputs:
        if "temperature" in name and event_of(robot, name) in log.signals:
            values = np.ma.masked_invalid(log.of(robot, name)).mean(axis=0).filled(np.nan)
            found += [
                Parameter(
                    joint, name.removesuffix("s"), DEGREES, _number(value), min_change=_MIN_HEATING
                )
                for joint, value in zip(declared.names, values, strict=True)
            ]
    order = {joint: k for k, joint in enumerate(declared.names)}
    return sorted(found, key=lambda each: order.get(each.joint, declared.n))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def why_not(run: Measured, baseline: Measured) -> str:
    """Returns the reason why a recording cannot be compared with the baseline, or an empty text."""
    if run.joints != baseline.joints:
        joints, expected = ", ".join(run.joints), ", ".join(baseline.joints)
        return f"{run.robot} has the joints {joints}; the baseline has {expected}"
    known = {each.key for each in run.parameters if each.value is not None}
    if not any(each.key in known for each in baseline.parameters if each.value is not None):
        return "; ".join(_missing(run, baseline)) or "no parameter in common with the baseline"
    return ""


def notes_of(baseline: Measured, runs: Sequence[Measured]) -> list[str]:
    """Returns sentences about incomplete recordings, dates of files, and other motions."""
    notes = [f"{run.path}: {why}" for run in runs for why in _missing(run, baseline)]
    if of_files := [run for run in (baseline, *runs) if run.is_date_of_file]:
        notes.append(f"no start time in {_named(of_files)}: the date is that of the file")
    if moved := [run for run in runs if _is_other_motion(run.motion, baseline.motion)]:
        why = "parameters may differ because of the motion"
        notes.append(f"another motion than in the baseline in {_named(moved)}: {why}")
    return notes


def _missing(run: Measured, baseline: Measured) -> list[str]:
    # Parameters that only the baseline has, grouped by the reason.
    expected = {each.key for each in baseline.parameters if each.value is not None}
    names: dict[str, dict[str, None]] = {}
    for each in run.parameters:
        if each.key in expected and each.value is None:
            names.setdefault(each.reason or "no data", {})[each.label] = None
    return [f"no {', '.join(named)}: {reason}" for reason, named in names.items()]


def _is_other_motion(motion: Array, reference: Array) -> bool:
    angles, speeds = np.abs(motion - reference)
    is_faster = bool((speeds > _OTHER_SPEED * reference[1].max()).any())
    return is_faster or bool((angles > _OTHER_ANGLE).any())


def _named(runs: Sequence[Measured]) -> str:
    more = f" and {len(runs) - 1} more" if len(runs) > 1 else ""
    return f"{Path(runs[0].path).name}{more}"
