"""Friction torques of joints, computed from the declared `[dynamics]` of robots."""

from __future__ import annotations

import logging
from typing import Any
from weakref import WeakSet

import numpy as np

from ...base.frames import Array
from ..declared.robot import SerialRobot
from .world_view import WorldView

log = logging.getLogger(__name__)

VELOCITIES = "joint_velocities"  # optional input of a robot, for received velocities
SLOW = 0.01  # rad/s or m/s; below it, Coulomb friction may hold the joint


def lack_of_friction(robot: SerialRobot) -> str:
    """Returns why a robot's friction is unknown; empty if it is declared."""
    declared = robot.dynamics
    if declared.viscous_friction is None and declared.coulomb_friction is None:
        return "dynamics has neither viscous_friction nor coulomb_friction"
    return ""


def friction_of(robot: SerialRobot, velocities: Array) -> Array:
    """Returns the torques (..., n), Nm or N, that overcome the declared friction.

    This is viscous friction, proportional to the velocity, plus Coulomb friction in its direction.
    Below `SLOW`, Coulomb friction is proportional to the velocity, too, so that noise does not
    cause jumps; at rest its true value can be anything between its two limits.
    """
    viscous, coulomb = robot.dynamics.viscous_friction, robot.dynamics.coulomb_friction
    torques: Array = np.zeros_like(velocities, float)
    if viscous is not None:
        torques += viscous * velocities
    if coulomb is not None:
        torques += coulomb * np.clip(velocities / SLOW, -1.0, 1.0)
    return torques


def joint_velocities(world: WorldView, data: Any) -> Array:
    """Returns the velocities of the joints of a world, (N,), rad/s or m/s.

    They are the received values of an input `joint_velocities` if a robot has it, else those of
    the state, which a mirror derives from angles. Values of doubles are NaN.
    """
    state, joints = world.state(data), world.joints
    found = np.full(len(joints.names), np.nan)
    for part in world.robots.values():
        found[part.joints] = state.qvel[part.dofs]
    if VELOCITIES in joints.slots:
        slots = joints.slots[VELOCITIES]
        received = (slots >= 0) & (state.userdata[joints.has[VELOCITIES]] > 0)
        received[joints.of_robot :] = False
        found[received] = state.userdata[slots[received]]
    return found


_WITHOUT: WeakSet[WorldView] = WeakSet()  # worlds for which missing friction was logged


def friction_torques(world: WorldView, data: Any) -> Array:
    """Returns the torques that overcome the friction of joints, (N,), Nm or N.

    Values of doubles and of robots without declared friction are NaN; the latter are logged once.
    """
    velocities = joint_velocities(world, data)
    found = np.full(len(velocities), np.nan)
    for name, part in world.robots.items():
        lack = lack_of_friction(part.robot)
        if not lack:
            found[part.joints] = friction_of(part.robot, velocities[part.joints])
        elif world not in _WITHOUT:
            log.warning("no torque without friction: robots.%s: %s", name, lack)
    _WITHOUT.add(world)
    return found
