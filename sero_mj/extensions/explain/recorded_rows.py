"""`RecordedRows`: filtered signals at a few rows. `Hypothesis`: what may be wrong with them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...base.frames import Array
from ...robots.declared.robot import SerialRobot
from ...study.explanation import Kind
from .torque_residuals import TorqueResiduals, is_coupled

ANGLES, MEASURED, COMMANDED = "joint_angles", "torques", "commanded_torques"
Signals = tuple[str, ...]
_ROWS = 60  # rows at which hypotheses are judged
_MIN_ROWS = 12
_FLOOR = 1e-3  # share of the torque limit that is regarded as zero
_NOISE = 0.2  # share of white noise that passes the low-pass filter
_CLOSE = 0.05  # relative difference of factors that are regarded as equal


@dataclass(frozen=True)
class Hypothesis:
    """How the correct signals follow from the recorded ones.

    Attributes:
        order: the recorded column of each joint.
        factors: factors of the columns in `order`.
    """

    kind: Kind
    signals: Signals
    order: tuple[int, ...]
    factors: tuple[float, ...]
    price: float

    def of(self, signal: str, values: Array) -> Array:
        """Returns the correct signal, from a recorded one with shape (..., n)."""
        return values[..., self.order] * self.factors if signal in self.signals else values

    def resembles(self, other: Hypothesis) -> bool:
        """Whether a simpler hypothesis has almost the same factors for the same columns."""
        same = self.signals == other.signals and self.order == other.order
        same &= self.price > other.price
        return same and bool(np.allclose(self.factors, other.factors, rtol=_CLOSE))

    @property
    def joints(self) -> list[int]:
        each = zip(self.order, self.factors, strict=True)
        return [k for k, (column, factor) in enumerate(each) if column != k or factor != 1.0]


@dataclass(frozen=True, eq=False)
class RecordedRows:
    """Filtered signals at a few rows.

    Attributes:
        motion: angles, velocities and accelerations, shape (3, K, n).
        motor: acceleration, velocity and its sign, shape (K, n, 3); the torque of motor inertia and
            friction is a combination of them.
        torques: measured and commanded torques, shape (2, K, n).
        payload: torques per unit of the parameters of a payload, shape (K, n, 10).
        judged: whether each joint is judged on the link side and the motor side, shape (2, n).
        noise: standard deviations of the filtered measured torques, shape (n,), Nm or N.
        floor: torques that are regarded as zero, shape (n,), Nm or N.
    """

    robot: SerialRobot
    motion: Array
    motor: Array
    torques: Array
    payload: Array
    judged: Array
    noise: Array
    floor: Array
    torque_control: bool

    @classmethod
    def of(cls, found: TorqueResiduals) -> RecordedRows | None:
        torques = np.stack([found.torques.measured, found.torques.commanded])
        has_commands = bool(np.isfinite(torques[1]).any())
        motion = found.motion
        motor = np.stack([motion.accelerations, motion.velocities, motion.signs], axis=-1)
        needed = [torques[0], *motion.links, *([torques[1]] if has_commands else [])]
        rows = np.flatnonzero(np.isfinite(needed).all(axis=(0, 2)))
        if len(rows) < _MIN_ROWS:
            return None
        rows = rows[np.linspace(0, len(rows) - 1, min(_ROWS, len(rows))).astype(int)]
        robot = found.robot
        known = ~is_coupled(robot)
        judged = np.stack([known & found.has_model, known & has_commands])
        return cls(robot, motion.links[:, rows], np.nan_to_num(motor[rows]),
                   np.nan_to_num(torques[:, rows]), found.torques.payload[rows],
                   judged.astype(float), _NOISE * np.median(found.noise.roughness, axis=0),
                   _FLOOR * found.scale, found.torque_control)  # fmt: skip

    def corrected(self, it: Hypothesis) -> RecordedRows:
        motor = np.moveaxis(it.of(ANGLES, np.moveaxis(self.motor, -1, 0)), 0, -1)
        torques = [it.of(MEASURED, self.torques[0]), it.of(COMMANDED, self.torques[1])]
        return replace(self, motion=it.of(ANGLES, self.motion), motor=motor,
                       torques=np.stack(torques), noise=it.of(MEASURED, self.noise))  # fmt: skip
