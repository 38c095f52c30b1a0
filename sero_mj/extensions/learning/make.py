"""Creates environments by name and options."""

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
    last = "every scenario, with an agent instead of the controller"
    return "environments, for sero_mj.make_environment (dm_env)", [*lines, last]


class ScenarioSettings(Settings):
    """Options of an environment that runs a scenario.

    Attributes:
        robot: robot that the agent controls; None for the first robot.
        overrides: values that override the file, for example `{"run.duration": 2.0}`.
    """

    robot: str | None = None
    overrides: Mapping[str, Any] = Field(default_factory=dict)


class RobotSettings(Settings):
    """Options of an environment with a robot and a task.

    Attributes:
        time_limit: duration of an episode, s.
        timestep: time step of the simulation, s.
        sensors: sensor errors, as in `[sensors.NAME]` of a scenario.
        start: start pose: `random`, `home` (the declared joint values), or joint values, rad or m.
        robot: values that override the robot file, for example `{"show_billboards": True}`.
    """

    time_limit: float = Field(5.0, gt=0, le=1e4)
    timestep: float = Field(0.001, ge=1e-5, le=0.02)
    sensors: Mapping[str, Any] = Field(default_factory=dict)
    start: Literal["random", "home"] | list[float] = "random"
    robot: Mapping[str, Any] = Field(default_factory=dict)

    def make_scenario(self, robot: SerialRobot, task: Task) -> Scenario:
        """Returns a scenario with only this robot, whose scene shows the goal of the task.

        Raises:
            DeclarationError: the start, sensors or times do not fit the robot.
        """
        steps = max(round(self.time_limit / self.control_timestep), 1)
        name = robot.name
        # Images show true values, not measured ones.
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
            runaway_speed=0.0,  # high speeds are normal while an agent learns
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
                    f"joint {robot.names[joint]} starts at",
                    found=angles[joint],
                    expected=f"{low:.4g} to {high:.4g}",
                ).error()
        return angles


def list_environments() -> list[str]:
    """Returns the names of the environments for included robots and scenarios."""
    return [f"{robot}/{task}" for robot in list_models() for task in TASKS] + list_scenarios()


def make_environment(name: str, **options: Any) -> Environment:
    """Creates a `dm_env.Environment`. Close it after rendering.

    Args:
        name: `ROBOT/TASK`, for example `lwr/reach`, with the name, folder or file of a robot and
            the task `reach` or `hold`; or the name or TOML file of a scenario.
        **options: fields of `RobotSettings` and of the task (`Reach`, `Hold`), or of
            `ScenarioSettings`.

    Raises:
        UnknownName: there is no such robot, task or scenario.
        DeclarationError: the options or a file have errors; the exception contains all errors.
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
    own = {key: value for key, value in known.items() if key in _fields(TASKS[kind])}
    settings = RobotSettings(**{key: value for key, value in known.items() if key not in own})
    robot = SerialRobot.from_model(model, **{"show_arrows": True, **settings.robot})
    task = TASKS[kind](**own)
    return Environment(
        settings.make_scenario(robot, task), robot.name, task, settings,
        random_start=settings.start == "random",
    )  # fmt: skip


def _fields(kind: type[Declaration]) -> list[str]:
    return [*kind.model_fields, *kind.renamed]


def _known(options: dict[str, Any], *kinds: type[Declaration]) -> dict[str, Any]:
    fields = [field for kind in kinds for field in _fields(kind)]
    problems = [
        Problem(key, "unknown option", available=fields) for key in options if key not in fields
    ]
    if problems:
        raise DeclarationError(problems)
    return {
        key: np.asarray(value).tolist() if isinstance(value, tuple | np.ndarray) else value
        for key, value in options.items()
    }
