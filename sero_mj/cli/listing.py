"""`sero-mj list`: lists included robots and scenes, installed plug-ins, and file keys."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from ..base import paths
from ..base.declaration import Declaration, field_descriptions
from ..base.options import Option, Options
from ..base.plugins import (
    COMMANDS,
    CONTROLLERS,
    DECOR,
    ENGINES,
    IMPORTERS,
    LISTED,
    RENDERERS,
    ROBOTS,
    SNIPPETS,
    SOURCES,
    TARGET_MOTIONS,
    TOOLS,
    is_own,
    load_all,
    load_plugin,
    plugins,
)
from .arguments import command
from .terminal import make_console

_HELP = """\
examples:
  sero-mj list                              robots, scenes, scenarios and plug-ins
  sero-mj list --known                      third-party robots
  sero-mj list --fields scenarios           all keys of scenario files

`sero-mj check SCENE` prints the contents of one scene.
"""
GROUP, ORDER = "files", 56


class ListOptions(Options):
    """List the included robots, scenes, scenarios and environments.

    Attributes:
        known: list third-party robots that can be used by name; see docs/robot_files.md.
        fields: list keys and default values of robot files or scenario files (default: robots).
    """

    known: bool = False
    fields: Annotated[Literal["robots", "scenarios"] | None, Option(bare="robots")] = None


def run(options: ListOptions) -> int:
    """Prints the requested list; returns 0."""
    if options.fields == "robots":
        from ..robots.declared.robot import SerialRobot

        _print_declaration(SerialRobot)
        return 0
    if options.fields:
        _print_scenario_fields()
        return 0
    if options.known:
        _print_known()
        return 0
    shipped = {
        "robots (models/)": (paths.list_models, paths.find_model),
        "groups of robots (models/)": (paths.list_group_models, paths.find_group_model),
        "scenes (scenes/)": (paths.list_scenes, paths.find_scene),
        "scenarios (scenes/scenarios/), for sero-mj simulate": (
            paths.list_scenarios, paths.find_scenario
        ),
    }  # fmt: skip
    for title, (names, find) in shipped.items():
        print(title)
        for name in names():
            print(f"  {name:18} {_about(find(name))}")
    for describe in load_all(LISTED).values():
        title, lines = describe()
        print("\n  ".join([title, *lines]))
    for group, about in _KINDS.items():
        print(f"{about} (entry points {group})")
        for name, point in plugins(group).items():
            package = "" if is_own(point) or not point.dist else f" from {point.dist.name}"
            print(f"  {name:18} {point.value}{package}")
    return 0


add_to = command("list", run, ListOptions, _HELP)


def _print_known() -> None:
    from rich.columns import Columns
    from rich.padding import Padding

    console = make_console()
    for place in paths.robot_places():
        names = sorted(place.names())
        print(place.title if names else f"{place.title}: {place.none}", flush=True)
        if console.is_terminal:
            columns = Columns(names, padding=(0, 2), column_first=True)
            console.print(Padding(columns, (0, 0, 0, 2)))
        else:
            for name in names:
                print(f"  {name}")


_KINDS = {
    IMPORTERS: "importers of robot and scene files",
    ROBOTS: "collections of robots",
    SOURCES: "kinds of sources",
    CONTROLLERS: "kinds of controllers",
    TARGET_MOTIONS: "kinds of target motions",
    DECOR: "visual features",
    TOOLS: "tools of windows and pages",
    RENDERERS: "additional renderers",
    ENGINES: "additional engines for parallel tasks",
    COMMANDS: "commands",
    SNIPPETS: "example code from extensions",
}


def _about(file: Path) -> str:
    text = file.read_text(encoding="utf-8")
    described = tomllib.loads(text).get("description")
    if described is not None:
        return str(described)
    first, *_ = [*text.splitlines(), ""]
    return first.lstrip("# ") if first.startswith("#") else ""


def _print_scenario_fields() -> None:
    from ..simulate.runs.measures import MEASURES
    from ..simulate.runs.monitor import KINDS

    for k, (title, declaration) in enumerate(scenario_tables().items()):
        print(f"{chr(10) if k else ''}{title}")
        _print_declaration(declaration)
    print("\nmeasures: " + ", ".join(f"{name} ({unit})" for name, (unit, _) in MEASURES.items()))
    print("kinds of detected faults: " + ", ".join(KINDS))


def scene_tables() -> dict[str, type[Declaration]]:
    """Returns a mapping from the table headers of robot and scene files to declarations."""
    from ..robots.declared.cartesian import ReceivedFrame, SmartArrow
    from ..robots.declared.couplings import Coupling
    from ..robots.declared.double import Double
    from ..robots.declared.dynamics import Dynamics, TorqueControl
    from ..robots.declared.groups import Group
    from ..robots.declared.robot import SerialRobot
    from ..robots.declared.scene import SceneToggles
    from ..robots.declared.surroundings import Camera, Light, Object, View

    kinds = plugins(SOURCES)
    return {
        "robot.toml, or [robots.NAME]": SerialRobot,
        "[dynamics] of a robot": Dynamics,
        "[torque_control] of a robot": TorqueControl,
        "couplings of a robot, JOINT = { ... }": Coupling,
        "[groups.NAME]": Group,
        "[doubles.NAME]": Double,
        "[arrows.NAME]": SmartArrow,
        "[frames.NAME]": ReceivedFrame,
        "[objects.NAME]": Object,
        "[cameras.NAME]": Camera,
        "[lights.NAME]": Light,
        "[view]": View,
        "[toggles]": SceneToggles,
        **{f'[sources.NAME] kind = "{kind}"': load_plugin(SOURCES, kind) for kind in kinds},
    }


def scenario_tables() -> dict[str, type[Declaration]]:
    """Returns a mapping from the additional table headers of scenario files to declarations."""
    from ..simulate.control.make_controller import controller_kinds
    from ..simulate.control.plan import target_motion_kinds
    from ..simulate.disturbances import DISTURBANCES, FAULTS
    from ..simulate.expect import Expect
    from ..simulate.runs.monitor import Monitor
    from ..simulate.scenario import Run
    from ..simulate.sensors import SIGNALS, SensorErrors

    kinds: dict[str, Mapping[str, type[Declaration]]] = {
        "controllers.ROBOT": controller_kinds(),
        "targets.ROBOT": target_motion_kinds(),
        "disturbances.NAME": DISTURBANCES,
        "faults.NAME": FAULTS,
    }
    tables: dict[str, type[Declaration]] = {"[run]": Run}
    for section, found in kinds.items():
        tables |= {f'[{section}] kind = "{kind}"': each for kind, each in found.items()}
    signals = ", ".join(f"{signal} = {{ ... }}" for signal in SIGNALS)
    tables[f"[sensors.ROBOT] {signals}"] = SensorErrors
    return {**tables, "[monitor]": Monitor, "[expect.NAME]": Expect}


def _print_declaration(declaration: type[Declaration]) -> None:
    for name, default, about in field_rows(declaration):
        print(f"{name} = {default or 'required'}")
        print(f"    {about}")


def field_rows(declaration: type[Declaration]) -> list[tuple[str, str, str]]:
    """Returns the name, default and description of each field of a declaration except `kind`.

    The default of a required field is an empty string.
    """
    about = field_descriptions(declaration)
    rows = []
    for name, field in declaration.model_fields.items():
        if name != "kind":
            default = ""
            if not field.is_required():
                found = field.get_default(call_default_factory=True)
                default = " ".join(str(found).split()) or '""'
            rows.append((name, default, about.get(name, "")))
    return rows
