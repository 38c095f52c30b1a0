"""`sero-mj export`: a scene as MJCF that plain MuJoCo loads."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..base.errors import UsageError
from ._arguments import Commands, add_command, add_package_option, check_ending, read_scene

_EPILOG = """\
example:
  sero-mj export lwr_udp out/lwr.xml && python -m mujoco.viewer --mjcf=out/lwr.xml

Mesh files are written to a folder beside the XML. Bodies are named robot/link1 and so on; the key
frame "home" has the joint angles that the scene declares. It is what is viewed, without drives,
motor inertia and friction, which are what `simulate` adds, but with the masses of simulation. A
comment in the file says which of these are estimated.
"""
ORDER = 55  # in the help of `sero-mj`


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(commands, "export", run, "write a scene as MJCF with its meshes", _EPILOG)
    parser.add_argument("scene", metavar="SCENE", help="scene or robot: a file, or a shipped name")
    add_package_option(parser)
    parser.add_argument("output", metavar="OUT.xml", type=Path)


def run(options: argparse.Namespace) -> int:
    """Writes; returns 0."""
    from ..robots.assemble.world import World

    check_ending(str(options.output), options.output, (".xml",))
    world = World(read_scene(options.scene))
    try:
        written = world.export(options.output)
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error
    print(f"{written[0]} and {len(written) - 1} mesh files")
    return 0
