"""Targets of robots at every step of a run, computed before it begins."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from .cartesian_control import CartesianImpedance
from .cartesian_laws import CartesianLaw, CartesianMotion
from .compiler import Compiler
from .controller import Controller, ControllerDeclaration
from .inverse_kinematics import follow_poses
from .joint_control import GravityCompensation, Torque
from .laws import Constant, Law, Motion

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Plan:
    """The target of one robot at every step.

    Attributes:
        joints: angles, velocities and accelerations, (T, n) each; None where there is no target.
        flange: poses and twists, where the controller or the law is Cartesian; only with `joints`.
        moves: whether it ever changes.
    """

    joints: Motion | None
    flange: CartesianMotion | None
    moves: bool

    @cached_property
    def rows(self) -> Array:
        """(T, k), what is asked for at every step, as the first k numbers of `Target.planned`."""
        if self.joints is None:
            return np.zeros((1, 0))
        joints, flange = self.joints, self.flange
        parts = [joints.angles, joints.velocities, joints.accelerations]
        if flange is not None:
            parts += [flange.poses.reshape(len(flange.poses), 16), flange.twists]
        return np.hstack(parts)


def make_plan(
    robot: SerialRobot,
    law: Law | CartesianLaw | None,
    controller: ControllerDeclaration | Controller,
    times: Array,
    compiler: Compiler,
    start: Array | None = None,
) -> Plan:
    """The target of a robot over a run.

    A law in joint space is turned into poses for a Cartesian controller, and a Cartesian one into
    joint angles; the latter are shown in any case, and are proof that it can be followed.

    Args:
        robot: with its limits.
        law: of the motion; None stays where it starts, or has no target where there is no spring.
        controller: that is to follow it.
        times: (T,), s.
        compiler: of the model with which a flange's way is followed.
        start: (n,), where the robot stands at first, rad or m; as it is declared when None.

    Raises:
        DeclarationError: the motion leaves the robot's limits or reach.
    """
    start = np.asarray(robot.home if start is None else start, np.float64)
    is_cartesian = isinstance(controller, CartesianImpedance)
    if law is None and isinstance(controller, GravityCompensation | Torque):
        return Plan(None, None, moves=False)
    if isinstance(law, CartesianLaw):
        first = robot.base_frame @ robot.fwd_kin_base_to_flange(start)
        flange = law.sample(times, first)
        angles = follow_poses(flange, compiler.robot_model(robot), robot, start)
        joints = _motion(times, angles)
        return Plan(joints, flange, moves=bool(np.ptp(flange.poses, axis=0).max() > 0))
    joints = (law or Constant()).sample(times, robot, start)
    moves = bool(np.ptp(joints.angles, axis=0).max() > 0)
    return Plan(joints, _poses(robot, joints) if is_cartesian else None, moves)


def _motion(times: Array, angles: Array) -> Motion:
    """A motion of joints of which only the angles are known."""
    if len(times) < 3:
        return Motion(times, angles, np.zeros_like(angles), np.zeros_like(angles))
    velocities = np.gradient(angles, times, axis=0)
    return Motion(times, angles, velocities, np.gradient(velocities, times, axis=0))


def _poses(robot: SerialRobot, motion: Motion) -> CartesianMotion:
    """Where the flange is during a motion of the joints."""
    poses = robot.base_frame @ robot.fwd_kin_base_to_flange(motion.angles)
    jacobians = robot.dh.jacobian(motion.angles, robot.base_frame, robot.flange_frame)
    twists = np.einsum("tij,tj->ti", jacobians, motion.velocities)
    accelerations = np.gradient(twists, motion.times, axis=0) if len(twists) > 2 else 0.0 * twists
    return CartesianMotion(motion.times, poses, twists, np.asarray(accelerations))
