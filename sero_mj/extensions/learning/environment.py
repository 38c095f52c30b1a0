"""A scenario in which an agent controls one robot, as a `dm_env.Environment`."""

from __future__ import annotations

import copy
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import dm_env
import mujoco
import numpy as np
from dm_env import specs
from numpy.typing import NDArray
from pydantic import Field

from ...base.declaration import Declaration
from ...base.errors import Problem, SimulationError, UnknownName
from ...base.frames import Array
from ...data.drive.mirror import Mirror
from ...robots.assemble.robot_dynamics import robot_dynamics
from ...robots.assemble.world import World
from ...robots.declared.mounts import base_frames, unmounted
from ...robots.declared.robot import SerialRobot
from ...simulate.control.compiler import Compiler
from ...simulate.control.torque_loop import LoopGains
from ...simulate.plant import Plant
from ...simulate.runs.run_log import event_of
from ...simulate.runs.run_source import RunSource
from ...simulate.scenario import Scenario
from ...simulate.simulated_scene import with_routes
from ...simulate.simulation import Simulation
from ...viewer.image.image_options import DEFAULT_SIZE
from ...viewer.image.render import HeadlessRenderer
from .actions import (
    Action,
    AgentController,
    ImpedanceAction,
    Kind,
    TorqueAction,
    checked_action,
)  # fmt: skip
from .tasks import AgentRobot, Episode, Task

if TYPE_CHECKING:
    from ...viewer.window.host import Window

# Margin of observed angles beyond the limits in rad and m, because end stops are elastic.
LIMIT_MARGIN = {"revolute": 0.2, "prismatic": 0.05}
# Maximum frequency of a motor with the default stiffness, rad/s; low for steps of 1 ms.
_MAX_FREQUENCY = 40.0


class Settings(Declaration):
    """Options of all environments.

    Attributes:
        action: joint torques, or target offsets of an impedance controller.
        control_timestep: time between two actions, s.
        seed: random seed; equal seeds give equal episodes.
        stiffness: stiffness of the impedance controller for all joints or for each joint, Nm/rad
            (default: 500, and less for joints with small motors).
        damping: damping ratio of the impedance controller for all joints or for each joint.
    """

    action: Kind = "torque"
    control_timestep: float = Field(0.02, ge=1e-4, le=1.0)
    seed: int = Field(0, ge=0, lt=2**32)
    stiffness: Any = None
    damping: Any = 0.7

    def substeps(self, timestep: float) -> int:
        """Returns the number of simulation steps in a control step.

        Raises:
            DeclarationError: the control step is not a whole number of simulation steps.
        """
        ratio = self.control_timestep / timestep
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            raise Problem(
                "control_timestep",
                found=self.control_timestep,
                of="s",
                expected=f"a whole number of steps of {timestep:g} s",
            ).error()
        return round(ratio)

    def make_action(self, robot: SerialRobot, timestep: float) -> Action:
        if self.action == "torque":
            return TorqueAction(robot)
        stiffness = _default_stiffness(robot) if self.stiffness is None else self.stiffness
        return ImpedanceAction(robot, self.control_timestep, timestep, stiffness, self.damping)


def _default_stiffness(robot: SerialRobot) -> Array:
    inertia = robot_dynamics(robot).motor_inertias
    return np.where(inertia > 0, np.minimum(500.0, inertia * _MAX_FREQUENCY**2), 500.0)


class _EpisodeRun:
    """Lets `RunSource` display the current episode. `advance` does nothing: the agent steps it."""

    drag_force = live = None

    def __init__(self, environment: Environment) -> None:
        self._environment = environment

    def __getattr__(self, name: str) -> Any:
        return getattr(self._environment.simulation, name)

    def advance(self, to_step: int) -> None:
        pass


