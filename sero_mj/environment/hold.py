"""`hold`: stay in a pose under random pushes at the flange."""

from __future__ import annotations

import numpy as np
from dm_env import specs
from numpy.typing import NDArray
from pydantic import Field

from ..assemble.cartesian import SmartArrow
from .agent_robot import AgentRobot
from .task import GOAL, Episode, Task, closeness

Array = NDArray[np.float64]


class Hold(Task):
    """Holds the pose of the start under random pushes at the flange.

    Pushes come in all directions, begin at random times and may overlap. They cannot be seen, but
    the torque sensors feel them. The reward is c(e, 0.005, 0.3) with the largest error e of any
    joint, rad or m; c is 1 within the first number and 0.1 the second beyond it.

    Attributes:
        most_force: N, of a push; its size is anything from 0 up to it.
        every: s, mean time from one push to the next.
        shortest: s, that a push lasts at least.
        longest: s, at most.
        within: rad or m, error that is as good as none.
        margin: rad or m beyond, at which the reward has fallen to 0.1.
    """

    most_force: float = Field(40.0, ge=0, le=1e4)
    every: float = Field(1.0, ge=0.01)
    shortest: float = Field(0.1, gt=0)
    longest: float = Field(0.5, gt=0)
    within: float = Field(0.005, ge=0)
    margin: float = Field(0.3, gt=0)

    def make(self, robot: AgentRobot) -> Episode:
        """The task for a robot, to be begun."""
        return HoldEpisode(self, robot)

    def arrows(self, robot: str) -> list[SmartArrow]:
        """The push."""
        return [SmartArrow(name="push", kind="force", at=f"{robot}/flange", expressed_in="world")]


class HoldEpisode:
    """`Hold` from episode to episode."""

    def __init__(self, task: Hold, robot: AgentRobot) -> None:
        self._task, self._robot = task, robot
        self._pose: Array = np.zeros(robot.declared.n)
        self._times: Array = np.zeros((0, 2))
        self._forces: Array = np.zeros((0, 3))
        self._force: Array = np.zeros(3)

    def begin(self, rng: np.random.Generator) -> None:
        """Draws all pushes of the episode."""
        task, robot = self._task, self._robot
        self._pose = robot.angles.copy()
        duration = robot.simulation.scenario.run.duration
        many = rng.poisson(duration / task.every)
        begins = rng.uniform(0.0, duration, many)
        lasting = rng.uniform(task.shortest, max(task.longest, task.shortest), many)
        self._times = np.stack([begins, begins + lasting], axis=1)
        directions = rng.standard_normal((many, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self._forces = directions * rng.uniform(0.0, task.most_force, (many, 1))
        self._force = np.zeros(3)
        self._push = robot.plant.push(f"{robot.name}/flange")

    def advance(self) -> None:
        """Pushes as hard as it is time for."""
        now = self._robot.plant.time
        acting = (self._times[:, 0] <= now) & (now < self._times[:, 1])
        self._force = self._forces[acting].sum(axis=0)
        self._push.force[:] = self._force

    def reward(self) -> float:
        """0 to 1, for the state now."""
        error = float(np.abs(self._robot.angles - self._pose).max())
        return closeness(error, self._task.within, self._task.margin)

    def observation(self) -> dict[str, Array]:
        """The pose to be held, (n,)."""
        return {"hold_angles": self._pose.copy()}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of that."""
        return {"hold_angles": specs.Array(self._pose.shape, np.float64, name="hold_angles")}

    def inputs(self) -> dict[str, Array]:
        """A double in the pose, and the push, (3,), N."""
        return {f"{self._robot.name}_{GOAL}.joint_angles": self._pose, "push.vector": self._force}
