"""A motion as a robot would make it: smooth, within its limits, with the torques it takes."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..assemble.world import World

Array = NDArray[np.float64]

_AMPLITUDE = 0.4  # of half the joint's range
_BEND = 0.2  # of half the range: the arm swings about a bent pose, not about a stretched one
_DEFAULT_RANGE = (-1.0, 1.0)  # rad or m, for joints without limits
_LONGEST_SWING = 1.1  # rad
_PERIODS = np.array([7.0, 9.0, 6.0, 8.0, 5.0, 4.0, 3.5])  # s; repeated for more joints


class SineMotion:
    """Every joint swings with its own period; velocities stay below the limits.

    Args:
        robot: whose limits to keep.
        amplitude: scales the swing; 0 stands still.
    """

    def __init__(self, robot: SerialRobot, amplitude: float = 1.0) -> None:
        limits = robot.position_limits
        low, high = (limits if limits is not None else np.tile(_DEFAULT_RANGE, (robot.n, 1))).T
        half = (high - low) / 2
        sign = np.where(np.arange(robot.n) % 2 == 0, 1.0, -1.0)
        self._centre = (low + high) / 2 + sign * _BEND * half
        swing = np.minimum(_AMPLITUDE * half, _LONGEST_SWING) * min(max(amplitude, 0.0), 1.0)
        self._omega = 2 * np.pi / np.resize(_PERIODS, robot.n)
        self._phase = 0.7 * np.arange(robot.n)
        if robot.velocity_limits is not None:
            swing = np.minimum(swing, 0.8 * robot.velocity_limits / self._omega)
        self._swing = swing

    def at(self, t: float) -> tuple[Array, Array, Array]:
        """Joint positions, velocities and accelerations (n,) at time t (s)."""
        angle = self._omega * t + self._phase
        sin, cos = np.sin(angle), np.cos(angle)
        return (
            self._centre + self._swing * sin,
            self._swing * self._omega * cos,
            -self._swing * self._omega**2 * sin,
        )


class InverseDynamics:
    """Joint torques of one robot from its motion, by MuJoCo's inverse dynamics.

    Masses are those of the robot's file; where it has none, they follow from the volume of the
    links at the density of water, so the torques are then an estimate.
    """

    def __init__(self, robot: SerialRobot) -> None:
        self._world = World(Scene(robots=[robot], floor=False))
        self._data = self._world.make_data()
        self._world.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)

    def torques(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Joint torques that make the motion.

        Args:
            position: of the joints, (n,), rad or m.
            velocity: of the joints, (n,), rad/s or m/s.
            acceleration: of the joints, (n,), rad/s2 or m/s2.

        Returns:
            torques, (n,), Nm or N.
        """
        data = self._data
        data.qpos[:], data.qvel[:], data.qacc[:] = position, velocity, acceleration
        mujoco.mj_inverse(self._world.model, data)
        return np.array(data.qfrc_inverse)
