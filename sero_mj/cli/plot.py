"""`sero-mj plot`: draws the torques of recordings as figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ..base.declaration import expecting
from ..base.errors import UsageError
from ..base.options import Option, positional
from .arguments import command
from .shared_options import Figure, PartOptions

_HELP = """\
examples:
  sero-mj plot run.mcap -o run.pdf
  sero-mj plot run.mcap -o elbow.png --joints A3,A4 --from 2 --to 5
  sero-mj plot monday.mcap tuesday.mcap -o week.pdf     one page per recording

Each joint has one row: commanded and measured torque with the limit on the left, and the error
(commanded minus measured) on the right. Time starts at the beginning of a simulation, or at the
first packet of a robot. `sero-mj compare` draws two recordings in one figure.
"""
GROUP, ORDER = "analyze", 42


def _parts(text: Any) -> Any:
    return [name.strip() for name in text.split(",")] if isinstance(text, str) else text


Names = Annotated[
    tuple[Annotated[str, Field(min_length=1)], ...],
    BeforeValidator(_parts),
    expecting("names separated by commas"),
]


class PlotOptions(PartOptions):
    """Plot the torques of a recording, joint by joint.

    Attributes:
        recordings: recordings or tables (.csv).
        output: figure file (.pdf, .png, .svg); several recordings become pages of a .pdf file.
        robot: robots to plot (default: all robots).
        joints: joints to plot, for example A2,A4 (default: all joints).
        quiet: print nothing.
    """

    recordings: Annotated[list[Path], positional("RUN.mcap")]
    output: Annotated[Figure, Option("OUT", ("-o", "--output"))]
    robot: Annotated[Names | None, Option("NAME,...")] = None
    joints: Annotated[Names | None, Option("NAME,...")] = None
    quiet: bool = False


def run(options: PlotOptions) -> int:
    """Draws the torques of the recordings; returns 0."""
    output = options.output
    if len(options.recordings) > 1 and output.suffix.lower() != ".pdf":
        raise UsageError(
            f"-o {output}: expected a name that ends in .pdf, because a figure of "
            f"{len(options.recordings)} recordings has several pages"
        )
    logs = [options.read_part(path) for path in options.recordings]
    from ..study.plot import plot_run
    from ..viewer.image.image_files import check_writable

    check_writable(output)
    plot_run(logs, output, robots=options.robot, joints=options.joints)
    if not options.quiet:
        print(output)
    return 0


add_to = command("plot", run, PlotOptions, _HELP)
