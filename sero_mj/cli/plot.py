"""`sero-mj plot`: the torques of a recording as a figure."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..base.errors import UsageError
from ._arguments import (
    Commands,
    add_command,
    add_part_options,
    check_part,
    read_recorded_run,
    read_scene,
)

if TYPE_CHECKING:
    from ..robots.assemble.scene import Scene
    from ..simulate.runs.run_log import RunLog

_EPILOG = """\
examples:
  sero-mj plot run.mcap -o run.pdf
  sero-mj plot run.mcap -o elbow.png --joints A3,A4 --from 2 --to 5
  sero-mj plot monday.mcap tuesday.mcap -o week.pdf       a page for each recording
  sero-mj plot run.csv --scene lwr -o run.svg             of simulate --csv, or export-csv

A row for each joint: commanded and measured torque with the limit, and beside them the error,
commanded less measured. Recordings of simulations and of robots alike; time counts from the start
of a simulation, or from the first packet of a robot. `sero-mj compare` shows two in one figure.
"""
ORDER = 40  # in the help of `sero-mj`


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "plot", run, "plot the torques of a recording, joint by joint", _EPILOG
    )
    parser.add_argument(
        "recordings", nargs="+", type=Path, metavar="RUN.mcap", help="recordings, or tables (.csv)"
    )
    parser.add_argument(
        "-o", "--output", required=True, type=Path, metavar="OUT",
        help="the figure: .pdf, .png or .svg; several recordings are pages of a .pdf",
    )  # fmt: skip
    parser.add_argument("--robot", type=_names, metavar="NAME,...", help="which robots")
    parser.add_argument("--joints", type=_names, metavar="NAME,...", help="which joints: A2,A4")
    add_part_options(parser)
    parser.add_argument("--quiet", action="store_true", help="no closing line")


def _names(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise argparse.ArgumentTypeError(f"found '{text}'; expected names with commas between them")
    return names


def run(options: argparse.Namespace) -> int:
    """Plots; returns 0."""
    from ..study.figure import check_suffix

    output = check_suffix(options.output)
    several = len(options.recordings) > 1
    if several and output.suffix.lower() != ".pdf":
        raise UsageError(
            f"-o {output}: {len(options.recordings)} recordings are pages; expected a name that "
            "ends in .pdf"
        )
    check_part(options)
    scene = None if options.scene is None else read_scene(options.scene)
    logs = [_read(path, scene, options) for path in options.recordings]
    from ..study.plot import plot_run
    from ..viewer.headless.film import check_writable

    check_writable(output)
    plot_run(logs, output, robots=options.robot, joints=options.joints)
    if not options.quiet:
        print(output)
    return 0


def _read(path: Path, scene: Scene | None, options: argparse.Namespace) -> RunLog:
    """A recording or a table, and of it the time that was asked for."""
    log = read_recorded_run(path, options.source, scene)
    if options.begin is None and options.end is None:
        return log
    return log.between(options.begin, options.end)
