"""`ScenarioEnvironment`: an agent in the place of a scenario's controller."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from dm_env import specs
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from ..assemble.robot import SerialRobot
from ..control.compiler import Compiler
from ..control.controllers import make_controller
from ..control.gains import ControllerDeclaration
from ..control.robot_model import RobotModel
from ..control.state import Sensed, Target
from ..control.torque_limits import Controller
from ..declaration import Declaration
from ..drive.mirror import Mirror
from ..errors import DeclarationError, Problem, UnknownName
from ..runs.measures import MEASURES
from ..runs.run_log import RunLog, event_of
from ..runs.run_source import RunSource
from ..show.headless.renderer import HeadlessRenderer
from ..simulate.expect import Expect
from ..simulate.plant import Plant
from ..simulate.scenario import Scenario
from ..simulate.scenario_file import read_scenario
from ..simulate.simulated_scene import with_routes
from ..simulate.simulation import Simulation
from .actions import AnyAction, ImpedanceAction, Kind, TorqueAction
from .episodes import EpisodicEnvironment

Array = NDArray[np.float64]

# What an agent sees of every robot, and where the log has it.
_SEEN = {
    "joint_angles": "angles",
    "joint_velocities": "velocities",
    "torques": "torques",
    "external_torques": "external_torques",
    "target_angles": "target_angles",
    "target_velocities": "target_velocities",
}


class ScenarioSettings(Declaration):
    """What an environment of a scenario has.

    Attributes:
        robot: whose controller the agent takes the place of; the first one when None.
        action: what it commands: joint torques, or offsets of an impedance's target.
        control_timestep: s between two actions.
        seed: of everything that is random; the same seed gives the same episodes.
        stiffness: Nm/rad, one for all joints or one each; where actions are target offsets.
        damping: ratio, likewise.
        overrides: dotted key to its value, over the scenario's file: `{"run.duration": 2.0}`.
    """

    robot: str | None = None
    action: Kind = "torque"
    control_timestep: float = Field(0.02, ge=1e-4, le=1.0)
    seed: int = Field(0, ge=0, lt=2**32)
    stiffness: Any = 500.0
    damping: Any = 0.7
    overrides: Mapping[str, Any] = Field(default_factory=dict)


class Agent(ControllerDeclaration):
    """A controller that does what an agent has last said.

    Attributes:
        action: that it goes by.
        robot: whose controller it is.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)
    action: Any
    robot: Any

    def make(self, model: RobotModel, timestep: float) -> Controller:
        """The controller at work."""
        return AgentAtWork(self.action, self.robot, model, timestep)


