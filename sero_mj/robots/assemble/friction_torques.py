"""The torques that friction takes of joints, by the `[dynamics]` that robots declare."""

from __future__ import annotations

import logging
from typing import Any
from weakref import WeakSet

import numpy as np

from ...base.frames import Array
from ..declared.robot import SerialRobot
from .world_view import WorldView

log = logging.getLogger(__name__)

VELOCITIES = "joint_velocities"  # the input of a robot, if it declares it, that has received ones
SLOW = 0.01  # rad/s or m/s, below which Coulomb friction may hold the joint


def lack_of_friction(robot: SerialRobot) -> str:
    """Returns why a robot's friction is unknown; empty if it is declared."""
    declared = robot.dynamics
    if declared.viscous_friction is None and declared.coulomb_friction is None:
        return "dynamics has neither viscous_friction nor coulomb_friction"
    return ""


def friction_of(robot: SerialRobot, velocities: Array) -> Array:
    """Returns the torques (..., n), Nm or N, that overcome the declared friction.

    Viscous friction in proportion to the velocity, plus Coulomb friction in its direction. At rest
    the latter can be anything between its two values; below `SLOW` it goes over from one to the
    other, through zero, so that noise of the velocity does not make it jump.
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

    Those received by an input `joint_velocities`, where a robot has it, else those of the state,
    which a mirror derives from angles; NaN for doubles.
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


_WITHOUT: WeakSet[WorldView] = WeakSet()  # of which it is logged which robots have none


def friction_torques(world: WorldView, data: Any) -> Array:
    """Returns the torques that overcome the friction of joints, (N,), Nm or N.

    Those of doubles are NaN, and those of robots that declare no friction, which is logged once.
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
