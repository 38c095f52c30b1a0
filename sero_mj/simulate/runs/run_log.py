"""`RunLog`: the signals of a run, one row per step. Each row is also a packet."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ...base.errors import UsageError
from ...base.frames import Array
from ...data.receive.structure import Structure
from ...robots.declared.robot import SerialRobot

# Signals per joint of every robot, in blocks as in the plant's arrays.
MEASURED = ("joint_angles", "joint_velocities", "torques")
ACTUAL = ("actual_angles", "actual_velocities", "actual_torques")
DRIVEN = ("commanded_torques", "saturated")
TARGETS = ("target_angles", "target_velocities")
ESTIMATED = ("external_torques",)
PER_JOINT = (*MEASURED, *ACTUAL, *DRIVEN, *TARGETS, *ESTIMATED)
TIME = "time"


# Old names of signals in recordings and tables.
_OLD_NAMES = {"joint_angles": "angles", "joint_velocities": "velocities"}


def event_of(robot: str, signal: str) -> str:
    """Returns the name of a robot's signal in routes and recordings."""
    return f"{robot.replace('-', '_')}_{signal}"


def recorded_event(event: str, recorded: Collection[str]) -> str:
    """Returns an event's name in a recording or a table, which may have old names.

    For example, it returns `lwr_angles` if `lwr_joint_angles` is not recorded.
    """
    for signal, old in _OLD_NAMES.items():
        if event.endswith(f"_{signal}") and event not in recorded:
            found = f"{event.removesuffix(signal)}{old}"
            if found in recorded:
                return found
    return event


