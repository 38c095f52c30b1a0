"""`RunLog`: the signals of a run, a row for every step; each row is a packet as well."""

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

# Per joint of every robot, in blocks of three that lie in a row as the plant has them.
MEASURED = ("joint_angles", "joint_velocities", "torques")
ACTUAL = ("actual_angles", "actual_velocities", "actual_torques")
DRIVEN = ("commanded_torques", "saturated")
TARGETS = ("target_angles", "target_velocities")
ESTIMATED = ("external_torques",)
PER_JOINT = (*MEASURED, *ACTUAL, *DRIVEN, *TARGETS, *ESTIMATED)
TIME = "time"


# Signals whose events had other names in recordings and tables of before.
_OLD_NAMES = {"joint_angles": "angles", "joint_velocities": "velocities"}


def event_of(robot: str, signal: str) -> str:
    """The event of a robot's signal, as routes and recordings call it."""
    return f"{robot.replace('-', '_')}_{signal}"


def recorded_event(event: str, recorded: Collection[str]) -> str:
    """An event's name among those that a recording or a table has, which may be an old one.

    Returns:
        `lwr_angles` where only that is recorded; else the event as it is.
    """
    for signal, old in _OLD_NAMES.items():
        if event.endswith(f"_{signal}") and event not in recorded:
            found = f"{event.removesuffix(signal)}{old}"
            if found in recorded:
                return found
    return event


class RunLayout:
    """The columns of a log: rows of float64 numbers.

    Args:
        joints: robot name to its number of joints, in the order of the world.
        others: further events and their kind and count: `{"push_force": "1V"}`.

    Attributes:
        structure: of a row as a packet; matrices stand row by row.
        width: numbers in a row.
        columns: event name to its columns.
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
        """The columns of these signals of all robots together; they follow each other."""
        found = [
            self.columns[event_of(name, signal)]
            for signal in signals
            for name in (self.targets if signal in TARGETS else self.joints)
        ]
        return slice(found[0].start, found[-1].stop) if found else slice(0, 0)


@dataclass(frozen=True, eq=False)
class RunLog:
    """A run: of the simulation, of a recording of it, or of a robot.

    Row 0 is the state at the start; torques of a row acted in the step that led to it.

    Attributes:
        robots: declarations by name: joint names, limits.
        signals: event name to its values, (T, n) per joint, (T, 3) vectors, (T, 4, 4) matrices.
            What a real robot cannot know (`actual_...`) may be missing.
        times: (T,), s.
        name: for titles.
        derived: what has been computed of it and takes long, by what it is.
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
        """A log whose signals are views into rows.

        Args:
            rows: (T, width).
        """
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
        """Whether a robot's signal is there."""
        return event_of(robot, signal) in self.signals

    def of(self, robot: str, signal: str) -> Array:
        """A robot's signal, (T, n).

        Raises:
            KeyError: it is not there.
        """
        return self.signals[event_of(robot, signal)]

    def between(self, begin: float | None, end: float | None) -> RunLog:
        """The part of a run from one time to another, s, both included; None for its own ends.

        Raises:
            UsageError: there is nothing.
        """
        rows = np.ones(len(self.times), bool)
        asked = []
        if begin is not None:
            rows &= self.times >= begin
            asked.append(f"from {begin:g} s")
        if end is not None:
            rows &= self.times <= end
            asked.append(f"to {end:g} s")
        if not rows.any():
            has = "has no rows"
            if len(self.times):
                has = f"lasts from {self.times[0]:g} s to {self.times[-1]:g} s"
            raise UsageError(f"run {self.name} {has}; found nothing {' '.join(asked)}")
        signals = {event: values[rows] for event, values in self.signals.items()}
        return RunLog(self.robots, signals, self.times[rows], self.name)

    def torque_error(self, robot: str) -> Array:
        """Commanded less measured torque, (T, n), Nm."""
        return np.asarray(self.of(robot, "commanded_torques") - self.of(robot, "torques"))

    def unit_at(self, unit: str, robot: str, joint: str) -> str:
        """A unit of joints that turn (Nm, rad, rad/s) at a joint that may slide (N, m, m/s)."""
        declared = self.robots[robot]
        if declared.types[declared.names.index(joint)] == "revolute":
            return unit
        return unit.replace("Nm", "N").replace("rad", "m")

    def torque_limits(self, robot: str) -> Array:
        """(n,), Nm; infinite where the robot has none."""
        return self.robots[robot].torque_bounds

    @cached_property
    def timestep(self) -> float:
        """Median time between two rows, s."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0


def routes_from_recording(
    routes: Mapping[str, Any], source: str, recorded: Collection[str]
) -> dict[str, Any]:
    """Routes from a simulation as they are from its recording, whose events may have old names."""

    def rename(match: re.Match[str]) -> str:
        return f"{source}.{recorded_event(match[1], recorded)}"

    event = re.compile(rf"\b{re.escape(source)}\.(\w+)")
    return {
        target: event.sub(rename, origin) if isinstance(origin, str) else origin
        for target, origin in routes.items()
    }


def commanded_torques(log: RunLog, robot: str) -> Array:
    """Commanded torques, (T, n), Nm; NaN in the first row where nothing was commanded yet.

    Zeros in the first row only are what a log starts with before anybody commands anything, and
    would be the largest error of many a run.

    Raises:
        KeyError: nothing is known of what was commanded.
    """
    commanded = log.of(robot, "commanded_torques")
    if len(commanded) == 0 or commanded[0].any():
        return commanded
    commanded = commanded.copy()
    commanded[0] = np.nan
    return commanded


def torque_error(log: RunLog, robot: str) -> Array:
    """Commanded less measured torque, (T, n), Nm; raises KeyError."""
    return np.asarray(commanded_torques(log, robot) - log.of(robot, "torques"))


def compared_signal(log: RunLog, robot: str, signal: str) -> Array:
    """A signal of a robot, (T, n); commanded torques as `commanded_torques` has them.

    Raises:
        KeyError: it is not there.
    """
    if signal == "commanded_torques":
        return commanded_torques(log, robot)
    return log.of(robot, signal)
