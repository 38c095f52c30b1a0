"""`sero-mj list`: what is there to use."""

from __future__ import annotations

import argparse
import tomllib

from .. import paths
from .arguments import Commands, add_command


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "list", run, "list the shipped robots and scenes", "See also: sero-mj check SCENE"
    )
    parser.add_argument(
        "--fields", action="store_true", help="list the fields of a robot and their defaults"
    )


def run(options: argparse.Namespace) -> int:
    """Prints; returns 0."""
    if options.fields:
        _print_fields()
        return 0
    print("robots (models/)")
    for name in paths.list_models():
        about = tomllib.loads(paths.find_model(name).read_text(encoding="utf-8"))
        print(f"  {name:14} {about.get('description', '')}")
    print("scenes (scenes/)")
    for name in paths.list_scenes():
        print(f"  {name:14} {_first_comment(name)}")
    print("scenarios (scenes/scenarios/), for sero-mj simulate")
    for name in paths.list_scenarios():
        about = tomllib.loads(paths.find_scenario(name).read_text(encoding="utf-8"))
        print(f"  {name:18} {about.get('description', '')}")
    return 0


def _first_comment(scene: str) -> str:
    first, *_ = [*paths.find_scene(scene).read_text(encoding="utf-8").splitlines(), ""]
    return first.lstrip("# ") if first.startswith("#") else ""


def _print_fields() -> None:
    import inspect
    import re

    from ..assemble.robot import SerialRobot

    text = inspect.cleandoc(SerialRobot.__doc__ or "").partition("Attributes:\n")[2]
    about = dict(re.findall(r"^    (\w+): ((?:.|\n {8})*)", text, re.MULTILINE))
    for name, field in SerialRobot.model_fields.items():
        default = (
            "required" if field.is_required() else field.get_default(call_default_factory=True)
        )
        shown = " ".join(str(default).split())
        print(f"{name} = {shown}")
        print("    " + re.sub(r"\s+", " ", about.get(name, "")))