class AgentAtWork:
    """`Agent` in one episode."""

    def __init__(
        self, action: AnyAction, robot: SerialRobot, model: RobotModel, timestep: float
    ) -> None:
        self._action = action
        self._target = Target(robot.n)
        self._inner = make_controller(action.controller, model, timestep, robot.torque_limits)
        action.begin(self._target, np.asarray(robot.home, np.float64))

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,)."""
        self._action.advance()
        self._inner.torques(sensed, self._target, out)

    def check(self, angles: Array) -> None:
        """Refuses gains for which the time step is too long."""
        self._inner.check(angles)


class ScenarioEnvironment(EpisodicEnvironment):
    """A scenario in which an agent drives one robot; all else happens as it is declared.

    The reward is the mean over what is expected of a measure at this time: 1 while it is within
    its bounds, `below / value` or `value / above` beyond them, and 1 where nothing is expected.
    Expectations of findings, of `rms` and of `mean` are judged at the end alone, by `outcomes`.

    Episodes end with the scenario. Every episode is a new `Simulation`; the noise of number k comes
    from the seed and k.

    Args:
        scenario: a file, the name of a shipped one, or a `Scenario` (whose controller is replaced).
        settings: what is asked of it.

    Attributes:
        scenario: as it was read.
        simulation: the current episode; `simulation.outcomes()` says what has held.

    Raises:
        UnknownName: no such scenario or robot.
        DeclarationError: what is wrong in the file, or does not fit the robot.
    """

    def __init__(
        self, scenario: Scenario | Path | str, settings: ScenarioSettings | None = None
    ) -> None:
        settings = settings or ScenarioSettings()
        if not isinstance(scenario, Scenario):
            scenario = read_scenario(scenario, settings.overrides)
        robots = scenario.scene.robots
        name = next(iter(robots)) if settings.robot is None else settings.robot
        if name not in robots:
            raise UnknownName("robot", name, robots)
        self.scenario, self._settings = scenario, settings
        timestep = scenario.run.timestep
        ratio = settings.control_timestep / timestep
        self._substeps = round(ratio)
        if self._substeps < 1 or abs(ratio - self._substeps) > 1e-6:
            found = f"found {settings.control_timestep:g} s; expected a whole number of steps of"
            raise DeclarationError([Problem("control_timestep", f"{found} {timestep:g} s")])
        action: AnyAction = (
            TorqueAction(robots[name])
            if settings.action == "torque"
            else ImpedanceAction(
                robots[name], settings.control_timestep, timestep, settings.stiffness,
                settings.damping,
            )
        )  # fmt: skip
        super().__init__(robots[name], action)
        scenario.controllers[name] = Agent(action=action, robot=self.robot)
        self._expected = [
            each
            for each in scenario.expect.values()
            if each.measure is not None and each.of in ("max", "min", "final")
        ]
        self._compiler = Compiler()
        self._view: tuple[Mirror, HeadlessRenderer] | None = None
        self._shape: tuple[int, int, str | None] = (0, 0, None)
        self._open = ExitStack()
        self._make_simulation()

    def _make_simulation(self) -> None:
        rng = np.random.default_rng([self._settings.seed, max(self.episode, 0)])
        self.simulation = Simulation(self.scenario, int(rng.integers(2**32)), self._compiler)
        self._columns = self._find_columns()

    def _find_columns(self) -> dict[str, slice]:
        """Name of an observation to its columns in the log."""
        layout, found = self.simulation.layout, {}
        for name in self.scenario.scene.robots:
            prefix = "" if name == self.robot.name else f"{name}/"
            for key, signal in _SEEN.items():
                if event_of(name, signal) in layout.columns:
                    found[f"{prefix}{key}"] = layout.columns[event_of(name, signal)]
        return found

    @property
    def plant(self) -> Plant:
        """The simulation of the current episode."""
        return self.simulation.plant

    def _observe(self) -> dict[str, Array]:
        row = self.simulation.rows[self.simulation.step]
        found = {name: row[columns].copy() for name, columns in self._columns.items()}
        return {**found, **self._action.observation()}

    def _begin(self) -> None:
        if self.simulation.step or self.episode > 0:
            self.close()  # what is shown is of the simulation before
            self._make_simulation()

    def _advance(self, action: Array) -> bool:
        self._action.take(action)
        self.simulation.advance(self.simulation.step + self._substeps)
        return self.simulation.is_done

    def reward(self) -> float:
        """0 to 1, for the state now."""
        simulation = self.simulation
        now = simulation.time
        active = [
            each
            for each in self._expected
            if each.after - 1e-9 <= now <= (np.inf if each.before is None else each.before) + 1e-9
        ]
        if not active:
            return 1.0
        log = RunLog.from_rows(  # the first row is what drift counts from
            simulation.layout,
            simulation.rows[[0, simulation.step]],
            self.scenario.scene.robots,
        )
        return float(np.mean([_share(each, log) for each in active]))

    def observation_spec(self) -> dict[str, specs.Array]:
        """Names and shapes; those of other robots begin with `ROBOT/`."""
        found: dict[str, specs.Array] = {
            name: specs.Array((columns.stop - columns.start,), np.float64, name=name)
            for name, columns in self._columns.items()
        }
        return {**found, **self._action.observation_spec()}

    def render(
        self, height: int = 480, width: int = 640, camera: str | None = None
    ) -> NDArray[np.uint8]:
        """Renders the state now, as `sero-mj simulate --render` would; (height, width, 3)."""
        simulation = self.simulation
        if self._view is None or self._shape != (height, width, camera):
            self.close()
            source = RunSource(run=simulation)
            scene = with_routes(self.scenario, simulation.layout, source)
            mirror = self._open.enter_context(Mirror(scene))
            renderer = HeadlessRenderer(mirror.world, width, height, camera)
            self._view = (mirror, self._open.enter_context(renderer))
            self._source, self._shape = source, (height, width, camera)
        mirror, renderer = self._view
        self._source.advance_to(simulation.time)
        mirror.advance()
        return renderer.render(mirror.data)

    def close(self) -> None:
        """Frees what OpenGL has."""
        self._view = None
        self._open.close()


def _share(expect: Expect, log: RunLog) -> float:
    """How far a measure is from what is expected, 1 to 0, in the last row of a log."""
    assert expect.measure is not None
    measure = MEASURES[expect.measure][1]
    found = [1.0]
    for robot in log.robots if expect.robot is None else [expect.robot]:
        values = np.abs(measure(log, robot)[-1])
        if expect.joints and len(values) > 1:
            names = log.robots[robot].names
            values = values[[k for k, name in enumerate(names) if name in expect.joints]]
        if not len(values):
            continue
        if expect.below is not None:
            value = float(values.max())
            found.append(1.0 if value < expect.below else max(expect.below, 0.0) / value)
        if expect.above is not None:
            value = float(values.min() if expect.of == "min" else values.max())
            found.append(1.0 if value > expect.above else value / expect.above)
    return min(found)
