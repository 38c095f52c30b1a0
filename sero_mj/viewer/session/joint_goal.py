"""`JointGoal`: the joint angles that a user requests for a robot. Also formats angles as text."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping

import numpy as np

from ...base.frames import Array, frame
from ...robots.declared.inverse_kinematics import (
    ITERATIONS,
    Reached,
    frame_place,
    independent_limits,
    reach,
)
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene

_FAR = 0.005  # distance from the requested pose above which an error is shown, m
_ROTATED = np.deg2rad(2.0)  # angle from the requested pose above which an error is shown, rad
_PER_DRAG = 12  # number of iterations per pointer event; the next event continues
_NO_NUMBER = "expected a finite number; the robot does not move"


class JointGoal:
    """The joint angles that a user requests for a robot.

    The user sets the angles, the pose of the flange, or the position of a point of a link. Angles
    stay within the position limits. If a pose cannot be reached, the nearest one is used, and
    `trouble` explains why.

    Attributes:
        trouble: reason why the requested pose is not reached, or an empty string.
        mark: requested and reached position of a frame, shape (2, 3), m; None if they coincide.
        is_led: whether a program sets the angles. If so, the user cannot set them.
    """

    def __init__(self, robot: SerialRobot, angles: Array) -> None:
        self.robot = robot
        self._coupled = robot.coupled
        self._limits, self._ranges = independent_limits(robot), robot.display_ranges
        self._free: Array = np.array(angles, float)[self._coupled.independent]
        self._posture = self._free.copy()
        self.trouble = ""
        self.mark: Array | None = None
        self.is_led = False

    @property
    def angles(self) -> Array:
        return self._coupled.positions(self._free)

    def range_of(self, joint: int) -> tuple[float, float]:
        """Returns the minimum and maximum of a joint's slider in rad or m."""
        low, high = self._ranges[joint].tolist()
        return low, high

    def follow(self, angles: Array) -> None:
        self._free = np.array(angles, float)[self._coupled.independent]
        self.trouble, self.mark = "", None

    def set_all(self, angles: Array) -> None:
        self._set(np.array(angles, float)[self._coupled.independent])

    def set_joint(self, joint: int, angle: float) -> None:
        free = self._free.copy()
        index = int(np.flatnonzero(self._coupled.independent == joint)[0])
        free[index] = angle
        self._set(free)

    def _set(self, free: Array) -> None:
        if not np.isfinite(free).all():
            self.trouble = _NO_NUMBER
            return
        self.mark, self.trouble = None, ""
        limited = free
        if self._limits is not None:
            limited = np.clip(free, self._limits[:, 0], self._limits[:, 1])
            beyond = np.flatnonzero(np.abs(limited - free) > 1e-9)
            if len(beyond):
                self.trouble = ", ".join(self._limit_text(int(i), limited) for i in beyond[:3])
        self._free = limited

    def _limit_text(self, index: int, free: Array) -> str:
        joint = int(self._coupled.independent[index])
        name, is_angle = self.robot.names[joint], self.robot.types[joint] == "revolute"
        value = np.rad2deg(free[index]) if is_angle else free[index]
        return f"{name} is at its limit of {value:.4g} {'deg' if is_angle else 'm'}"

    def hold_posture(self) -> None:
        """Makes redundant robots prefer the current joint angles during the next drag."""
        self._posture = self._free.copy()

    def flange(self, base: Array) -> Array:
        """Returns T_world_flange, shape (4, 4), at the requested angles. `base` is T_world_base."""
        return np.asarray(base @ self.robot.fwd_kin_base_to_flange(self.angles))

    def move_flange(self, base: Array, pose: Array, *, at_once: bool = False) -> None:
        """Moves the flange to a pose, shape (4, 4), or as close to it as possible.

        Args:
            base: T_world_base, shape (4, 4).
            at_once: whether the user has typed the pose. If so, a pose out of reach is rejected.
        """
        if not np.isfinite(pose).all():
            self.trouble = _NO_NUMBER
            return
        place = frame_place(self.robot, base, self.robot.flange_link, self.robot.T_n_flange)
        found = reach(
            place,
            pose,
            self._free,
            self._limits,
            posture=self._posture,
            iterations=ITERATIONS if at_once else _PER_DRAG,
        )
        if at_once and not found.is_there:
            self._refuse(found, pose[:3, 3], place(self._free)[0][:3, 3])
            self.trouble += "; the robot does not move"
            return
        self._take(found, pose[:3, 3], place(found.angles)[0][:3, 3])

    def move_point(self, base: Array, link: int, point: Array, wanted: Array) -> None:
        """Moves a point of a link to a position in the world, or as close to it as possible.

        Args:
            base: T_world_base, shape (4, 4).
            link: index of the link, from 0 for the base to n.
            point: position of the point in the frame of the link, shape (3,), m.
            wanted: requested position in the world, shape (3,), m.
        """
        place = frame_place(self.robot, base, link, frame(np.eye(3), point))
        goal = frame(np.eye(3), wanted)
        found = reach(
            place,
            goal,
            self._free,
            self._limits,
            turns=False,
            posture=self._posture,
            iterations=_PER_DRAG,
        )
        self._take(found, wanted, place(found.angles)[0][:3, 3])

    def _take(self, found: Reached, wanted: Array, there: Array) -> None:
        self._free = found.angles
        if found.distance > _FAR or found.angle > _ROTATED:
            self._refuse(found, wanted, there)
        else:
            self.trouble, self.mark = "", None

    def _refuse(self, found: Reached, wanted: Array, there: Array) -> None:
        left = f"{1e3 * found.distance:.0f} mm"
        if found.angle > _ROTATED:
            left += f" and {np.rad2deg(found.angle):.0f} deg"
        joints = np.flatnonzero(found.at_limit)
        why = ", ".join(self._limit_text(int(i), found.angles) for i in joints[:3])
        why = why or "it is out of reach or at a singularity"
        self.trouble = f"the pose is not reached ({left} away): {why}"
        self.mark = np.array([wanted, there])

    def let_go(self) -> None:
        self.trouble, self.mark = "", None


def set_goals(goals: Mapping[str, JointGoal], angles: Iterable[tuple[str, bytes]]) -> None:
    """Sets goals by robot name. `angles` has pairs of a name and angles as bytes of float64."""
    for name, wanted in angles:
        if name in goals and goals[name].angles.tobytes() != wanted:
            goals[name].set_all(np.frombuffer(wanted))


_DIGITS = 6  # number of decimals of angles in rad and positions in m


def as_toml(robot: str, angles: Array) -> str:
    """Formats the joint angles of a robot as a TOML table for a scene, such as `[robots.lwr]`."""
    return f"[robots.{robot}]\njoint_angles = [{_listed(angles)}]  # rad or m\n"


def as_python(robot: str, angles: Array) -> str:
    """Formats joint angles as a Python statement that sets them in a `sero_mj.Viewer`."""
    return f'viewer.robot("{robot}").joint_angles = [{_listed(angles)}]\n'


def as_command(scene: Scene, robot: str, angles: Array) -> str:
    """Returns the command line that shows a scene with the given joint angles of a robot."""
    text = setting(robot, angles)
    return f"sero-mj view {shlex.quote(scene.argument)} --set {text}\n"


def setting(robot: str, values: Array, field: str = "joint_angles") -> str:
    """Formats one number per joint as a value of the option `--set`: `lwr.joint_angles=0,1,2`."""
    return f"{robot}.{field}={_listed(values, ',')}"


def _listed(angles: Array, separator: str = ", ") -> str:
    return separator.join(f"{round(float(angle), _DIGITS) + 0.0:g}" for angle in angles)
