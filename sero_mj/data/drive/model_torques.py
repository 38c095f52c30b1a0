"""Torques that routes and triggers can read of the models of robots.

`lwr.gravity_torques` holds the robot at its angles, `lwr.friction_torques` overcomes the friction
that it declares; both in Nm or N, one per joint. An input of that name, which a robot may declare
for values that it receives, comes before.
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
    """Describes such an output of a robot, as if it were an input of it."""
    coupled = robot.coupled if robot.couplings else None
    return Input(robot.name, key, (robot.n,), "values", coupled)


def why_unknown(robots: Mapping[str, SerialRobot], name: str, key: str) -> str:
    """Returns why the models of robots do not tell an output of one; empty if they do."""
    if key == FRICTION:
        return lack_of_friction(robots[name])
    floating = [each for each, robot in robots.items() if robot.free_base is True]
    return f"the base of {floating[0]} is free: it holds nothing" if floating else ""


def origins_of(robots: Mapping[str, SerialRobot], name: str, key: str) -> list[str]:
    """Returns the inputs on which an output of a robot depends.

    A robot's gravity torques depend on the angles of all: others may be mounted on it.
    """
    if key == GRAVITY:
        return [f"{each}.joint_angles" for each in robots]
    return [f"{name}.{VELOCITIES}", f"{name}.joint_angles"]


def output_now(world: WorldView, data: mujoco.MjData, name: str, key: str) -> Array:
    """Returns an output of a robot in the state of a world, (n,); NaN where it is unknown."""
    torques = gravity_torques if key == GRAVITY else friction_torques
    return torques(world, data)[world.robots[name].joints]


class ModelTorques:
    """Computes outputs of robots from what leads to them, over time."""

    def __init__(self, robots: Mapping[str, SerialRobot]) -> None:
        self._robots = robots
        self._gravity: GravityTorques | None = None  # compiled when it is first needed

    def output(self, name: str, key: str, input_of: Callable[[str], Array | None]) -> Array:
        """Returns an output of a robot, (T, n), with T = 1 if it is the same at all times.

        NaN where nothing is known of its velocities, for friction.

        Args:
            input_of: returns the values (T, n) of an input by its name, `lwr.joint_angles`; None
                where nothing is known of it.
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
