"""What all environments are: episodes of control steps with a checked action each."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import dm_env
import mujoco
import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from ..errors import SimulationError
from ..simulate.plant import Plant
from .actions import AnyAction, checked_action

Array = NDArray[np.float64]


class EpisodicEnvironment(dm_env.Environment):  # type: ignore[misc]
    """Episodes of a simulated robot that an agent drives.

    An episode ends when it is over, with discount 1: it could go on. It ends as well when the
    motion has become unstable, with reward and discount 0 and the observation before; `error`
    says where and when. Actions beyond their bounds are cut off, as the robot's drives do it.

    Args:
        robot: that the agent drives.
        action: what it commands.

    Attributes:
        robot: its declaration.
        episode: number of the current one, from 0; -1 before the first. Set it to k - 1 and the
            next episode is number k.
        error: what ended the last episode, or None.
    """

    def __init__(self, robot: SerialRobot, action: AnyAction) -> None:
        self.robot = robot
        self.episode = -1
        self.error: SimulationError | None = None
        self._action = action
        self._is_over = True
        self._observation: dict[str, Array] = {}

    @property
    @abstractmethod
    def plant(self) -> Plant:
        """The simulation of the current episode: pushes, payloads, sensors."""

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model: what `env.physics.model` is in dm_control."""
        return self.plant.model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's state: what `env.physics.data` is in dm_control."""
        return self.plant.data

    @abstractmethod
    def _begin(self) -> None:
        """Begins the episode of number `episode`."""

    @abstractmethod
    def _advance(self, action: Array) -> bool:
        """Lets a control step pass; returns whether the episode is over."""

    @abstractmethod
    def _observe(self) -> dict[str, Array]:
        """What is seen now, in arrays of its own."""

    @abstractmethod
    def reward(self) -> float:
        """0 to 1, for the state now."""

    def reset(self) -> dm_env.TimeStep:
        """Begins the next episode."""
        self.episode += 1
        self.error, self._is_over = None, False
        self._begin()
        self._observation = self._observe()
        return dm_env.restart(self._observation)

    def step(self, action: Any) -> dm_env.TimeStep:
        """Lets a control step pass; after the end of an episode the next one begins.

        Args:
            action: (n,), see `action_spec`.

        Raises:
            ValueError: it is not n numbers.
            SimulationError: one is NaN or infinite; names the joint. Nothing has been moved.
        """
        if self._is_over:
            return self.reset()
        spec, unit = self._action.spec, self._action.unit
        checked = checked_action(action, spec, self.robot, unit, self.plant.time)
        try:
            self._is_over = self._advance(checked)
        except SimulationError as error:
            self.error, self._is_over = error, True
            # Whoever got it before may have changed it.
            before = {name: value.copy() for name, value in self._observation.items()}
            return dm_env.TimeStep(dm_env.StepType.LAST, 0.0, 0.0, before)
        self._observation = self._observe()
        end = dm_env.truncation if self._is_over else dm_env.transition
        return end(self.reward(), self._observation)

    def action_spec(self) -> specs.BoundedArray:
        """Joint torques, Nm, or offsets of the target, rad, with their bounds."""
        return self._action.spec

    def reward_spec(self) -> specs.BoundedArray:
        """A number from 0 to 1."""
        return specs.BoundedArray((), float, 0.0, 1.0, name="reward")

    @abstractmethod
    def render(
        self, height: int = 480, width: int = 640, camera: str | None = None
    ) -> NDArray[np.uint8]:
        """Renders the state now.

        Args:
            height: pixels.
            width: pixels.
            camera: `azimuth,elevation,distance` (degrees, degrees, m), or a camera's name.

        Returns:
            (height, width, 3), 0 to 255.

        Raises:
            RenderError: no OpenGL, or the size is out of range.
            UnknownName: no such camera.
        """
