"""`RobotEnvironment`: one simulated robot with a task, as a `dm_env.Environment`."""

from __future__ import annotations

from typing import Any

import dm_env
import mujoco
import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from ..assemble.world import World
from ..errors import SimulationError
from ..simulate.plant import Plant
from .actions import checked_action
from .arm import Arm, Settings
from .picture import Picture
from .task import Task

Array = NDArray[np.float64]


class RobotEnvironment(dm_env.Environment):  # type: ignore[misc]
    """A simulated robot with a task.

    An episode ends at its time limit, with discount 1: it could go on. It ends as well when the
    motion has become unstable, with reward and discount 0 and the observation before; `error`
    says where and when. Episode number k depends on the seed and on k alone.

    Actions beyond their bounds are cut off, as the robot's drives do it.

    Args:
        robot: its declaration.
        task: what it is to do.
        settings: how it is driven; the usual ones when None.

    Attributes:
        arm: the robot at work.
        task: the task at work; `task.target` of `reach`, for instance.
        episode: number of the current one, from 0; -1 before the first. Set it to k - 1 and the
            next episode is number k.
        error: what ended the last episode, or None.

    Raises:
        DeclarationError: what does not fit the robot.
    """

    def __init__(self, robot: SerialRobot, task: Task, settings: Settings | None = None) -> None:
        self.arm = Arm(robot, settings or Settings())
        self.task = task.make(self.arm)
        self.episode = -1
        self.error: SimulationError | None = None
        self._arrows = task.arrows(robot.name)
        self._picture: Picture | None = None
        self._steps = max(round(self.arm.settings.time_limit / self.control_timestep), 1)
        self._step = self._steps
        self._observation: dict[str, Array] = {}
        self._action_spec = self.arm.action.spec

    @property
    def plant(self) -> Plant:
        """The simulation: pushes, payloads, sensors; its changes stay over episodes."""
        return self.arm.plant

    @property
    def world(self) -> World:
        """What is simulated, with names and ids."""
        return self.arm.plant.world

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model: what `env.physics.model` is in dm_control."""
        return self.arm.plant.model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's state: what `env.physics.data` is in dm_control."""
        return self.arm.plant.data

    @property
    def control_timestep(self) -> float:
        """Between two actions, s."""
        return self.arm.settings.control_timestep

    def reset(self) -> dm_env.TimeStep:
        """Begins the next episode."""
        self.episode += 1
        self.error = None
        self._step = 0
        rng = np.random.default_rng([self.arm.settings.seed, self.episode])
        self.arm.begin(rng)
        self.task.begin(rng)
        self._observation = {**self.arm.observation(), **self.task.observation()}
        return dm_env.restart(self._observation)

    def step(self, action: Any) -> dm_env.TimeStep:
        """Lets a control step pass; after the end of an episode the next one begins.

        Args:
            action: (n,), see `action_spec`.

        Raises:
            ValueError: it is not n numbers.
            SimulationError: one is NaN or infinite; names the joint. Nothing has been moved.
        """
        if self._step >= self._steps:
            return self.reset()
        arm = self.arm
        checked = checked_action(action, self._action_spec, arm.robot, arm.action.unit, arm.time)
        self.task.advance()
        try:
            arm.step(checked)
        except SimulationError as error:
            self.error = error
            self._step = self._steps
            return dm_env.TimeStep(dm_env.StepType.LAST, 0.0, 0.0, _copies(self._observation))
        self._step += 1
        self._observation = {**arm.observation(), **self.task.observation()}
        reward = self.task.reward()
        if self._step >= self._steps:
            return dm_env.truncation(reward, self._observation)
        return dm_env.transition(reward, self._observation)

    def action_spec(self) -> specs.BoundedArray:
        """Joint torques, Nm, or offsets of the target, rad, with their bounds."""
        return self._action_spec

    def observation_spec(self) -> dict[str, specs.Array]:
        """Names, shapes and bounds; rad, rad/s, Nm, m."""
        return {**self.arm.observation_spec(), **self.task.observation_spec()}

    def reward_spec(self) -> specs.BoundedArray:
        """A number from 0 to 1."""
        return specs.BoundedArray((), float, 0.0, 1.0, name="reward")

    def render(
        self, height: int = 480, width: int = 640, camera: str | None = None
    ) -> NDArray[np.uint8]:
        """Renders the state now, with arrows on the torques and a double at the goal.

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


def _copies(observation: dict[str, Array]) -> dict[str, Array]:
    """The same in arrays of its own, for whoever got it before may have changed them."""
    return {name: value.copy() for name, value in observation.items()}
