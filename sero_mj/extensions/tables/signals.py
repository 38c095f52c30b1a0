"""Finds the columns of a table that are signals of a robot's joints.

Columns are recognized by common names of robot libraries and ROS, by joint names, and by units.
They can also be declared: `joint_angles = "A* [rad]"`.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from ...base.errors import (
    CsvError,
    Problem,
    did_you_mean,
    mismatch,
)
from ...base.frames import Array
from ...base.plugins import COLUMNS, load_all
from ...data.record.csv_files import TIME, Columns
from ...simulate.runs.tables import ColumnNames
from .table import Table, split_unit

# Names of columns by signal, in lower case, without number, joint name and unit. The first name
# takes precedence. `position` and `effort` are from ROS.
_NAMES: Mapping[str, tuple[str, ...]] = {
    "joint_angles": (
        "joint_angles", "joint_angle", "angles", "angle", "q", "joint_positions", "joint_position",
        "measured_joint_positions", "positions", "position", "joints", "joint",
    ),
    "joint_velocities": (
        "joint_velocities", "joint_velocity", "velocities", "velocity", "dq", "qd",
    ),
    "torques": (
        "torques", "torque", "joint_torques", "joint_torque", "measured_torques", "tau", "efforts",
        "effort",
    ),
    "commanded_torques": ("commanded_torques", "commanded_torque"),
    "commanded_angles": ("commanded_angles", "commanded_angle", "target_angles"),
    "external_torques": ("external_torques", "external_torque", "tau_ext"),
}  # fmt: skip
_FACTORS = {
    "rad": 1.0, "deg": np.pi / 180.0, "°": np.pi / 180.0, "degree": np.pi / 180.0,
    "degrees": np.pi / 180.0, "mrad": 1e-3, "m": 1.0, "mm": 1e-3, "rad/s": 1.0,
    "deg/s": np.pi / 180.0, "°/s": np.pi / 180.0, "m/s": 1.0, "mm/s": 1e-3, "Nm": 1.0, "mNm": 1e-3,
    "N": 1.0,
}  # fmt: skip
# Units that identify a signal if only one group of columns has them.
_BY_UNIT = {
    "joint_angles": ("rad", "deg", "°", "degree", "degrees"),
    "joint_velocities": ("rad/s", "deg/s", "°/s"),
    "torques": ("Nm", "mNm"),
}
_NUMBER = re.compile(r"\d+(?!.*\d)")
_SUFFIX = re.compile(r"_(rad|deg|nm)$", re.IGNORECASE)
_BETWEEN = "[]()._/ "  # characters between the number and the rest of a name
_SIGNAL = re.compile(r"([A-Za-z_]\w*)(?:\s*\[\s*(.+?)\s*\])?")
_MANY = 8  # maximum number of columns in a message

log = logging.getLogger(__name__)


@cache
def _known_names() -> ColumnNames:
    found = load_all(COLUMNS).values()
    names = {
        signal: sum((each.names.get(signal, ()) for each in found), own)
        for signal, own in _NAMES.items()
    }
    opposite = sum((each.opposite for each in found), ())
    return ColumnNames(names, opposite, sum((each.prefixes for each in found), ()))


@dataclass(frozen=True)
class Selection:
    """The columns of a signal, and the factor to SI units and the usual sign convention."""

    names: tuple[str, ...]
    factor: float = 1.0


@dataclass(frozen=True)
class _Group:
    """Columns whose names differ only by a number or a joint name, `*` in the pattern."""

    stem: str
    unit: str
    pattern: str
    names: tuple[str, ...]


def signals_of(
    table: Table,
    joints: Sequence[str] = (),
    columns: Columns | None = None,
    *,
    robot: str = "",
    counts: Sequence[int] = (),
) -> dict[str, Array]:
    """Returns the joint signals of a robot in a table; raises CsvError or DeclarationError.

    Args:
        table: table of one robot, or of several robots whose names precede the column names.
        joints: joint names of the robot; empty to ignore joint names.
        columns: declared columns. Keys are signals, with a unit in brackets if the columns have
            none. Values are names of columns, or a pattern in which `*` is a number or joint name.
            Other signals are recognized.
        counts: allowed numbers of columns of a signal; empty for any.

    Returns:
        Values of signals such as `joint_angles` by name, shape (T, number of columns), in SI units
        and the usual sign convention. If the table has no measured torques, `torques` are the
        commanded torques.
    """
    names = [*table.columns]
    chosen = _recognised(names, joints, robot, counts) | _declared(table, columns or {})
    if "torques" not in chosen and "commanded_torques" in chosen:
        chosen["torques"] = chosen["commanded_torques"]
        _warn_of_commanded(table.path, chosen["torques"].names[0])
    return {
        signal: np.stack([table.column(name) for name in each.names], axis=1) * each.factor
        for signal, each in chosen.items()
    }


@lru_cache(16)  # a table is read several times: for its scene, its routes and its packets
def _warn_of_commanded(path: Path, column: str) -> None:
    text = "%s has no measured torques. The commanded torques are shown instead (%s, ...)"
    log.warning(text, path, column)


def wrong_columns(table: Table, count: int = 0, how: str = "") -> CsvError:
    """Returns the error for a table in which no columns, or too few or many, are joint angles.

    Args:
        count: number of joints of the robot; 0 if unknown.
        how: option that declares columns, such as `--columns "SIGNAL=COLUMNS"`.
    """
    names = [*table.columns]
    expected = f"{count} columns with joint angles" if count else "columns with joint angles"
    other = _recognised(names, (), "", ()).get("joint_angles")
    if count and other is not None and len(other.names) != count:
        first, *_, last = other.names
        reason = f"found joint angles in {len(other.names)} columns, {first} to {last}"
        return CsvError(table.path, f"{reason}; expected {expected}")
    more = ", ..." if len(names) > _MANY else ""
    groups = [each for each in _groups(names, (), "") if count in (0, len(each.names))]
    pattern = groups[0].pattern if groups else "NAME,NAME,..."
    example = how.replace("SIGNAL", "joint_angles").replace("COLUMNS", pattern)
    reason = f"found the columns {', '.join(names[:_MANY])}{more}; expected {expected}"
    return CsvError(table.path, f"{reason}. Declare them with {example}" if example else reason)


def _declared(table: Table, columns: Columns) -> dict[str, Selection]:
    found = {}
    for key, wanted in columns.items():
        if key == TIME:
            continue
        match = _SIGNAL.fullmatch(key)
        if match is None:
            expected = "a signal with an optional unit, such as joint_angles [deg]"
            raise mismatch(key, expected, key="columns")
        signal, unit = match[1], match[2] or ""
        if signal == TIME:
            expected = "time without a unit, as in time = 'Zeit [ms]'"
            raise mismatch(key, expected, key="columns")
        if unit and unit not in _FACTORS:
            of = f"in {key}"
            raise Problem("columns", "no unit", found=unit, of=of, available=_FACTORS).error()
        patterns = [wanted] if isinstance(wanted, str) else wanted
        names = [name for pattern in patterns for name in _matching(table, pattern)]
        units = {split_unit(name)[1] for name in names}
        own = next(iter(units)) if len(units) == 1 else ""
        found[signal] = Selection(tuple(names), _FACTORS.get(unit or own, 1.0))
    return found


def _matching(table: Table, pattern: str) -> list[str]:
    if pattern in table.columns or pattern in table.wrong or "*" not in pattern:
        table.column(pattern)
        return [pattern]
    regex = re.compile(re.escape(pattern).replace(r"\*", "(.+?)"))
    found = {name: match[1] for name in table.columns if (match := regex.fullmatch(name))}
    if not found:
        near = did_you_mean(pattern, table.columns)
        raise CsvError(table.path, f"no column matches '{pattern}'{near}")
    numbered = all(each.isdecimal() for each in found.values())
    return sorted(found, key=lambda name: int(found[name])) if numbered else [*found]


def _recognised(
    names: Sequence[str], joints: Sequence[str], robot: str, counts: Sequence[int]
) -> dict[str, Selection]:
    groups = [
        group for group in _groups(names, joints, robot) if not counts or len(group.names) in counts
    ]
    found: dict[str, Selection] = {}
    all_names = _known_names()
    for signal, known in all_names.names.items():
        ranked = [group for name in known for group in groups if group.stem == name]
        if ranked:
            sign = -1.0 if ranked[0].stem in all_names.opposite else 1.0
            found[signal] = Selection(ranked[0].names, sign * _FACTORS.get(ranked[0].unit, 1.0))
    of_joints = [group for group in groups if not group.stem]
    if "joint_angles" not in found and of_joints:
        unit = of_joints[0].unit
        found["joint_angles"] = Selection(of_joints[0].names, _FACTORS.get(unit, 1.0))
    for signal, units in _BY_UNIT.items():
        alike = [group for group in groups if group.unit in units]
        if signal not in found and len(alike) == 1:
            found[signal] = Selection(alike[0].names, _FACTORS[alike[0].unit])
    return found


def _groups(names: Sequence[str], joints: Sequence[str], robot: str) -> list[_Group]:
    # The columns of each group are in the order of the joints, or of their numbers.
    found: dict[tuple[str, str], dict[int, str]] = {}
    patterns: dict[tuple[str, str], str] = {}
    for name in names:
        plain, unit = split_unit(name)
        if not unit and (suffix := _SUFFIX.search(plain)):
            plain, unit = plain[: suffix.start()], {"nm": "Nm"}.get(suffix[1].lower(), suffix[1])
        place, pattern = _of_joint(plain, joints)
        if place < 0:
            number = _NUMBER.search(plain)
            if number is None:
                continue
            place = int(number[0][:9])
            pattern = f"{plain[: number.start()]}*{plain[number.end() :]}"
        key = _stem(pattern, robot), unit
        found.setdefault(key, {}).setdefault(place, name)
        patterns.setdefault(key, pattern + name[len(plain) :])
    return [
        _Group(stem, unit, patterns[stem, unit], tuple(of[place] for place in sorted(of)))
        for (stem, unit), of in found.items()
    ]


def _of_joint(name: str, joints: Sequence[str]) -> tuple[int, str]:
    # Index of the joint whose name is in a column name, or -1; and the name with `*` instead.
    for joint in sorted(joints, key=len, reverse=True):
        if joint.isdecimal():
            continue
        found = re.search(rf"(?<![^\W_]){re.escape(joint)}(?![^\W_])", name)
        if found is not None:
            return joints.index(joint), f"{name[: found.start()]}*{name[found.end() :]}"
    return -1, ""


def _stem(pattern: str, robot: str) -> str:
    # The pattern without prefixes, robot name and `*`, in lower case.
    for before in (*_known_names().prefixes, *(f"{robot}{each}" for each in "._/" if robot)):
        pattern = pattern.removeprefix(before)
    before, _, behind = pattern.partition("*")
    return (behind.strip(_BETWEEN) or before.strip(_BETWEEN)).lower()
