"""`make_environment`: environments by their names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..assemble.robot import SerialRobot
from ..declaration import Declaration
from ..errors import DeclarationError, Problem, UnknownName, did_you_mean
from ..paths import list_models, list_scenarios
from ..simulate.scenario import Scenario
from ..simulate.scenario_file import read_scenario
from .environment import Environment
from .expectations import Expectations
from .hold import Hold
from .reach import Reach
from .settings import RobotSettings, ScenarioSettings
from .task import Task

TASKS: dict[str, type[Task]] = {"reach": Reach, "hold": Hold}


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
    robot, slash, task = name.rpartition("/")
    if name.endswith(".toml") or name in list_scenarios():
        return scenario_environment(name, ScenarioSettings(**_known(options, ScenarioSettings)))
    if not slash or not robot:
        raise UnknownName("environment", name, list_environments())
    if task not in TASKS:
        raise UnknownName(f"task of {robot}", task, TASKS)
    kind = TASKS[task]
    known = _known(options, RobotSettings, kind)
    own = {key: value for key, value in known.items() if key in kind.model_fields}
    settings = RobotSettings(**{key: value for key, value in known.items() if key not in own})
    fields = {"show_arrows": True, **settings.robot}
    return robot_environment(SerialRobot.from_model(robot, **fields), kind(**own), settings)


def robot_environment(
    robot: SerialRobot, task: Task, settings: RobotSettings | None = None
) -> Environment:
    """A robot alone with a task.

    Args:
        robot: its declaration.
        task: what it is to do.
        settings: how it is driven; the usual ones when None.

    Raises:
        DeclarationError: what does not fit the robot.
    """
    settings = settings or RobotSettings()
    scenario = settings.make_scenario(robot, task)
    return Environment(
        scenario, robot.name, task, settings, random_start=settings.start == "random"
    )


def scenario_environment(
    scenario: Scenario | Path | str, settings: ScenarioSettings | None = None
) -> Environment:
    """A scenario in which an agent takes the place of a robot's controller.

    Args:
        scenario: a file, the name of a shipped one, or a `Scenario`, which is left as it is.
        settings: how the robot is driven; the usual ones when None.

    Raises:
        UnknownName: no such scenario or robot.
        DeclarationError: what is wrong in the file, or does not fit the robot.
    """
    settings = settings or ScenarioSettings()
    if not isinstance(scenario, Scenario):
        scenario = read_scenario(scenario, settings.overrides)
    robot = next(iter(scenario.scene.robots)) if settings.robot is None else settings.robot
    return Environment(scenario, robot, Expectations(), settings)


def _known(options: dict[str, Any], *kinds: type[Declaration]) -> dict[str, Any]:
    """The options, if all of them are fields of one of these."""
    fields = [field for kind in kinds for field in kind.model_fields]
    problems = [
        Problem(key, f"unknown option{did_you_mean(key, fields)}")
        for key in options
        if key not in fields
    ]
    if problems:
        raise DeclarationError(problems)
    return {
        key: np.asarray(value).tolist() if isinstance(value, tuple | np.ndarray) else value
        for key, value in options.items()
    }
