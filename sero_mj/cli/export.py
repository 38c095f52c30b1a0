"""`sero-mj export`: a scene as MJCF that plain MuJoCo loads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from ..base.options import ending, positional
from ._arguments import command, read_scene, writing
from .shared_options import PackageOptions, SceneArgument

_EPILOG = """\
example:
  sero-mj export lwr_udp out/lwr.xml && python -m mujoco.viewer --mjcf=out/lwr.xml

Mesh files are written to a folder beside the XML. Bodies are named robot/link1 and so on; the key
frame "home" has the joint angles that the scene declares. It is what is viewed, without drives,
motor inertia and friction, which are what `simulate` adds, but with the masses of simulation. A
comment in the file says which of these are estimated.
"""
ORDER = 55  # in the help of `sero-mj`


class ExportOptions(SceneArgument, PackageOptions):
    """Write a scene as MJCF with its meshes.

    Attributes:
        output: the file to write.
    """

    output: Annotated[Path, ending(".xml"), positional("OUT.xml")]


def run(options: ExportOptions) -> int:
    """Writes; returns 0."""
    from ..robots.assemble.world import World

    world = World(read_scene(options.scene))
    with writing():
        written = world.export(options.output)
    print(f"{written[0]} and {len(written) - 1} mesh files")
    return 0


add_to = command("export", run, ExportOptions, _EPILOG)
