"""`sero-mj plot`: the torques of a recording as a figure."""

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
  sero-mj plot monday.mcap tuesday.mcap -o week.pdf     a page for each recording

A row for each joint: commanded and measured torque with the limit, and beside them the error,
commanded less measured. Recordings of simulations and of robots alike; time counts from the start
of a simulation, or from the first packet of a robot. `sero-mj compare` shows two in one figure.
"""
GROUP, ORDER = "analyse", 42


def _parts(text: Any) -> Any:
    return [name.strip() for name in text.split(",")] if isinstance(text, str) else text


Names = Annotated[
    tuple[Annotated[str, Field(min_length=1)], ...],
    BeforeValidator(_parts),
    expecting("names with commas between them"),
]


class PlotOptions(PartOptions):
    """Plot the torques of a recording, joint by joint.

    Attributes:
        recordings: recordings, or tables (.csv).
        output: the figure: .pdf, .png or .svg; several recordings are pages of a .pdf.
        robot: which robots.
        joints: which joints: A2,A4.
        quiet: no closing line.
    """

    recordings: Annotated[list[Path], positional("RUN.mcap")]
    output: Annotated[Figure, Option("OUT", ("-o", "--output"))]
    robot: Annotated[Names | None, Option("NAME,...")] = None
    joints: Annotated[Names | None, Option("NAME,...")] = None
    quiet: bool = False


def run(options: PlotOptions) -> int:
    """Plots; returns 0."""
    output = options.output
    if len(options.recordings) > 1 and output.suffix.lower() != ".pdf":
        raise UsageError(
            f"-o {output}: {len(options.recordings)} recordings are pages; expected a name that "
            "ends in .pdf"
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
