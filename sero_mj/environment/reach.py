"""`reach`: bring the flange to a target that is somewhere else in every episode."""

from __future__ import annotations

from typing import Literal

import mujoco
import numpy as np
from dm_env import specs
from numpy.typing import NDArray
from pydantic import Field

from .agent_robot import AgentRobot
from .task import GOAL, Episode, Task, closeness

Array = NDArray[np.float64]


class Reach(Task):
    """Brings the flange to a random target that the robot can reach.

    The reward is c(d, 0.005 m, 0.3 m) with the distance d between flange and target, and for poses
    that times c(a, 2 deg, 90 deg) with the angle a between them; c is 1 within the first number
    and 0.1 the second beyond it: `task.closeness`.

    Attributes:
        target: `position`, or `pose`: with orientation.
        within: m, that is as good as there.
        margin: m beyond, at which the reward has fallen to 0.1.
        within_angle: likewise rad.
        margin_angle: likewise rad.
    """

    target: Literal["position", "pose"] = "position"
    within: float = Field(0.005, ge=0)
    margin: float = Field(0.3, gt=0)
    within_angle: float = Field(float(np.deg2rad(2.0)), ge=0)
    margin_angle: float = Field(float(np.deg2rad(90.0)), gt=0)

    def make(self, robot: AgentRobot) -> Episode:
        """The task for a robot, to be begun."""
        return ReachEpisode(self, robot)


class ReachEpisode:
    """`Reach` from episode to episode.

    Attributes:
        goal: (n,), joint angles at which the flange is there, rad or m.
        target: T_world_target, (4, 4), m.
    """

    def __init__(self, task: Reach, robot: AgentRobot) -> None:
        self._task, self._robot = task, robot
        self.goal: Array = np.zeros(robot.declared.n)
        self.target: Array = np.eye(4)

    def begin(self, rng: np.random.Generator) -> None:
        """Chooses a target: where the flange is in a pose that touches nothing."""
        robot = self._robot.declared
        self.goal = self._robot.free_pose(rng)
        self.target = robot.base_frame @ robot.fwd_kin_base_to_flange(self.goal)

    def advance(self) -> None:
        """Nothing happens."""

    def reward(self) -> float:
        """0 to 1, for the state now."""
        task, flange = self._task, self._robot.flange()
        distance = float(np.linalg.norm(flange[:3, 3] - self.target[:3, 3]))
        reward = closeness(distance, task.within, task.margin)
        if task.target == "pose":
            angle = _angle_between(flange[:3, :3], self.target[:3, :3])
            reward *= closeness(angle, task.within_angle, task.margin_angle)
        return reward

    def observation(self) -> dict[str, Array]:
        """Where flange and target are, in the world, m; for poses also quaternions, w first."""
        angles = self._robot.measured_angles
        robot = self._robot.declared
        flange = robot.base_frame @ robot.fwd_kin_base_to_flange(angles)
        found = {
            "flange_position": flange[:3, 3].copy(),
            "target_position": self.target[:3, 3].copy(),
        }
        if self._task.target == "pose":
            found["flange_quaternion"] = _quaternion(flange)
            found["target_quaternion"] = _quaternion(self.target)
        return found

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of that."""
        found: dict[str, specs.Array] = {
            name: specs.Array((3,), np.float64, name=name)
            for name in ("flange_position", "target_position")
        }
        if self._task.target == "pose":
            for name in ("flange_quaternion", "target_quaternion"):
                found[name] = specs.BoundedArray((4,), np.float64, -1.0, 1.0, name=name)
        return found

    def inputs(self) -> dict[str, Array]:
        """A double at the goal."""
        return {f"{self._robot.name}_{GOAL}.joint_angles": self.goal}


def _angle_between(a: Array, b: Array) -> float:
    """rad, of two rotations (3, 3); exact near 0 and near pi."""
    turn = a.T @ b
    sin = 0.5 * np.hypot(
        np.hypot(turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0]), turn[1, 0] - turn[0, 1]
    )
    return float(np.arctan2(sin, 0.5 * (np.trace(turn) - 1.0)))


def _quaternion(T: Array) -> Array:
    """w, x, y, z with w from 0 on: one for every orientation."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, T[:3, :3].ravel())
    return np.clip(quaternion if quaternion[0] >= 0 else -quaternion, -1.0, 1.0)
