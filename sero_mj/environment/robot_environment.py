"""`RobotEnvironment`: one simulated robot with a task, as a `dm_env.Environment`."""

from __future__ import annotations

import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from ..assemble.world import World
from ..simulate.plant import Plant
from .arm import Arm, Settings
from .episodes import EpisodicEnvironment
from .picture import Picture
from .task import Task

Array = NDArray[np.float64]


class RobotEnvironment(EpisodicEnvironment):
    """A simulated robot with a task.

    An episode ends at its time limit; number k depends on the seed and on k alone.

    Args:
        robot: its declaration.
        task: what it is to do.
        settings: how it is driven; the usual ones when None.

    Attributes:
        arm: the robot at work.
        task: the task at work; `task.target` of `reach`, for instance.

    Raises:
        DeclarationError: what does not fit the robot.
    """

    def __init__(self, robot: SerialRobot, task: Task, settings: Settings | None = None) -> None:
        self.arm = Arm(robot, settings or Settings())
        super().__init__(robot, self.arm.action)
        self.task = task.make(self.arm)
        self._arrows = task.arrows(robot.name)
        self._picture: Picture | None = None
        self._steps = max(round(self.arm.settings.time_limit / self.control_timestep), 1)
        self._step = 0

    @property
    def plant(self) -> Plant:
        """The simulation: pushes, payloads, sensors; its changes stay over episodes."""
        return self.arm.plant

    @property
    def world(self) -> World:
        """What is simulated, with names and ids."""
        return self.arm.plant.world

    @property
    def control_timestep(self) -> float:
        """Between two actions, s."""
        return self.arm.settings.control_timestep

    def _begin(self) -> None:
        self._step = 0
        rng = np.random.default_rng([self.arm.settings.seed, self.episode])
        self.arm.begin(rng)
        self.task.begin(rng)

    def _advance(self, action: Array) -> bool:
        self.task.advance()
        self.arm.step(action)
        self._step += 1
        return self._step >= self._steps

    def _observe(self) -> dict[str, Array]:
        return {**self.arm.observation(), **self.task.observation()}

    def reward(self) -> float:
        """0 to 1, for the state now."""
        return self.task.reward()

    def observation_spec(self) -> dict[str, specs.Array]:
        """Names, shapes and bounds; rad, rad/s, Nm, m."""
        return {**self.arm.observation_spec(), **self.task.observation_spec()}

    def render(
        self, height: int = 480, width: int = 640, camera: str | None = None
    ) -> NDArray[np.uint8]:
        """Renders the state, with arrows on the torques and a double at the goal; (h, w, 3)."""
        if self._picture is None:
            self._picture = Picture(self.arm.robot, self._arrows)
        arm = self.arm
        values = {
            "joint_angles": arm.truth[0],
            "torques": arm.truth[2],
            "commanded_torques": arm.commanded_torques,
        }
        return self._picture.render(
            height, width, camera, values, self.task.goal(), self.task.arrows()
        )

    def close(self) -> None:
        """Frees what OpenGL has."""
        if self._picture is not None:
            self._picture.close()
