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

VELOCITIES = "joint_velocities"  # optional input of a robot for received velocities
SLOW = 0.01  # velocity below which Coulomb friction may hold the joint, rad/s or m/s


def lack_of_friction(robot: SerialRobot) -> str:
    """Returns the reason why the friction of a robot is unknown, or "" if it is declared."""
    declared = robot.dynamics
    if declared.viscous_friction is None and declared.coulomb_friction is None:
        return "dynamics has neither viscous_friction nor coulomb_friction"
    return ""


def friction_of(robot: SerialRobot, velocities: Array) -> Array:
    """Returns the torques that overcome the declared friction, shape (..., n), Nm or N.

    Viscous friction is proportional to the velocity. Coulomb friction is constant, except below
    0.01 rad/s or m/s, where it is also proportional to the velocity, so that noise does not cause
    jumps. At rest, the true torque is unknown: it can have any value up to the Coulomb friction.
    """
    viscous, coulomb = robot.dynamics.viscous_friction, robot.dynamics.coulomb_friction
    torques: Array = np.zeros_like(velocities, float)
    if viscous is not None:
        torques += viscous * velocities
    if coulomb is not None:
        torques += coulomb * np.clip(velocities / SLOW, -1.0, 1.0)
    return torques


def joint_velocities(world: WorldView, data: Any) -> Array:
    """Returns the velocities of all joints of a world, shape (N,), rad/s or m/s.

    If a robot has an input `joint_velocities` with received values, these are returned. Otherwise,
    the velocities are `qvel`, which `data.drive` estimates from received angles if the world is not
    simulated. The joints of doubles have NaN.
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


_WITHOUT: WeakSet[WorldView] = WeakSet()  # worlds whose missing friction has been logged


def friction_torques(world: WorldView, data: Any) -> Array:
    """Returns the torques that overcome friction in all joints of a world, shape (N,), Nm or N.

    Values of doubles and of robots without declared friction are NaN. Such robots are logged once.
    """
    velocities = joint_velocities(world, data)
    found = np.full(len(velocities), np.nan)
    for name, part in world.robots.items():
        lack = lack_of_friction(part.robot)
        if not lack:
            found[part.joints] = friction_of(part.robot, velocities[part.joints])
        elif world not in _WITHOUT:
            log.warning("torques without friction are unavailable: robots.%s: %s", name, lack)
    _WITHOUT.add(world)
    return found
