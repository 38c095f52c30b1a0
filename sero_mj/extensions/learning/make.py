"""`make_environment`: environments by their names, and their options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field

from ...base.declaration import Declaration
from ...base.errors import DeclarationError, Problem, UnknownName
from ...base.frames import Array
from ...base.paths import list_models, list_scenarios
from ...robots.declared.double import Double
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from ...simulate.runs.run_log import event_of
from ...simulate.scenario import Scenario
from ...simulate.scenario_file import read_scenario
from ...simulate.simulated_scene import SOURCE
from .environment import Environment, Settings
from .tasks import GOAL, Expectations, Hold, Reach, Task

TASKS: dict[str, type[Task]] = {"reach": Reach, "hold": Hold}


def described_environments() -> tuple[str, list[str]]:
    """Returns a title and a line for each kind of environment, for `sero-mj list`."""
    lines = [
        f"{f'{robot}/{name}':18} {(task.__doc__ or '').splitlines()[0]}"
        for robot in list_models()
        for name, task in TASKS.items()
    ]
    last = "and every scenario, with an agent in the place of its controller"
    return "environments, for sero_mj.make_environment (dm_env)", [*lines, last]


class ScenarioSettings(Settings):
    """Options of the environment of a scenario.

    Attributes:
        robot: whose controller the agent takes the place of; the first one when None.
        overrides: dotted key to its value, over the scenario's file: `{"run.duration": 2.0}`.
    """

    robot: str | None = None
    overrides: Mapping[str, Any] = Field(default_factory=dict)


class RobotSettings(Settings):
    """Options of the environment of a robot with a task.

    Attributes:
        time_limit: s, of an episode.
        timestep: s between two steps of the simulation.
        sensors: what they add to the truth, as in a scenario's `[sensors.NAME]`.
        start: `random`, `home` (as the robot is declared), or joint angles, rad or m.
        robot: fields over those of the robot's file: `{"show_billboards": True}`.
    """

    time_limit: float = Field(5.0, gt=0, le=1e4)
    timestep: float = Field(0.001, ge=1e-5, le=0.02)
    sensors: Mapping[str, Any] = Field(default_factory=dict)
    start: Literal["random", "home"] | list[float] = "random"
    robot: Mapping[str, Any] = Field(default_factory=dict)

    def make_scenario(self, robot: SerialRobot, task: Task) -> Scenario:
        """A scenario of a robot alone; it stands at its start, or within its limits.

        Args:
            robot: its declaration: `show_arrows` and the like are what pictures show.
            task: whose goal and arrows are in the pictures as well.

        Raises:
            DeclarationError: the start, sensors or times do not fit.
        """
        steps = max(round(self.time_limit / self.control_timestep), 1)
        name = robot.name
        # Pictures show true values, not measured ones.
        actual = {"joint_angles": "actual_angles", "torques": "actual_torques"}
        scene = Scene(
            robots=[robot.model_copy(update={"joint_angles": self._home(robot)})],
            doubles=[Double(name=f"{name}_{GOAL}", of=name)],
            arrows=task.arrows(name),
            routes={
                f"{name}.{key}": f"{SOURCE}.{event_of(name, signal)}"
                for key, signal in actual.items()
            },
            name=name,
        )
        return Scenario(
            scene,
            sensors={name: self.sensors},
            duration=steps * self.control_timestep,
            timestep=self.timestep,
            show_targets=False,
            runaway_speed=0.0,  # agents that still learn fling robots about
            name=name,
        )

    def _home(self, robot: SerialRobot) -> Array:
        limits = robot.position_limits
        if isinstance(self.start, str):
            home = np.asarray(robot.home, np.float64)
            if limits is None or self.start == "home":
                return home
            return np.clip(home, limits[:, 0], limits[:, 1])
        angles = np.asarray(self.start, np.float64)
        if angles.shape != (robot.n,):
            raise Problem(
                "start", found=angles.size, of="numbers", expected=f"{robot.n}, one per joint"
            ).error()
        if limits is not None:
            bad = (angles < limits[:, 0]) | (angles > limits[:, 1])
            if bad.any():
                joint = int(np.argmax(bad))
                low, high = limits[joint]
                raise Problem(
                    "start",
                    f"joint {robot.names[joint]} is to be at",
                    found=angles[joint],
                    expected=f"{low:.4g} to {high:.4g}",
                ).error()
        return angles


def list_environments() -> list[str]:
    """Names of the environments of shipped robots and scenarios."""
    return [f"{robot}/{task}" for robot in list_models() for task in TASKS] + list_scenarios()


def make_environment(name: str, **options: Any) -> Environment:
    """Makes a `dm_env.Environment`.

    Args:
        name: `ROBOT/TASK`, e.g. `lwr/reach`: a shipped robot, or the folder or file of one, with
            the task `reach` or `hold`; or a scenario, shipped or a TOML file.
        **options: of `RobotSettings` (`action`, `time_limit`, `control_timestep`, `timestep`,
            `seed`, `sensors`, `start`, `robot`, `stiffness`, `damping`) and of the task (`Reach`,
            `Hold`); of a scenario those of `ScenarioSettings`.

    Returns:
        the environment; `close` it when it has been rendered.

    Raises:
        UnknownName: no such robot, task or scenario.
        DeclarationError: everything that is wrong with the options, or in a file.
    """
    if name.endswith(".toml") or name in list_scenarios():
        chosen = ScenarioSettings(**_known(options, ScenarioSettings))
        scenario = read_scenario(name, chosen.overrides)
        agent = next(iter(scenario.scene.robots)) if chosen.robot is None else chosen.robot
        return Environment(scenario, agent, Expectations(), chosen)
    model, slash, kind = name.rpartition("/")
    if not slash or not model:
        raise UnknownName("environment", name, list_environments())
    if kind not in TASKS:
        raise UnknownName(f"task of {model}", kind, TASKS)
    known = _known(options, RobotSettings, TASKS[kind])
    own = {key: value for key, value in known.items() if key in TASKS[kind].model_fields}
    settings = RobotSettings(**{key: value for key, value in known.items() if key not in own})
    robot = SerialRobot.from_model(model, **{"show_arrows": True, **settings.robot})
    task = TASKS[kind](**own)
    return Environment(
        settings.make_scenario(robot, task), robot.name, task, settings,
        random_start=settings.start == "random",
    )  # fmt: skip


def _known(options: dict[str, Any], *kinds: type[Declaration]) -> dict[str, Any]:
    fields = [field for kind in kinds for field in kind.model_fields]
    problems = [
        Problem(key, "unknown option", available=fields) for key in options if key not in fields
    ]
    if problems:
        raise DeclarationError(problems)
    return {
        key: np.asarray(value).tolist() if isinstance(value, tuple | np.ndarray) else value
        for key, value in options.items()
    }
