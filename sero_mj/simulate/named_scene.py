"""Scenes by name, whatever the name is one of: what commands and `sero_mj.view` are given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .. import paths
from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..drive.mirror import load_scene
from ..errors import UnknownName, UsageError, did_you_mean
from .sections import is_scenario


def read_named_scene(name: str, given: dict[str, Any] | None = None) -> Scene:
    """Returns the scene that a name or a file means: a scene, a robot alone, or a scenario.

    Args:
        name: a TOML file, or the name of a shipped scene, scenario or robot.
        given: `robot.field` to its value, over what the file says.

    Raises:
        UnknownName: none of these.
        SeroError: what is wrong in the file, or in what is given.
    """
    given = given or {}
    try:
        path = paths.find_scene(name)
    except UnknownName as error:
        if name in paths.list_scenarios():
            return _read_staged(name, given)
        try:
            paths.find_model(name)
        except UnknownName as no_model:
            available = [*paths.list_scenes(), *paths.list_scenarios(), *no_model.available]
            hint = paths.file_hint(name)
            raise UnknownName("scene or robot", name, available, hint) from error
        return Scene(robots=[read_model(name, given)], name=name)
    if _is_robot_file(path):
        return Scene(robots=[read_model(str(path), given)], name=path.parent.name)
    if is_scenario(path):
        return _read_staged(str(path), given)
    return load_scene(path, given)


def _read_staged(name: str, given: dict[str, Any]) -> Scene:
    """Returns the scene of a scenario, which is simulated while it is shown.

    Raises:
        SeroError: what is wrong in the file.
    """
    # What simulates is read where something is to be simulated.
    from .scenario_file import read_scenario
    from .simulated_scene import simulated_scene
    from .simulation import Simulation

    return simulated_scene(Simulation(read_scenario(name, given)))


def read_model(name: str, settings: dict[str, Any] | None = None) -> SerialRobot:
    """Returns the robot that `name` means, with fields set over its file's."""
    fields = {}
    robot = paths.find_model(name).parent.name
    for key, value in (settings or {}).items():
        given, _, field = key.partition(".")
        if given != robot:
            near = did_you_mean(given, [robot])
            raise UsageError(f"--set {key}: no robot '{given}'{near}")
        if field in ("model", "name"):
            raise UsageError(f"--set {key}: which robot it is cannot be set")
        fields[field] = value
    return SerialRobot.from_model(name, **fields)


def _is_robot_file(path: Path) -> bool:
    return path.name == "robot.toml"
