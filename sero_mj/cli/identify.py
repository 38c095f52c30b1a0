"""`sero-mj identify`: a robot's friction, payload and torque offsets, from a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..base.errors import RenderError
from ._arguments import (
    Commands,
    add_command,
    add_part_options,
    check_ending,
    check_part,
    print_json,
    print_table,
    read_recorded_run,
    read_scene,
)

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


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "identify", run, "estimate friction, payload and torque offsets", _EPILOG
    )
    parser.add_argument(
        "recording", type=Path, metavar="RUN.mcap", help="a recording, or a table (.csv)"
    )
    parser.add_argument("--robot", metavar="NAME", help="which robot (default: the only one)")
    add_part_options(parser)
    parser.add_argument(
        "-o", "--output", type=Path, metavar="OUT.toml", help="lines of a robot's file"
    )
    parser.add_argument("--plot", type=Path, metavar="OUT", help="the fit: .png, .pdf or .svg")
    parser.add_argument("--json", action="store_true", help="print what is found as JSON")
    parser.add_argument("--quiet", action="store_true", help="no table")


def run(options: argparse.Namespace) -> int:
    """Identifies; returns 0."""
    from ..study.figure import SUFFIXES

    if options.plot is not None:
        check_ending(f"--plot {options.plot}", options.plot, SUFFIXES, ", ")
    if options.output is not None:
        check_ending(f"-o {options.output}", options.output, (".toml",))
    check_part(options)
    from ..study.align import choose_robot
    from ..study.identify import as_json, as_table, as_toml, identify, plot_identified, remarks

    scene = None if options.scene is None else read_scene(options.scene)
    log = read_recorded_run(options.recording, options.source, scene)
    if options.begin is not None or options.end is not None:
        log = log.between(options.begin, options.end)
    found = identify(log, choose_robot(log, options.robot))
    if options.json:
        print_json(as_json(found))
    elif not options.quiet:
        print_table(as_table(found))
        for line in remarks(found):
            print(line)
        if options.output is None:
            print()
            print(as_toml(found), end="")
    if options.output is not None:
        try:
            options.output.write_text(as_toml(found), encoding="utf-8")
        except OSError as error:
            raise RenderError(f"{options.output}: cannot be written: {error.strerror}") from error
    if options.plot is not None:
        plot_identified(found, options.plot)
    return 0
