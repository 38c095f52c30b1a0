"""Inputs of a controller: what is measured, and the target."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Sensed:
    """What the sensors of one robot measure; the buffers are the same ones at every step.

    Args:
        n: number of joints.
        values: (3, n), row after row in memory, to be used in place: what a simulation or a
            receiver writes is then seen without a copy.
        motor_state: (2n,), angles, then velocities of the motors where joints are elastic, to be
            used in place; those of the links when None.

    Attributes:
        time: s since the start.
        values: (3, n): angles, velocities, torques; the others are views of it.
        state: (2n,), angles, then velocities, so that one operation takes both.
        angles: (n,), rad or m.
        velocities: (n,), per second.
        torques: (n,), Nm or N, as the sensors on the link side of the gears read them.
        motor_state: (2n,), angles, then velocities of the motors, on the link's side of the gear.
            Springs and dampers act on these: on the links' they would make energy, because between
            them and the motors the joint swings (Ott 2008).
        motor_angles: (n,), the first half of it.
        motor_velocities: (n,), the second.

    Raises:
        ValueError: the values are not (3, n), float64 and row after row.
    """

    __slots__ = (
        "angles",
        "motor_angles",
        "motor_state",
        "motor_velocities",
        "state",
        "time",
        "torques",
        "values",
        "velocities",
    )

    def __init__(
        self, n: int, values: Array | None = None, motor_state: Array | None = None
    ) -> None:
        self.time = 0.0
        self.values: Array = np.zeros((3, n)) if values is None else values
        shape, kind = self.values.shape, self.values.dtype
        if shape != (3, n) or kind != np.float64 or not self.values.flags.c_contiguous:
            gaps = "" if self.values.flags.c_contiguous else " with gaps"
            raise ValueError(f"found {shape} {kind}{gaps}; expected (3, {n}) float64 without gaps")
        self.state: Array = self.values[:2].reshape(2 * n)
        self.angles: Array = self.values[0]
        self.velocities: Array = self.values[1]
        self.torques: Array = self.values[2]
        self.motor_state: Array = self.state if motor_state is None else motor_state
        self.motor_angles: Array = self.motor_state[:n]
        self.motor_velocities: Array = self.motor_state[n:]


class Target:
    """The target of one robot; a controller reads what it needs and ignores the rest.

    Write into the arrays (`target.angles[:] = ...`): controllers keep them.

    Args:
        n: number of joints.

    Attributes:
        planned: (3n + 22,), `motion`, `pose` and `twist`, so that one copy sets all.
        motion: (3n,), angles, velocities and accelerations.
        state: (2n,), its first two thirds, like that of `Sensed`.
        angles: (n,), rad or m; the first half of `state`.
        velocities: (n,), per second; the second half of `state`.
        accelerations: (n,), per second squared.
        torques: (n,), Nm or N, added to what the controller computes.
        has_torques: whether to; false where `torques` and `wrench` are zero all the time, which is
            faster.
        pose: (4, 4), T_world_flange, m.
        twist: (6,), of the flange in world axes: m/s, then rad/s.
        wrench: (6,), at the flange in world axes, that the robot is to exert: N, then Nm.
        posture: (n,), rad or m, where the null space is drawn to.
    """

    __slots__ = (
        "accelerations",
        "angles",
        "has_torques",
        "motion",
        "planned",
        "pose",
        "posture",
        "state",
        "torques",
        "twist",
        "velocities",
        "wrench",
    )

    def __init__(self, n: int) -> None:
        self.planned: Array = np.zeros(3 * n + 22)
        self.motion: Array = self.planned[: 3 * n]
        self.state: Array = self.motion[: 2 * n]
        self.angles: Array = self.state[:n]
        self.velocities: Array = self.state[n:]
        self.accelerations: Array = self.motion[2 * n :]
        self.torques: Array = np.zeros(n)
        self.has_torques = True
        self.pose: Array = self.planned[3 * n : -6].reshape(4, 4)
        self.pose[:] = np.eye(4)
        self.twist: Array = self.planned[-6:]
        self.wrench: Array = np.zeros(6)
        self.posture: Array = np.zeros(n)
