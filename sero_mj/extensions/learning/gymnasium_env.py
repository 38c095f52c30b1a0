"""An `Environment` with the interface of Gymnasium.

Actions are scaled from the bounds of `Environment.action_spec` to -1 to 1. Observations are clipped
to finite bounds: ten times the limits of velocity and torque, and twice the reach of the robot.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Literal, get_args

import gymnasium
import numpy as np
from dm_env import specs
from gymnasium import spaces
from numpy.typing import NDArray

from ...base.errors import Problem
from ...base.frames import Array
from ...robots.declared.joint_speeds import joint_speeds
from ...robots.declared.robot import SerialRobot
from .environment import Environment
from .make import make_environment

RenderMode = Literal["human", "rgb_array"]
Observation = dict[str, Array]

_BOUND_FACTOR = 10.0  # ratio of bounds to limits of velocity and torque, and to joint ranges
_DEFAULT_TORQUE = 1e3  # Nm or N, for robots without torque limits


class GymnasiumEnvironment(gymnasium.Env[Any, Any]):
    """A Gymnasium environment with the episodes of an `Environment`.

    An episode is truncated at its end, and terminated with `info["error"]` if the simulation
    becomes unstable. Episode k after `reset(seed=s)` depends only on s and k.

    Args:
        environment: environment to simulate.
        render_mode: `rgb_array`, `human` (a window in real time) or None.
        width: width of images, pixels.
        height: height of images, pixels.
        camera: `azimuth,elevation,distance` (degrees, degrees, m) or the name of a camera.

    Raises:
        DeclarationError: there is no such render mode.
    """

    def __init__(
        self,
        environment: Environment,
        render_mode: RenderMode | None = None,
        *,
        width: int = 640,
        height: int = 480,
        camera: str | None = None,
    ) -> None:
        modes = get_args(RenderMode)
        if render_mode is not None and render_mode not in modes:
            raise Problem("render_mode", found=render_mode, available=modes).error()
        self.environment = environment
        self.render_mode = render_mode
        self.metadata = {
            "render_modes": list(modes),
            "render_fps": max(round(1.0 / environment.control_timestep), 1),
        }
        self.bounds = observation_bounds(environment)
        self.observation_space = observation_space(self.bounds)
        self.action_space = action_space(environment)
        self._scale: Array = environment.action_spec().maximum
        self._image = (height, width, camera)
        self._shown = 0.0  # time of the last frame in the window, s

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins the next episode, or the first episode of a seed if `seed` is not None.

        If no seed has been set, the first seed is random.
        """
        super().reset(seed=seed)
        if seed is not None:
            self.environment.seed, self.environment.episode = seed, -1
        step = self.environment.reset()
        if self.render_mode == "human":
            self._show()
        return self._within(step.observation), {"episode": self.environment.episode}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulates a control step with an action from -1 to 1, shape (n,).

        Raises:
            SimulationError: the action has NaN or infinity; nothing is simulated.
            gymnasium.error.ResetNeeded: the episode has ended or not begun.
        """
        environment = self.environment
        if environment.is_over:
            raise gymnasium.error.ResetNeeded("there is no episode; call reset() before step()")
        step = environment.step(np.asarray(action, np.float64) * self._scale)
        terminated = environment.error is not None
        info = {"error": str(environment.error)} if terminated else {}
        if self.render_mode == "human":
            self._show()
        observation = self._within(step.observation)
        return observation, float(step.reward), terminated, step.last() and not terminated, info

    def _within(self, observation: Mapping[str, Array]) -> Observation:
        return {name: np.clip(value, *self.bounds[name]) for name, value in observation.items()}

    def render(self) -> Any:
        """Returns an image, shape (height, width, 3), or None if the mode is not `rgb_array`."""
        if self.render_mode != "rgb_array":
            return None
        height, width, camera = self._image
        return self.environment.render(height, width, camera)

    def _show(self) -> None:
        left = self._shown + self.environment.control_timestep - time.monotonic()
        if left > 0:
            time.sleep(left)
        self.environment.show(self._image[2])
        self._shown = time.monotonic()

    def close(self) -> None:
        """Closes the window and releases OpenGL resources."""
        self.environment.close()


def make_gymnasium_environment(
    name: str | None = None,
    *,
    render_mode: RenderMode | None = None,
    width: int = 640,
    height: int = 480,
    camera: str | None = None,
    **options: Any,
) -> GymnasiumEnvironment:
    """Creates a `GymnasiumEnvironment`. Called by `gymnasium.make`.

    `name` and `options` are those of `make_environment`. If `name` is None, the options contain
    `robot` and `task`, or `scenario`.
    """
    name, options = name_and_options(name, options)
    environment = make_environment(name, **options)
    if "seed" not in options:
        environment.seed = int(np.random.SeedSequence().generate_state(1)[0])
    return GymnasiumEnvironment(environment, render_mode, width=width, height=height, camera=camera)


def name_and_options(name: str | None, options: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Converts the arguments of `gymnasium.make` to a name and options for `make_environment`.

    Raises:
        DeclarationError: there is neither a robot nor a scenario.
    """
    if name is not None:
        return name, options
    options = dict(options)
    if "task" in options:
        task, robot = options.pop("task"), options.pop("robot", None)
        if isinstance(robot, Mapping):  # `model` and fields that override its file
            fields = dict(robot)
            robot = fields.pop("model", None)
            options["robot"] = fields
        if robot is None:
            message = 'is required; expected a name, folder or file such as robot="panda"'
            raise Problem("robot", message).error()
        return f"{robot}/{task}", options
    if "scenario" not in options:
        message = 'is required; expected a name or a file such as scenario="my.toml"'
        raise Problem("scenario", message).error()
    return str(options.pop("scenario")), options