class Environment(dm_env.Environment):  # type: ignore[misc]
    """An environment in which an agent controls one robot of a scenario.

    An episode ends with discount 1 at the end of the scenario. If the simulation becomes unstable,
    it ends with reward 0, discount 0 and the previous observation, and `error` contains the reason.
    Actions are clipped to their bounds. Episode k depends only on the seed and on k.

    Args:
        scenario: scenario, which is not modified.
        robot: name of the robot that the agent controls.
        task: task of the agent.
        settings: options of the environment; None for the defaults.
        random_start: whether episodes begin in random poses instead of the declared one.

    Attributes:
        scenario: copy of the scenario, in which the agent replaces the controller of the robot.
        settings: options of the environment.
        substeps: number of simulation steps in a control step.
        simulation: current episode; `simulation.outcomes()` evaluates expectations.
        task: task in the current episode, with attributes such as `task.target` of `reach`.
        seed: random seed.
        episode: number of the current episode, from 0; -1 before the first episode. Set it to k - 1
            to continue with episode k.
        error: error that ended the last episode, or None.
        columns: columns of the log by name of the observation.
        bounds: lower and upper bounds of observed angles by name, shape (n,) each.

    Raises:
        UnknownName: there is no such robot.
        DeclarationError: the settings do not fit the robot.
    """

    def __init__(
        self,
        scenario: Scenario,
        robot: str,
        task: Task,
        settings: Settings | None = None,
        *,
        random_start: bool = False,
    ) -> None:
        settings = settings or Settings()
        robots, timestep = scenario.scene.robots, scenario.run.timestep
        if robot not in robots:
            raise UnknownName("robot", robot, robots)
        self.settings, self._random_start = settings, random_start
        self.substeps = settings.substeps(timestep)
        self._action = settings.make_action(robots[robot], timestep)
        self._compiler = Compiler()
        own = unmounted(robots[robot], base_frames(robots)[robot])
        if scenario.run.torque_control:
            gains = LoopGains.of(own.torque_control, robot_dynamics(own), own.elastic_joints)
            own = gains.shaped(own)
        model = self._compiler.robot_model(own, scenario.run.gravity)
        self._agent = AgentController(self._action, robots[robot], model, timestep)
        self.scenario = copy.copy(scenario)
        self.scenario.controllers = {**scenario.controllers, robot: self._agent}
        self.simulation = Simulation(self.scenario, settings.seed, self._compiler)
        if self.simulation.whole_body is not None:
            mounting = self.simulation.whole_body.mounting(robot)
            model.follow((mounting, own.base_frame, own.n))
        self._robot = AgentRobot(self.simulation, robot)
        self.task: Episode = task.make(self._robot)
        self.seed, self.episode = settings.seed, -1
        self.error: SimulationError | None = None
        self._is_over = True
        self._observation: dict[str, Array] = {}
        self._find_columns(task.observed)
        self._mirror: Mirror | None = None
        self._renderer: HeadlessRenderer | None = None
        self._window: Window | None = None
        self._shape: tuple[int, int, str | None] = (0, 0, None)
        self._open = ExitStack()

    def _find_columns(self, observed: tuple[str, ...]) -> None:
        columns = self.simulation.layout.columns
        self.columns: dict[str, slice] = {}
        self.bounds: dict[str, tuple[Array, Array]] = {}
        for name, robot in self.simulation.robots.items():
            prefix = "" if name == self._robot.name else f"{name}/"
            for signal in observed:
                if event_of(name, signal) in columns:
                    self.columns[f"{prefix}{signal}"] = columns[event_of(name, signal)]
            if robot.position_limits is not None:
                slack = np.array([LIMIT_MARGIN[kind] for kind in robot.types])
                low, high = robot.plausible_limits.T
                self.bounds[f"{prefix}joint_angles"] = (low - slack, high + slack)

    @property
    def robot(self) -> SerialRobot:
        """The robot that the agent controls."""
        return self._robot.declared

    @property
    def plant(self) -> Plant:
        """The simulated robots with pushes, payloads and sensors.

        Changes persist across episodes, except for a scenario with disturbances or faults, which
        has a new plant in every episode.
        """
        return self._robot.plant

    @property
    def world(self) -> World:
        return self.plant.world

    @property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model, like `env.physics.model` in dm_control."""
        return self.plant.model

    @property
    def data(self) -> mujoco.MjData:
        """The MuJoCo data, like `env.physics.data` in dm_control."""
        return self.plant.data

    @property
    def action(self) -> Action:
        return self._action

    @property
    def base_frame(self) -> Array:
        """The current T_world_base of the agent's robot."""
        return self._robot.base()

    @property
    def is_over(self) -> bool:
        """Whether the episode has ended, so that the next step begins another episode."""
        return self._is_over

    @property
    def control_timestep(self) -> float:
        """Time between two actions, s."""
        return self.settings.control_timestep

    def reset(self) -> dm_env.TimeStep:
        """Begins the next episode."""
        self.episode += 1
        self.error, self._is_over = None, False
        rng = np.random.default_rng([self.seed, self.episode])
        start, noise = self._draw_start(rng)
        self._restart(start, noise)
        self._agent.begin_at(start)
        self.task.begin(rng)
        self._observation = self._observe()
        return dm_env.restart(self._observation)

    def _draw_start(self, rng: np.random.Generator) -> tuple[Array, int]:
        # Returns joint values, shape (n,), and the seed of the noise.
        start = np.asarray(self.robot.home, np.float64)
        if self._random_start:
            start = self._robot.free_pose(rng)
        return start, int(rng.integers(2**32))

    def place(self, seed: int, episode: int) -> Array:
        """Moves the robot to the start of an episode, and begins the task, without a simulation.

        `ManyEnvironments` uses this and simulates the episode itself. Returns the joint values.
        """
        self._is_over = True
        rng = np.random.default_rng([seed, episode])
        start, self.plant.sensors.seed = self._draw_start(rng)
        self.plant.reset(start)
        self.task.begin(rng)
        return start

    def _restart(self, start: Array, seed: int) -> None:
        if self.scenario.disturbances or self.scenario.faults:  # these have changed the model
            self.simulation = Simulation(self.scenario, seed, self._compiler)
            self._robot.simulation = self.simulation
        if self._random_start or not (self.scenario.disturbances or self.scenario.faults):
            angles = {name: robot.home for name, robot in self.simulation.robots.items()}
            angles[self._robot.name] = start
            self.simulation.restart(np.concatenate(list(angles.values())), seed)
        if self._mirror is not None:
            self._mirror.open()  # resets the displayed state

    def step(self, action: Any) -> dm_env.TimeStep:
        """Simulates a control step, or begins the next episode if the current one has ended.

        Raises:
            ValueError: the action does not have the shape (n,).
            SimulationError: the action has NaN or infinity; nothing is simulated.
        """
        if self._is_over:
            return self.reset()
        simulation, spec = self.simulation, self._action.spec
        checked = checked_action(action, spec, self.robot, self._action.unit, self.plant.time)
        self.task.advance()
        self._action.take(checked)
        try:
            simulation.advance(simulation.step + self.substeps)
        except SimulationError as error:
            self.error, self._is_over = error, True
            # These arrays belong to the caller of the previous step, so copies are returned.
            before = {name: value.copy() for name, value in self._observation.items()}
            return dm_env.TimeStep(dm_env.StepType.LAST, 0.0, 0.0, before)
        self.plant.rows.physics.forward()  # updates `data` as `mj_step` does
        self._is_over = simulation.is_done
        self._observation = self._observe()
        end = dm_env.truncation if self._is_over else dm_env.transition
        return end(self.reward(), self._observation)

    def _observe(self) -> dict[str, Array]:
        row = self.simulation.rows[self.simulation.step]
        found = {name: row[columns].copy() for name, columns in self.columns.items()}
        for name, (low, high) in self.bounds.items():
            np.clip(found[name], low, high, out=found[name])
        return {**found, **self._action.observation(), **self.task.observation()}

    def reward(self) -> float:
        """Returns the reward of the current state, 0 to 1."""
        return self.task.reward()

    def action_spec(self) -> specs.BoundedArray:
        """Returns the bounds of joint torques (Nm, N) or target offsets (rad, m)."""
        return self._action.spec

    def reward_spec(self) -> specs.BoundedArray:
        return specs.BoundedArray((), float, 0.0, 1.0, name="reward")

    def observation_spec(self) -> dict[str, specs.Array]:
        """Returns the shapes and bounds of observations by name, in SI units.

        Observations of other robots have a prefix, for example `ROBOT/joint_angles`.
        """
        found: dict[str, specs.Array] = {}
        for name, columns in self.columns.items():
            shape = (columns.stop - columns.start,)
            found[name] = (
                specs.BoundedArray(shape, np.float64, *self.bounds[name], name=name)
                if name in self.bounds
                else specs.Array(shape, np.float64, name=name)
            )
        return {**found, **self._action.observation_spec(), **self.task.observation_spec()}

    def render(
        self, height: int = 480, width: int = 640, camera: str | None = None
    ) -> NDArray[np.uint8]:
        """Returns an image of the current state, shape (height, width, 3), uint8.

        `camera` is `azimuth,elevation,distance` (degrees, degrees, m) or the name of a camera.

        Raises:
            RenderError: OpenGL is not available, or the size is invalid.
            UnknownName: there is no such camera.
        """
        if self._renderer is None or self._shape != (height, width, camera):
            self.close()
            mirror = self._open_mirror()
            renderer = HeadlessRenderer(mirror.world, width, height, camera)
            self._renderer = self._open.enter_context(renderer)
            self._shape = (height, width, camera)
        mirror = self._show_state()
        return self._renderer.render(mirror.data)

    def show(self, camera: str | None = None) -> bool:
        """Shows the current state in an interactive window without waiting.

        Returns False after the user has closed the window.

        Raises:
            RenderError: there is no display or no OpenGL.
            UnknownName: there is no such camera.
        """
        if self._window is None:
            from ...viewer.window.host import Window

            self.close()
            mirror = self._open_mirror()
            window = Window(mirror, size=DEFAULT_SIZE, camera=camera)
            self._window = self._open.enter_context(window)
            window.shows_status = False  # simulated time is not real time
        self._show_state()
        clock = self._window.clock
        clock.time, clock.is_paused = self.simulation.time, True
        return self._window.is_open and self._window.frame(wait=False)

    def _open_mirror(self) -> Mirror:
        source = RunSource(run=_EpisodeRun(self))
        scene = with_routes(self.scenario, self.simulation.layout.columns, source)
        self._mirror = self._open.enter_context(Mirror(scene))
        return self._mirror

    def _show_state(self) -> Mirror:
        assert self._mirror is not None
        for target, values in self.task.inputs().items():
            self._mirror.world.set_input(self._mirror.data, target, values)
        self._mirror.advance(self.simulation.time)
        return self._mirror

    def close(self) -> None:
        """Closes the window and releases OpenGL resources."""
        self._mirror = self._renderer = self._window = None
        self._open.close()
