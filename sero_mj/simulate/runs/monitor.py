"""`Monitor`: a fault detector for the log of a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from ...base.declaration import Declaration
from ...base.frames import Array, Bools, Ints
from .run_log import RunLog

KINDS = (
    "torque_error",
    "external_torque",
    "position_error",
    "frozen_torque",
    "saturated",
    "velocity_limit",
    "position_limit",
)
_UNITS = {
    "torque_error": "Nm", "external_torque": "Nm", "position_error": "rad",
    "frozen_torque": "s", "saturated": "", "velocity_limit": "rad/s", "position_limit": "rad",
}  # fmt: skip
_CLOSE = 1e-3  # distance from a position limit that counts as a fault, rad or m


class Monitor(Declaration):
    """A fault detector. It reports a fault once a threshold is exceeded for the time `hold`.

    Attributes:
        torque_error: maximum |commanded - measured| torque, as a share of the torque limit. It
            includes the torque that accelerates the motor inertia.
        external_torque: maximum external torque, as estimated by the momentum observer, as a share
            of the torque limit.
        position_error: maximum |target - measured| angle, rad or m; None disables the check.
        frozen_after: maximum time in seconds for which a torque sensor reads a constant value while
            the commanded torque changes.
        frozen_change: minimum change of the commanded torque in this time, as a share of the limit.
        hold: minimum duration of a violation, s.
    """

    torque_error: float = Field(0.15, gt=0)
    external_torque: float = Field(0.15, gt=0)
    position_error: float | None = Field(None, gt=0)
    frozen_after: float = Field(0.05, gt=0)
    frozen_change: float = Field(0.01, gt=0)
    hold: float = Field(0.02, ge=0)

    def find(self, log: RunLog) -> list[Finding]:
        """Returns all detected faults in the order of detection."""
        found: list[Finding] = []
        for robot in log.robots:
            for kind, values, limits in self._checks(log, robot):
                hold = self.frozen_after if kind == "frozen_torque" else self.hold
                steps = max(round(hold / log.timestep), 1) if log.timestep else 1
                found += _onsets(log, robot, kind, values, limits, steps)
        return sorted(found, key=lambda finding: finding.time)

    def _checks(self, log: RunLog, robot: str) -> Iterator[tuple[str, Array, Array]]:
        """Yields the kind, values (T, n) and upper bounds, (n,) or (T, n), of each check."""
        declared, limits = log.robots[robot], log.torque_limits(robot)
        if log.has(robot, "commanded_torques"):
            error = np.abs(log.torque_error(robot))
            yield "torque_error", error, self.torque_error * limits
            yield "frozen_torque", *self._frozen(log, robot, limits)
        if log.has(robot, "external_torques"):
            outer = np.abs(log.of(robot, "external_torques"))
            yield "external_torque", outer, self.external_torque * limits
        if log.has(robot, "saturated"):
            yield "saturated", log.of(robot, "saturated"), np.full(declared.n, 0.5)
        angles = log.of(robot, "joint_angles")
        if self.position_error is not None and log.has(robot, "target_angles"):
            error = np.abs(log.of(robot, "target_angles") - angles)
            yield "position_error", error, np.full(declared.n, self.position_error)
        if declared.velocity_limits is not None and log.has(robot, "joint_velocities"):
            yield (
                "velocity_limit",
                np.abs(log.of(robot, "joint_velocities")),
                declared.velocity_limits,
            )
        if declared.position_limits is not None:
            low, high = declared.position_limits.T
            beyond = np.maximum(low - angles, angles - high)
            yield "position_limit", beyond, np.full(declared.n, -_CLOSE)

    def _frozen(self, log: RunLog, robot: str, limits: Array) -> tuple[Array, Array]:
        """Returns how long sensors were constant while commands changed, and the limits, s."""
        torques, commanded = log.of(robot, "torques"), log.of(robot, "commanded_torques")
        same = np.zeros(torques.shape, bool)
        same[1:] = torques[1:] == torques[:-1]
        rows = max(round(self.frozen_after / log.timestep), 1) if log.timestep else 1
        lasted = _since(same)
        began = np.arange(len(torques))[:, None] - lasted
        moved = np.abs(commanded - np.take_along_axis(commanded, began, axis=0))
        changed = lasted >= rows
        share = self.frozen_change * np.where(np.isfinite(limits), limits, 0.0)
        seconds: Array = np.where(changed & (moved > share), lasted * log.timestep, 0.0)
        return seconds, np.full(torques.shape[1], self.frozen_after - 0.5 * log.timestep)


@dataclass(frozen=True)
class Finding:
    """A detected fault.

    Attributes:
        time: time of detection, s.
        kind: one of `KINDS`.
        value: value that exceeds the limit.
        unit: unit of value and limit; empty if there is none.
    """

    time: float
    robot: str
    joint: str
    kind: str
    value: float
    limit: float
    unit: str = ""

    def __str__(self) -> str:
        kind = self.kind.replace("_", " ")
        unit = f" {self.unit}" if self.unit else ""
        found = f"{kind} {self.value:.4g}{unit}, above {self.limit:.4g}{unit}"
        return f"{self.time:.3f} s  {self.robot}/{self.joint}  {found}"


def _onsets(
    log: RunLog, robot: str, kind: str, values: Array, limits: Array, steps: int
) -> list[Finding]:
    bad = values > limits
    if not bad.any():
        return []
    steps = 1 if kind == "frozen_torque" else steps
    detected = _since(bad) == steps
    names = log.robots[robot].names
    bounds = np.broadcast_to(limits, values.shape)
    return [
        Finding(
            float(log.times[row]),
            robot,
            names[joint],
            kind,
            float(values[row, joint]),
            float(bounds[row, joint]),
            log.unit_at(_UNITS[kind], robot, names[joint]),
        )
        for row, joint in np.argwhere(detected)
    ]


def _since(flags: Bools) -> Ints:
    """Returns the number of consecutive true rows up to each row, (T, n)."""
    rows = np.arange(1, len(flags) + 1)[:, None]
    last = np.maximum.accumulate(np.where(flags, 0, rows), axis=0)
    return np.asarray(np.where(flags, rows - last, 0))