def action_space(environment: Environment) -> spaces.Box:
    """Returns the space of scaled actions, -1 to 1."""
    return spaces.Box(-1.0, 1.0, environment.action_spec().shape, np.float32)


def observation_space(bounds: Mapping[str, tuple[Array, Array]]) -> spaces.Dict:
    """Returns the space of observations from their lower and upper bounds."""
    return spaces.Dict(
        {name: spaces.Box(low, high, dtype=np.float64) for name, (low, high) in bounds.items()}
    )


def observation_bounds(environment: Environment) -> dict[str, tuple[Array, Array]]:
    """Returns a mapping from observation names to finite lower and upper bounds."""
    found = {}
    for name, spec in environment.observation_spec().items():
        other, slash, signal = name.rpartition("/")
        robots = environment.simulation.robots
        robot = robots[other] if slash else environment.robot
        low, high = _bounds(robot, signal, spec)
        found[name] = (np.array(low, np.float64), np.array(high, np.float64))
    return found


def _bounds(robot: SerialRobot, signal: str, spec: specs.Array) -> tuple[Array, Array]:
    if signal.endswith("velocities"):
        bound = _BOUND_FACTOR * joint_speeds(robot, "agent")
    elif signal.endswith("torques"):
        default = np.full(robot.n, _DEFAULT_TORQUE)
        bound = _BOUND_FACTOR * (default if robot.torque_limits is None else robot.torque_limits)
    elif signal.endswith("angles"):
        bound = _BOUND_FACTOR * np.abs(robot.display_ranges).max(axis=1)
    else:  # a position
        table = robot.kinematics
        strokes = np.abs(robot.display_ranges).max(axis=1)[~table.revolute]
        lengths = [table.step_lengths().sum(), strokes.sum()]
        reach = float(sum(lengths) + np.abs(robot.T_n_flange[:3, 3]).sum())
        bound = np.full(spec.shape, 2.0 * reach + np.abs(robot.base_frame[:3, 3]).max())
    low = np.broadcast_to(getattr(spec, "minimum", -np.inf), spec.shape)
    high = np.broadcast_to(getattr(spec, "maximum", np.inf), spec.shape)
    return np.where(np.isfinite(low), low, -bound), np.where(np.isfinite(high), high, bound)
