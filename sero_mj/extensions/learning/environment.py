"""`Environment`: a scenario in which an agent drives one robot, as a `dm_env.Environment`."""

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
from ...data.receive.structure import Structure
from ...robots.assemble.robot_dynamics import robot_dynamics
from ...robots.assemble.world import World
from ...robots.declared.mounts import base_frames, unmounted
from ...robots.declared.robot import SerialRobot
from ...simulate.control.compiler import Compiler
from ...simulate.control.torque_loop import LoopGains
from ...simulate.plant import Plant
from ...simulate.runs.monitor import Finding
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

# rad, m: how far springs let joints into their stops, and observations beyond their limits
BEYOND = {"revolute": 0.2, "prismatic": 0.05}
_FASTEST_SPRING = 40.0  # rad/s, of a motor on its spring: slow against steps of 1 ms


class Settings(Declaration):
    """Options of all environments.

    Attributes:
        action: what an agent commands: joint torques, or offsets of an impedance's target.
        control_timestep: s between two actions.
        seed: of everything that is random; the same seed gives the same episodes.
        stiffness: Nm/rad, one for all joints or one each; where actions are target offsets. By
            default 500, and less where a joint's motor is too light for it.
        damping: ratio, likewise.
    """

    action: Kind = "torque"
    control_timestep: float = Field(0.02, ge=1e-4, le=1.0)
    seed: int = Field(0, ge=0, lt=2**32)
    stiffness: Any = None
    damping: Any = 0.7

    def substeps(self, timestep: float) -> int:
        """Steps of the simulation in a control step.

        Args:
            timestep: of the simulation, s.

        Raises:
            DeclarationError: a control step is no whole number of them.
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
        """What an agent commands a robot, at a timestep of the simulation in s."""
        if self.action == "torque":
            return TorqueAction(robot)
        stiffness = _usual_stiffness(robot) if self.stiffness is None else self.stiffness
        return ImpedanceAction(robot, self.control_timestep, timestep, stiffness, self.damping)


def _usual_stiffness(robot: SerialRobot) -> Array:
    """Returns what every joint can have at 1 kHz, (n,), Nm/rad; 500 for those of an LWR."""
    inertia = robot_dynamics(robot).motor_inertias
    return np.where(inertia > 0, np.minimum(500.0, inertia * _FASTEST_SPRING**2), 500.0)


class _DrivenRun:
    """The current episode as a run that goes as far as its agent has driven it; for `RunSource`."""

    drag_force = live = None  # the agent drives it, nobody else

    def __init__(self, environment: Environment) -> None:
        self._environment = environment

    def findings(self) -> list[Finding]:
        return self._environment.simulation.findings()

    @property
    def about(self) -> str:
        return self._environment.simulation.about

    @property
    def structure(self) -> Structure:
        return self._environment.simulation.structure

    @property
    def rows(self) -> Array:
        """(T, width); those behind `step` have only their times."""
        return self._environment.simulation.rows

    @property
    def times(self) -> Array:
        """Of the rows, (T,), s."""
        return self._environment.simulation.times

    @property
    def step(self) -> int:
        return self._environment.simulation.step

    def advance(self, to_step: int) -> None:
        """Does nothing: that is up to the agent."""


class Environment(dm_env.Environment):  # type: ignore[misc]
    """Episodes of a scenario in which an agent drives one robot.

    Everything else happens as the scenario declares it. An episode ends with the scenario, with
    discount 1: it could go on. It ends as well when the motion has become unstable, with reward and
    discount 0 and the observation before; `error` says where and when. Actions beyond their bounds
    are cut off, as the robot's drives do it. Number k depends on the seed and on k alone.

    Args:
        scenario: what happens; it is left as it is.
        robot: name of the one that the agent drives.
        task: what it is to do.
        settings: how it is driven; the usual ones when None.
        random_start: whether episodes begin in random poses, else as the robot is declared.

    Attributes:
        scenario: as given, with the agent in the place of the robot's controller.
        settings: how it is driven.
        substeps: steps of the simulation in a control step.
        simulation: the current episode; `simulation.outcomes()` says what has held.
        task: the task from episode to episode; `task.target` of `reach`, for instance.
        seed: of everything that is random; as the settings have it, until another is set.
        episode: number of the current one, from 0; -1 before the first. Set it to k - 1 and the
            next episode is number k.
        error: what ended the last episode, or None.
        columns: of what is observed of the log, by its name in observations.
        bounds: low and high, (n,), to which angles are cut off in observations, likewise.

    Raises:
        UnknownName: no such robot.
        DeclarationError: what does not fit the robot.
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
                slack = np.array([BEYOND[kind] for kind in robot.types])
                low, high = robot.plausible_limits.T
                self.bounds[f"{prefix}joint_angles"] = (low - slack, high + slack)

    @property
    def robot(self) -> SerialRobot:
        """The declaration of the robot that the agent drives."""
        return self._robot.declared

    @property
    def plant(self) -> Plant:
        """The simulated robots: pushes, payloads, sensors.

        What is changed there stays over episodes, but where the scenario has disturbances or
        faults: then every episode has a new one.
        """
        return self._robot.plant

    @property
    def world(self) -> World:
        """What is simulated, with names and ids."""
        return self.plant.world

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model: what `env.physics.model` is in dm_control."""
        return self.plant.model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's state: what `env.physics.data` is in dm_control."""
        return self.plant.data

    @property
    def action(self) -> Action:
        """What the agent commands."""
        return self._action

    @property
    def base_frame(self) -> Array:
        """T_world_base of the agent's robot now, (4, 4), m."""
        return self._robot.base()

    @property
    def is_over(self) -> bool:
        """Whether no episode goes on: the next step begins one."""
        return self._is_over

    @property
    def control_timestep(self) -> float:
        """Between two actions, s."""
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
        """Draws how an episode begins: (n,) joint angles, rad or m, and the seed of the noise."""
        start = np.asarray(self.robot.home, np.float64)
        if self._random_start:
            start = self._robot.free_pose(rng)
        return start, int(rng.integers(2**32))

    def place(self, seed: int, episode: int) -> Array:
        """Puts the plant of a robot alone where an episode begins, and begins its task.

        For those who simulate elsewhere: the own episode is over.

        Returns:
            (n,), the joint angles, rad or m.
        """
        self._is_over = True
        rng = np.random.default_rng([seed, episode])
        start, self.plant.sensors.seed = self._draw_start(rng)
        self.plant.reset(start)
        self.task.begin(rng)
        return start

    def _restart(self, start: Array, seed: int) -> None:
        """Begins the simulation anew.

        Args:
            start: (n,), angles of the agent's robot, rad or m.
        """
        if self.scenario.disturbances or self.scenario.faults:  # these change the model
            self.simulation = Simulation(self.scenario, seed, self._compiler)
            self._robot.simulation = self.simulation
        if self._random_start or not (self.scenario.disturbances or self.scenario.faults):
            angles = {name: robot.home for name, robot in self.simulation.robots.items()}
            angles[self._robot.name] = start
            self.simulation.restart(np.concatenate(list(angles.values())), seed)
        if self._mirror is not None:
            self._mirror.open()  # discards the state shown

    def step(self, action: Any) -> dm_env.TimeStep:
        """Simulates a control step; after the end of an episode the next one begins.

        Args:
            action: (n,), see `action_spec`.

        Raises:
            ValueError: it is not n numbers.
            SimulationError: one is NaN or infinite; names the joint. Nothing has been moved.
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
            # Whoever got it before may have changed it.
            before = {name: value.copy() for name, value in self._observation.items()}
            return dm_env.TimeStep(dm_env.StepType.LAST, 0.0, 0.0, before)
        self.plant.rows.physics.forward()  # `data` is as up to date as after MuJoCo's own step
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
        """0 to 1, for the state now."""
        return self.task.reward()

    def action_spec(self) -> specs.BoundedArray:
        """Joint torques, Nm, or offsets of the target, rad, with their bounds."""
        return self._action.spec

    def reward_spec(self) -> specs.BoundedArray:
        """A number from 0 to 1."""
        return specs.BoundedArray((), float, 0.0, 1.0, name="reward")

    def observation_spec(self) -> dict[str, specs.Array]:
        """Names, shapes and bounds; rad, rad/s, Nm, m; of other robots as `ROBOT/joint_angles`."""
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
        """Renders the state now, as `sero-mj simulate --render` would.

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
        if self._renderer is None or self._shape != (height, width, camera):
            self.close()
            mirror = self._open_mirror()
            renderer = HeadlessRenderer(mirror.world, width, height, camera)
            self._renderer = self._open.enter_context(renderer)
            self._shape = (height, width, camera)
        mirror = self._show_now()
        return self._renderer.render(mirror.data)

    def show(self, camera: str | None = None) -> bool:
        """Shows the state now in a window, with mouse and keys; at once, without waiting.

        Returns:
            whether the window is open: its user has not closed it.

        Raises:
            RenderError: no display, or no OpenGL.
            UnknownName: no such camera.
        """
        if self._window is None:
            from ...viewer.window.host import Window

            self.close()
            mirror = self._open_mirror()
            window = Window(mirror, size=DEFAULT_SIZE, camera=camera)
            self._window = self._open.enter_context(window)
            window.shows_status = False  # its clock is not the user's
        self._show_now()
        clock = self._window.clock
        clock.time, clock.is_paused = self.simulation.time, True
        return self._window.is_open and self._window.frame(wait=False)

    def _open_mirror(self) -> Mirror:
        source = RunSource(run=_DrivenRun(self))
        scene = with_routes(self.scenario, self.simulation.layout.columns, source)
        self._mirror = self._open.enter_context(Mirror(scene))
        return self._mirror

    def _show_now(self) -> Mirror:
        assert self._mirror is not None
        for target, values in self.task.inputs().items():
            self._mirror.world.set_input(self._mirror.data, target, values)
        self._mirror.advance(self.simulation.time)
        return self._mirror

    def close(self) -> None:
        """Closes the window, and frees what OpenGL has."""
        self._mirror = self._renderer = self._window = None
        self._open.close()