class RunLayout:
    """The columns of a log, whose rows consist of float64 numbers.

    Args:
        joints: number of joints by robot name, in the order of the world.
        targets: names of the robots with columns for targets.
        others: count and kind of additional events by name, for example `{"push_force": "1V"}`.

    Attributes:
        structure: packet structure of a row. Matrices are row-major.
        width: number of values in a row.
        columns: slices of columns by event name.
    """

    def __init__(
        self,
        joints: Mapping[str, int],
        targets: tuple[str, ...] = (),
        others: Mapping[str, str] | None = None,
    ) -> None:
        parts = [f"{TIME}:1F"]
        for signal in PER_JOINT:
            names = targets if signal in TARGETS else joints
            parts += [f"{event_of(name, signal)}:{joints[name]}F" for name in names]
        parts += [f"{event}:{kind}" for event, kind in (others or {}).items()]
        self.joints = dict(joints)
        self.targets = targets
        self.structure = Structure(" ".join(parts), column_major=False)
        self.width = self.structure.size // 8
        self.columns = {
            item.name: slice(item.offset // 8, item.end // 8) for item in self.structure.fields
        }

    def block(self, signals: tuple[str, ...]) -> slice:
        """Returns the contiguous columns of adjacent signals of all robots."""
        found = [
            self.columns[event_of(name, signal)]
            for signal in signals
            for name in (self.targets if signal in TARGETS else self.joints)
        ]
        return slice(found[0].start, found[-1].stop) if found else slice(0, 0)


@dataclass(frozen=True, eq=False)
class RunLog:
    """The log of a simulation run, or of a recorded run of simulated or real robots.

    Row 0 is the initial state. The torques in a row acted in the step that led to this row.

    Attributes:
        robots: robots by name.
        signals: values by event name, shape (T, n) for joints, (T, 3) for vectors and (T, 4, 4) for
            matrices. Signals that real robots do not have (`actual_...`) may be missing.
        times: times of the rows, shape (T,), s.
        name: name in titles.
        derived: cache of computed values.
    """

    robots: Mapping[str, SerialRobot]
    signals: Mapping[str, Array]
    times: Array
    name: str = "run"
    derived: dict[object, Array] = field(default_factory=dict, repr=False)

    @classmethod
    def from_rows(
        cls, layout: RunLayout, rows: Array, robots: Mapping[str, SerialRobot], name: str = "run"
    ) -> RunLog:
        """Returns a log whose signals are views of `rows`, shape (T, width)."""
        signals = {}
        for event, columns in layout.columns.items():
            shape = layout.structure.events[event]
            values = rows[:, columns]
            if len(shape) == 3:
                values = values.reshape(-1, 4, 4)
            elif len(shape) == 2:
                values = values.reshape(-1, 3)
            signals[event] = values
        return cls(robots, signals, rows[:, 0], name)

    def has(self, robot: str, signal: str) -> bool:
        return event_of(robot, signal) in self.signals

    def of(self, robot: str, signal: str) -> Array:
        """Returns a robot's signal, shape (T, n). Raises KeyError if it is missing."""
        return self.signals[event_of(robot, signal)]

    def between(self, begin: float | None, end: float | None) -> RunLog:
        """Returns the rows between two times in seconds, both included. None sets no limit.

        Raises:
            UsageError: there are no rows between these times.
        """
        rows = np.ones(len(self.times), bool)
        bounds = []
        if begin is not None:
            rows &= self.times >= begin
            bounds.append(f"from {begin:g} s")
        if end is not None:
            rows &= self.times <= end
            bounds.append(f"to {end:g} s")
        if not rows.any():
            has = ""
            if len(self.times):
                has = f"; it lasts from {self.times[0]:g} s to {self.times[-1]:g} s"
            raise UsageError(f"run {self.name} has no rows {' '.join(bounds)}{has}")
        signals = {event: values[rows] for event, values in self.signals.items()}
        return RunLog(self.robots, signals, self.times[rows], self.name)

    def torque_error(self, robot: str) -> Array:
        """Returns commanded minus measured torque, shape (T, n), Nm."""
        return np.asarray(self.of(robot, "commanded_torques") - self.of(robot, "torques"))

    def unit_at(self, unit: str, robot: str, joint: str) -> str:
        """Returns a unit (Nm, rad, rad/s), or for a prismatic joint its counterpart (N, m, m/s)."""
        declared = self.robots[robot]
        if declared.types[declared.names.index(joint)] == "revolute":
            return unit
        return unit.replace("Nm", "N").replace("rad", "m")

    def torque_limits(self, robot: str) -> Array:
        """Returns torque limits, shape (n,), Nm; infinite if there are none."""
        return self.robots[robot].torque_bounds

    @cached_property
    def timestep(self) -> float:
        """Median time between two rows, s."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0


def routes_from_recording(
    routes: Mapping[str, Any], source: str, recorded: Collection[str]
) -> dict[str, Any]:
    """Returns routes with the event names in a recording, which may be old names."""

    def rename(match: re.Match[str]) -> str:
        return f"{source}.{recorded_event(match[1], recorded)}"

    event = re.compile(rf"\b{re.escape(source)}\.(\w+)")
    return {
        target: event.sub(rename, origin) if isinstance(origin, str) else origin
        for target, origin in routes.items()
    }


def commanded_torques(log: RunLog, robot: str) -> Array:
    """Returns commanded torques, shape (T, n), Nm, with NaN in a first row without a command.

    Logs have zeros before the first command, which would often cause the largest torque error.

    Raises:
        KeyError: commanded torques are missing.
    """
    commanded = log.of(robot, "commanded_torques")
    if len(commanded) == 0 or commanded[0].any():
        return commanded
    commanded = commanded.copy()
    commanded[0] = np.nan
    return commanded


def torque_error(log: RunLog, robot: str) -> Array:
    """Returns commanded minus measured torques, (T, n), Nm. Raises KeyError if one is missing."""
    return np.asarray(commanded_torques(log, robot) - log.of(robot, "torques"))


def compared_signal(log: RunLog, robot: str, signal: str) -> Array:
    """Returns a signal of a robot, shape (T, n). Commanded torques are as in `commanded_torques`.

    Raises:
        KeyError: the signal is missing.
    """
    if signal == "commanded_torques":
        return commanded_torques(log, robot)
    return log.of(robot, signal)
