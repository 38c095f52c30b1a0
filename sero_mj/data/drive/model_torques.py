"""Outputs of robots that their models compute: `lwr.gravity_torques` and `lwr.friction_torques`.

Gravity torques hold the robot in its pose, and friction torques overcome the declared friction.
Both are in Nm or N, one per joint. A declared input of the same name takes precedence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.friction_torques import (
    VELOCITIES,
    friction_of,
    friction_torques,
    lack_of_friction,
)
from ...robots.assemble.gravity_torques import GravityTorques, gravity_torques
from ...robots.assemble.world_view import WorldView
from ...robots.declared.inputs import Input
from ...robots.declared.robot import SerialRobot

GRAVITY, FRICTION = "gravity_torques", "friction_torques"
MODEL_TORQUES = (GRAVITY, FRICTION)


def model_output(robot: SerialRobot, key: str) -> Input:
    """Returns an output of a robot in the form of an input, with its name and shape."""
    coupled = robot.coupled if robot.couplings else None
    return Input(robot.name, key, (robot.n,), "values", coupled)


def why_unknown(robots: Mapping[str, SerialRobot], name: str, key: str) -> str:
    """Returns the reason why an output of a robot cannot be computed, or "" if it can."""
    if key == FRICTION:
        return lack_of_friction(robots[name])
    floating = [each for each, robot in robots.items() if robot.free_base is True]
    return f"the base of {floating[0]} is free, so no torques hold it" if floating else ""


def origins_of(robots: Mapping[str, SerialRobot], name: str, key: str) -> list[str]:
    """Returns the inputs on which an output of a robot depends.

    Gravity torques depend on the angles of all robots, because robots may be mounted on each other.
    """
    if key == GRAVITY:
        return [f"{each}.joint_angles" for each in robots]
    return [f"{name}.{VELOCITIES}", f"{name}.joint_angles"]


def output_now(world: WorldView, data: mujoco.MjData, name: str, key: str) -> Array:
    """Returns an output of a robot in the current state, shape (n,); NaN for unknown values."""
    torques = gravity_torques if key == GRAVITY else friction_torques
    return torques(world, data)[world.robots[name].joints]


class ModelTorques:
    """Gravity and friction torques of robots over time, computed from their inputs."""

    def __init__(self, robots: Mapping[str, SerialRobot]) -> None:
        self._robots = robots
        self._gravity: GravityTorques | None = None  # compiled on first use

    def output(self, name: str, key: str, input_of: Callable[[str], Array | None]) -> Array:
        """Returns an output of a robot, shape (T, n), with T = 1 if it is constant.

        Friction torques are NaN if the velocities are unknown.

        Args:
            input_of: function from the name of an input, such as `lwr.joint_angles`, to its values,
                shape (T, n), or to None if they are unknown.
        """
        robot = self._robots[name]
        if key == FRICTION:
            velocities = input_of(f"{name}.{VELOCITIES}")
            if velocities is None:
                return np.full((1, robot.n), np.nan)
            return friction_of(robot, velocities)
        if self._gravity is None:
            self._gravity = GravityTorques(self._robots)
        angles = {}
        for each, other in self._robots.items():
            found = input_of(f"{each}.joint_angles")
            angles[each] = other.home if found is None else found
        return self._gravity.over_time(angles)[name]
