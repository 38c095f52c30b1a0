"""Targets of robots for every step of a run, computed before the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...base.declaration import by_kind
from ...base.errors import DeclarationError, Problem
from ...base.frames import Array
from ...base.plugins import TARGET_MOTIONS, load_all
from ...robots.declared.inverse_kinematics import Reached, reach
from ...robots.declared.robot import SerialRobot
from .compiler import Compiler
from .controller import Target
from .robot_model import RobotModel
from .target_motions import (
    CartesianMotion,
    CartesianTargetMotion,
    Constant,
    JointTargetMotion,
    Motion,
    TargetMotion,
)

_EVERY = 0.02  # time between two poses of inverse kinematics, s


def target_motion_kinds() -> Mapping[str, type[TargetMotion]]:
    """Returns all installed kinds of target motions by name."""
    return load_all(TARGET_MOTIONS, TargetMotion)


def target_motion_from(table: Any) -> TargetMotion:
    """Returns the declaration of a target motion for a table with `kind` and its fields.

    A declaration is returned unchanged. Raises DeclarationError for an unknown kind or wrong
    fields.
    """
    return by_kind(table, target_motion_kinds(), TargetMotion)


@dataclass(frozen=True, eq=False)
class Plan:
    """The target of one robot at every step.

    Attributes:
        joints: motion of the joints; None if there is no target.
        flange: motion of the flange; None unless the controller or the target is Cartesian.
        moves: whether the target changes during the run.
    """

    joints: Motion | None
    flange: CartesianMotion | None
    moves: bool

    @cached_property
    def motion(self) -> Array | None:
        """Joint angles, velocities and accelerations, shape (T, 3, n); None without a target."""
        of = self.joints
        return (
            None if of is None else np.stack([of.angles, of.velocities, of.accelerations], axis=1)
        )

    def write(self, k: int, target: Target) -> None:
        """Writes the values of step k to a target."""
        if self.motion is not None:
            target.motion[...] = self.motion[k]
        if self.flange is not None:
            target.pose[...], target.twist[...] = self.flange.poses[k], self.flange.twists[k]


def make_plan(
    robot: SerialRobot,
    target: TargetMotion | None,
    times: Array,
    compiler: Compiler,
    start: Array | None = None,
    *,
    needs_target: bool = True,
    needs_pose: bool = True,
) -> Plan:
    """Computes the target of a robot for a run.

    Joint motions are converted to poses if a Cartesian controller needs them. Motions of the flange
    are converted to joint angles by inverse kinematics. The angles are displayed. Computing them
    also checks that the robot can follow the motion.

    Args:
        target: target motion. If None, the robot stays at the start, or has no target if
            `needs_target` is false.
        times: times of the rows, shape (T,), s.
        start: initial joint angles, shape (n,), rad or m (default: the declared angles).

    Raises:
        DeclarationError: the motion leaves the limits or the reach of the robot.
    """
    start = np.asarray(robot.home if start is None else start, np.float64)
    if target is None and not needs_target:
        return Plan(None, None, moves=False)
    if isinstance(target, CartesianTargetMotion):
        first = robot.base_frame @ robot.fwd_kin_base_to_flange(start)
        flange = target.sample(times, first)
        angles = follow_poses(flange, compiler.robot_model(robot), robot, start)
        joints = _motion(times, angles)
        return Plan(joints, flange, moves=bool(np.ptp(flange.poses, axis=0).max() > 0))
    target = Constant() if target is None else target
    assert isinstance(target, JointTargetMotion)
    joints = target.sample(times, robot, start)
    moves = bool(np.ptp(joints.angles, axis=0).max() > 0)
    return Plan(joints, _poses(robot, joints) if needs_pose else None, moves)


def _motion(times: Array, angles: Array) -> Motion:
    if len(times) < 3:
        return Motion(times, angles, np.zeros_like(angles), np.zeros_like(angles))
    velocities = np.gradient(angles, times, axis=0)
    return Motion(times, angles, velocities, np.gradient(velocities, times, axis=0))


def _poses(robot: SerialRobot, motion: Motion) -> CartesianMotion:
    poses = robot.base_frame @ robot.fwd_kin_base_to_flange(motion.angles)
    jacobians = robot.kinematics.jacobian(
        motion.angles, robot.base_frame, robot.T_n_flange, robot.flange_link
    )
    twists = np.einsum("tij,tj->ti", jacobians, motion.velocities)
    accelerations = np.gradient(twists, motion.times, axis=0) if len(twists) > 2 else 0.0 * twists
    return CartesianMotion(motion.times, poses, twists, np.asarray(accelerations))


def follow_poses(
    motion: CartesianMotion, model: RobotModel, robot: SerialRobot, start: Array
) -> Array:
    """Returns joint angles for a motion of the flange, within the position limits, shape (T, n).

    Damped least squares (`reach`) computes a pose every 20 ms, starting from the previous pose. The
    angles between these poses are interpolated. This is not a planner: a redundant arm may be
    stopped by a limit that it would not reach with another position of the elbow.

    Args:
        model: model of the robot, which this function updates.
        start: initial joint angles, shape (n,), rad or m.

    Raises:
        DeclarationError: the flange cannot follow. The error states the time, the distance, and the
            joints at their limits.
    """
    times = motion.times
    picked = np.unique(
        np.hstack([np.searchsorted(times, np.arange(times[0], times[-1], _EVERY)), len(times) - 1])
    )
    found: Array = np.empty((len(picked), model.n))
    angles = np.array(start, float)
    still: Array = np.zeros(model.n)

    def place(angles: Array) -> tuple[Array, Array]:
        model.update(angles, still)
        return model.flange(), model.jacobian()

    for row, pose in zip(found, picked, strict=True):
        reached = reach(place, motion.poses[pose], angles, robot.position_limits)
        if not reached.is_there:
            raise _too_far(times[pose], reached, robot)
        row[:] = angles = reached.angles
    return np.stack([np.interp(times, times[picked], column) for column in found.T], axis=1)


def _too_far(time: float, reached: Reached, robot: SerialRobot) -> DeclarationError:
    left = f"{1e3 * reached.distance:.1f} mm and {np.rad2deg(reached.angle):.1f} deg"
    found = f"the flange cannot follow at t = {time:.3f} s: its error is {left}"
    names = [name for name, there in zip(robot.names, reached.at_limit, strict=True) if there]
    if names:
        joints = f"joint {names[0]} is" if len(names) == 1 else f"joints {', '.join(names)} are"
        why = f"{joints} at the limit"
    else:
        why = "no joint is at its limit: the pose is out of reach or behind a singularity"
    return Problem("", f"{found}; {why}").error()
