"""What every command that shows a scene takes: camera, look, settings."""

from __future__ import annotations

import argparse

from ..assemble.scene import Scene
from .arguments import read_scene_or_model

LOOKS = ("light", "dark")


def add_scene_options(parser: argparse.ArgumentParser) -> None:
    """Adds `--camera`, `--look` and `--set`."""
    parser.add_argument(
        "--camera",
        metavar="CAM",
        help="name of a camera, or azimuth,elevation,distance in degrees and m",
    )
    parser.add_argument("--look", choices=LOOKS, help="over the scene's; default light")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="settings",
        metavar="ROBOT.FIELD=VALUE",
        help="set a field over the scene's; may be repeated",
    )


def read_scene(options: argparse.Namespace) -> Scene:
    """The scene that a command line names, with what it sets.

    Raises:
        SeroError: see `read_scene_or_model`.
    """
    scene = read_scene_or_model(options.scene, options.settings)
    if options.look is not None:
        scene.view.look = options.look
    return scene
