"""What an environment's tasks have in common."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from ..assemble.cartesian import SmartArrow
from ..declaration import Declaration

if TYPE_CHECKING:
    from .arm import Arm

Array = NDArray[np.float64]


class TaskAtWork(Protocol):
    """A task in an environment, from episode to episode."""

    def begin(self, rng: np.random.Generator) -> None:
        """Begins an episode; the robot stands where it starts."""

    def advance(self) -> None:
        """Begins a control step: lets happen what happens in it."""

    def reward(self) -> float:
        """0 to 1, for the state now."""

    def observation(self) -> dict[str, Array]:
        """What an agent has to know of the task."""

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of that."""

    def goal(self) -> Array:
        """Joint angles, (n,), at which a transparent double stands."""

    def arrows(self) -> dict[str, Array]:
        """Vectors to be shown, (3,), by the names in the task's `arrows`."""


class Task(Declaration):
    """Base of the declarations of tasks."""

    def make(self, arm: Arm) -> TaskAtWork:
        """The task at work on a robot."""
        raise NotImplementedError

    def arrows(self, robot: str) -> list[SmartArrow]:
        """What pictures of it show beside the robot and a double at its goal."""
        return []
