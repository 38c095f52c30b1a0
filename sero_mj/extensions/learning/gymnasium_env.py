"""`GymnasiumEnvironment`: an `Environment` with gymnasium's interface.

Actions are shares of what `Environment.action_spec` allows, -1 to 1. Observations are those of the
`Environment` within bounds that are finite: ten times what limits of velocity and torque allow, and
what the robot can reach. What is beyond is cut off.
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

_BEYOND = 10.0  # times the limits of velocities and torques, and the ranges of joints
_USUAL_TORQUE = 1e3  # Nm, N; where a robot has no limits


class GymnasiumEnvironment(gymnasium.Env[Any, Any]):
    """Episodes of an `Environment`.

    They are truncated at their end, and terminated when the motion has become unstable, with
    `info["error"]`. Episode k after `reset(seed=s)` depends on s and k alone.

    Args:
        render_mode: `rgb_array`, `human` (a window, at real time) or None.
        width: of pictures, pixels.
        camera: `azimuth,elevation,distance` (degrees, degrees, m), or a camera's name.

    Raises:
        DeclarationError: no such render mode.
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
        self._picture = (height, width, camera)
        self._is_seeded = False
        self._shown = 0.0  # when the last picture was shown in the window, s

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins the next episode.

        Args:
            seed: of this and the following ones; else these go on, from a random seed at first
                where none was among the environment's options.
        """
        super().reset(seed=seed)
        if seed is not None:
            begin_with(self.environment, seed)
        step = self.environment.reset()
        if self.render_mode == "human":
            self._show()
        return self._within(step.observation), {"episode": self.environment.episode}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Simulates a control step.

        Args:
            action: (n,), -1 to 1 of what the robot may be asked for; what is beyond is cut off.

        Raises:
            SimulationError: it is NaN or infinite; names the joint. Nothing has been moved.
            gymnasium.error.ResetNeeded: the episode has ended, or none was begun.
        """
        environment = self.environment
        if environment.is_over:
            raise gymnasium.error.ResetNeeded("found no episode; expected reset() before step()")
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
        """The state now, (height, width, 3); None where it is in a window, or nowhere."""
        if self.render_mode != "rgb_array":
            return None
        height, width, camera = self._picture
        return self.environment.render(height, width, camera)

    def _show(self) -> None:
        left = self._shown + self.environment.control_timestep - time.monotonic()
        if left > 0:
            time.sleep(left)
        self.environment.show(self._picture[2])
        self._shown = time.monotonic()

    def close(self) -> None:
        """Closes the window, and frees what pictures take."""
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
    """What `gymnasium.make` calls.

    Args:
        name: as for `make_environment`, or None with `robot` and `task`, or with `scenario`.
        render_mode: see `GymnasiumEnvironment`; so are the next three.
        **options: of `make_environment`.

    Raises:
        UnknownName: no such robot, task or scenario.
        DeclarationError: everything that is wrong with the options, or in a file.
    """
    name, options = chosen(name, options)
    environment = make_environment(name, **options)
    if "seed" not in options:
        environment.seed = int(np.random.SeedSequence().generate_state(1)[0])
    return GymnasiumEnvironment(environment, render_mode, width=width, height=height, camera=camera)


def chosen(name: str | None, options: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """The name of an environment, and its options, of what was given to `gymnasium.make`.

    Raises:
        DeclarationError: it says neither a robot nor a scenario.
    """
    if name is not None:
        return name, options
    options = dict(options)
    if "task" in options:
        task, robot = options.pop("task"), options.pop("robot", None)
        if isinstance(robot, Mapping):  # with fields over those of the robot's file
            fields = dict(robot)
            robot = fields.pop("model", None)
            options["robot"] = fields
        if robot is None:
            message = 'is required; expected the name, folder or file of one: robot="panda"'
            raise Problem("robot", message).error()
        return f"{robot}/{task}", options
    if "scenario" not in options:
        message = 'is required; expected a name or a file: scenario="my.toml"'
        raise Problem("scenario", message).error()
    return str(options.pop("scenario")), options


def begin_with(environment: Environment, seed: int) -> None:
    """Lets the next episode be the first one of a seed."""
    environment.seed, environment.episode = seed, -1


def action_space(environment: Environment) -> spaces.Box:
    """Shares of what a robot may be asked for, (n,)."""
    return spaces.Box(-1.0, 1.0, environment.action_spec().shape, np.float32)


def observation_space(bounds: Mapping[str, tuple[Array, Array]]) -> spaces.Dict:
    """What is within bounds."""
    return spaces.Dict(
        {name: spaces.Box(low, high, dtype=np.float64) for name, (low, high) in bounds.items()}
    )


def observation_bounds(environment: Environment) -> dict[str, tuple[Array, Array]]:
    """Finite bounds of every observation, low and high, by its name."""
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
        most = _BEYOND * joint_speeds(robot, "agent")
    elif signal.endswith("torques"):
        usual = np.full(robot.n, _USUAL_TORQUE)
        most = _BEYOND * (usual if robot.torque_limits is None else robot.torque_limits)
    elif signal.endswith("angles"):
        most = _BEYOND * np.abs(robot.display_ranges).max(axis=1)
    else:  # a position
        table = robot.kinematics
        strokes = np.abs(robot.display_ranges).max(axis=1)[~table.revolute]
        lengths = [table.step_lengths().sum(), strokes.sum()]
        reach = float(sum(lengths) + np.abs(robot.T_n_flange[:3, 3]).sum())
        most = np.full(spec.shape, 2.0 * reach + np.abs(robot.base_frame[:3, 3]).max())
    low = np.broadcast_to(getattr(spec, "minimum", -np.inf), spec.shape)
    high = np.broadcast_to(getattr(spec, "maximum", np.inf), spec.shape)
    return np.where(np.isfinite(low), low, -most), np.where(np.isfinite(high), high, most)
