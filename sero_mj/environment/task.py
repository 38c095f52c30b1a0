"""What tasks of environments have in common: a reward, what is observed, what pictures show."""

from __future__ import annotations

from typing import ClassVar, Protocol

import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from ..assemble.cartesian import SmartArrow
from ..declaration import Declaration
from .agent_robot import AgentRobot

Array = NDArray[np.float64]

GOAL = "goal"  # the double at a task's goal is called `ROBOT_goal`


class Episode(Protocol):
    """A task from episode to episode."""

    def begin(self, rng: np.random.Generator) -> None:
        """Begins an episode; the robot stands where it starts."""

    def advance(self) -> None:
        """Begins a control step."""

    def reward(self) -> float:
        """0 to 1, for the state now."""

    def observation(self) -> dict[str, Array]:
        """What an agent has to know of the task."""

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of that."""

    def inputs(self) -> dict[str, Array]:
        """Inputs of the scene to what pictures show there: `lwr_goal.joint_angles`, (n,)."""


class Task(Declaration):
    """Base of the declarations of tasks.

    Attributes:
        observed: signals of every robot that an agent observes.
    """

    observed: ClassVar[tuple[str, ...]] = ("joint_angles", "joint_velocities", "torques")

    def make(self, robot: AgentRobot) -> Episode:
        """The task for a robot, to be begun."""
        raise NotImplementedError

    def arrows(self, robot: str) -> list[SmartArrow]:
        """What pictures of it show beside the robot and a double at its goal."""
        return []


def closeness(distance: float, within: float, margin: float) -> float:
    """1 up to `within`, then 1 / (1 + 9 ((distance - within) / margin)^2): it never gets flat.

    Args:
        distance: from 0.
        within: up to which it is as good as none, in the same unit.
        margin: that far beyond the reward is 0.1.

    Source: Tunyasuvunakool et al. 2020, dm_control: Software and Tasks for Continuous Control,
    Software Impacts 6 (`tolerance` with a long tail).
    """
    beyond = max(distance - within, 0.0) / margin
    return 1.0 / (1.0 + 9.0 * beyond * beyond)
