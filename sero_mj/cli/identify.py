"""`sero-mj identify`: a robot's friction, payload and torque offsets, from a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from ..base.options import Option, ending, positional
from ._arguments import command, print_json, print_table, writing
from .shared_options import Figure, Flag, JsonOptions, PartOptions

_EPILOG = """\
examples:
  sero-mj identify run.mcap --robot lwr
  sero-mj identify run.mcap --plot fit.pdf -o found.toml   the fit, and lines of a robot's file
  sero-mj identify run.mcap --from 2 --to 12 --json
  sero-mj identify run.csv --scene lwr                     of simulate --csv, or export-csv

Linear regression on both sides of the torque sensors: friction and motor inertia by commanded less
measured torque, payload and offsets by measured torque less that of the robot's model, each with
its standard error. What the motion does not tell is said, and not guessed: all joints should move,
to and fro, slowly and faster, and the wrist far enough that gravity changes.
"""
ORDER = 46  # in the help of `sero-mj`


class IdentifyOptions(PartOptions, JsonOptions):
    """Estimate friction, payload and torque offsets.

    Attributes:
        recording: a recording, or a table (.csv).
        robot: which robot (default: the only one).
        output: lines of a robot's file.
        plot: the fit: .png, .pdf or .svg.
        as_json: print what is found as JSON.
        quiet: no table.
    """

    recording: Annotated[Path, positional("RUN.mcap")]
    robot: Flag = None
    output: Annotated[Path | None, ending(".toml"), Option("OUT.toml", ("-o", "--output"))] = None
    plot: Figure | None = None
    quiet: bool = False


def run(options: IdentifyOptions) -> int:
    """Identifies; returns 0."""
    from ..study.align import choose_robot
    from ..study.identify import as_json, as_table, as_toml, identify, plot_identified, remarks

    log = options.read_part(options.recording)
    found = identify(log, choose_robot(log, options.robot))
    if options.as_json:
        print_json(as_json(found))
    elif not options.quiet:
        print_table(as_table(found))
        for line in remarks(found):
            print(line)
        if options.output is None:
            print()
            print(as_toml(found), end="")
    if options.output is not None:
        with writing():
            options.output.write_text(as_toml(found), encoding="utf-8")
    if options.plot is not None:
        plot_identified(found, options.plot)
    return 0


add_to = command("identify", run, IdentifyOptions, _EPILOG)
