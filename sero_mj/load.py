"""Loads scenes, scenarios, robots and groups of robots by file or included name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .base import paths, trust
from .base.errors import (
    DeclarationError,
    Problem,
    UnknownName,
    UsageError,
    collect,
    nearest,
    raise_any,
)
from .data.drive.wiring import wire
from .robots.declared.robot import SerialRobot
from .robots.declared.scene import Scene
from .robots.declared.scene_file import read_scene_file, scene_from_tables
from .robots.importers.imported_tables import NoJoints
from .robots.importers.importer import find_importer, is_robot_file
from .simulate.sections import is_scenario

if TYPE_CHECKING:
    from .simulate.scenario import Scenario


def load_scene(
    name: Path | str,
    overrides: Mapping[str, Any] | None = None,
    *,
    by_hand: bool = False,
    trusted: bool = False,
    replay: Path | None = None,
) -> Scene:
    """Loads and checks a scene without opening its sources.

    For a robot or a group of robots, the scene contains nothing else. For a scenario, the scene
    simulates the scenario while it is shown. If a scenario requests programs and is not trusted,
    the scene is not simulated, and `scene.withheld` contains the request.

    Args:
        name: a file (TOML, X3D), or the name of an included scene, scenario, robot or group.
        overrides: mapping from `robot.field` to values that replace the values of the file. An
            overridden input, such as `lwr.joint_angles`, has no route.
        by_hand: whether users can pull the robots of a scenario in a window or on a page.
        trusted: whether a scenario may start programs and load libraries.
            Pass True only for a file that the user has chosen to simulate, see `base.trust`.
        replay: recording of the scenario to play instead of simulating.

    Raises:
        UnknownName: there is no such file or included name.
        DeclarationError: the file has errors; the exception contains all errors.
        UsageError: `overrides` contains a robot other than the loaded robot.
    """
    name, overrides = str(name), dict(overrides or {})

    def load_scenario(name: str) -> Scene:
        return _load_scenario(name, overrides, by_hand=by_hand, trusted=trusted, replay=replay)

    try:
        path = paths.find_scene(name)
    except UnknownName as error:
        if name in paths.list_scenarios():
            return load_scenario(name)
        try:
            path = paths.find_model(name)
        except UnknownName as no_robot:
            try:
                path = paths.find_group_model(name)
            except UnknownName as no_group:
                models = [*no_robot.available, *no_group.available]
                available = [*paths.list_scenes(), *paths.list_scenarios(), *models]
                hint = paths.file_hint(name)
                if not hint and nearest(name, available) is None:
                    hint = no_robot.hint
                raise UnknownName("scene or robot", name, available, hint) from error
    if is_robot_file(path):
        own = paths.model_name(path)
        try:
            robot = load_robot(str(path), overrides)
        except NoJoints:
            importer = find_importer(path)
            if importer is None or not importer.object_key:
                raise
            body = {importer.object_key: path.name}
            tables = {"name": own, "floor": "below", "objects": {own: body}}
            return _checked(*scene_from_tables(path, tables, overrides))
        # The floor is below the whole robot, because the base may be a trunk.
        overridden = {f"robots.{own}.{key.split('.')[1]}": 0 for key in overrides if "." in key}
        return Scene(robots=[robot], floor="below", name=own, lines=overridden)
    if path.name == paths.GROUP_FILE:
        own = path.resolve().parent.name
        tables = {"name": own, "groups": {own: {"model": path}}}
        return _checked(*scene_from_tables(path, tables, overrides))
    if is_scenario(path):
        return load_scenario(str(path))
    return _checked(*read_scene_file(path, overrides))


def _checked(scene: Scene, problems: list[Problem]) -> Scene:
    problems = problems + scene.located(wire(scene).problems)
    raise_any(problems)
    return scene


def load_robot(name: str, overrides: Mapping[str, Any] | None = None) -> SerialRobot:
    """Loads a robot. `overrides` maps `robot.field` to values that replace values of the file.

    Raises:
        UnknownName: there is no such robot.
        DeclarationError: the file or `overrides` has errors; the exception contains all errors.
        UsageError: `name` is the name of a group of robots.
    """
    fields: dict[str, Any] = {}
    wrong: list[Problem] = []
    try:
        path = paths.find_model(name)
    except UnknownName:
        _refuse_group(name)
        raise
    if path.name == paths.GROUP_FILE:
        _refuse_group(name)
    robot = paths.model_name(path)
    for key, value in (overrides or {}).items():
        owner, _, field = key.partition(".")
        if owner != robot:
            wrong.append(Problem(key, "no robot", found=owner, available=[robot]))
        elif field in ("model", "name"):
            wrong.append(Problem(key, "cannot be overridden"))
        else:
            fields[field] = value
    try:
        found = SerialRobot.from_model(name, **fields)
    except NoJoints:
        raise
    except DeclarationError as error:
        raise DeclarationError([*wrong, *error.problems]) from None
    raise_any(wrong)
    return found


def _refuse_group(name: str) -> None:
    try:
        path = paths.find_group_model(name)
    except UnknownName:
        return
    robots = load_scene(path).robots.values()
    names = ", ".join(
        robot.name if robot._model is None else f"{robot.name} ({paths.model_name(robot._model)})"
        for robot in robots
    )
    raise UsageError(f"{name} is a group of robots; expected one robot. Its robots are {names}.")


def _load_scenario(
    name: str, overrides: Mapping[str, Any], *, by_hand: bool, trusted: bool, replay: Path | None
) -> Scene:
    # Imported late, because most scenes are not simulated.
    from .simulate.scenario_file import read_scenario
    from .simulate.simulated_scene import replayed_scene, simulated_scene
    from .simulate.simulation import Simulation

    scenario = read_scenario(name, overrides, trusted=trusted)
    if replay is not None:
        return replayed_scene(scenario, replay)
    withheld = scenario.withheld
    if withheld is None:
        return simulated_scene(Simulation(scenario, by_hand=by_hand))
    _check(scenario)
    scene = scenario.scene
    scene.withheld = withheld
    trust.log.warning(
        "%s: shown without simulation, because it asks to %s. `sero-mj simulate %s` allows this.",
        paths.without_temporary(str(withheld.file)),
        " and to ".join(map(str, withheld.actions)),
        withheld.file.name,
    )
    return scene


def _check(scenario: Scenario) -> None:
    from .simulate.control.controller import ControllerDeclaration
    from .simulate.simulation import Simulation

    problems: list[Problem] = []
    for name, declared in scenario.controllers.items():
        if isinstance(declared, ControllerDeclaration):
            with collect(problems, f"controllers.{name}"):
                declared.check_files()
    with collect(problems, ""):
        Simulation(scenario.without_programs())
    if problems:
        raise DeclarationError(scenario.scene.located(problems))
