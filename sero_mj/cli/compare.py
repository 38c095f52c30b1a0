"""`sero-mj compare`: how much two recordings of a robot differ."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ..errors import UsageError
from ._arguments import (
    Commands,
    add_command,
    add_picture_options,
    check_ending,
    not_negative,
    print_table,
    read_recorded_run,
    read_scene,
)

if TYPE_CHECKING:
    from ..runs.run_log import RunLog
    from ..study.align import Pair

_EPILOG = """\
examples:
  sero-mj compare simulated.mcap real.mcap
  sero-mj compare simulated.mcap real.mcap --offset auto --plot difference.pdf
  sero-mj compare a.mcap b.mcap --render difference.mp4     arrows on the difference
  sero-mj compare a.mcap b.mcap --tolerance-torque 2 --tolerance-angle 0.5 && echo the same

Recordings of simulations and of robots alike; differences are A less B. Time counts from the start
of a simulation, or from the first packet of a robot. The exit status is 1 when a tolerance is
exceeded, 2 when they cannot be compared.
"""


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "compare", run, "compare two recordings of a robot, joint by joint", _EPILOG
    )
    parser.add_argument("a", type=Path, metavar="A.mcap", help="a recording")
    parser.add_argument("b", type=Path, metavar="B.mcap", help="another one")
    parser.add_argument(
        "--robot", metavar="NAME", help="which robot; NAME,NAME where it has two names"
    )
    parser.add_argument(
        "--scene",
        metavar="SCENE",
        help="robots and routes, where a recording has no scene (default: what is in it)",
    )
    parser.add_argument(
        "--source", metavar="NAME", help="which source; NAME,NAME for A and B (default: all)"
    )
    parser.add_argument(
        "--offset", type=_offset, default=0.0, metavar="S|auto",
        help="added to the times of B; auto finds it by the motion (default 0)",
    )  # fmt: skip
    parser.add_argument("--plot", type=Path, metavar="OUT", help="a figure: .png, .pdf or .svg")
    parser.add_argument("--csv", type=Path, metavar="OUT.csv", help="both and their difference")
    parser.add_argument("--json", action="store_true", help="print the table as JSON")
    parser.add_argument(
        "--render", type=Path, metavar="OUT.mp4",
        help="a film of A with arrows on the difference, and a transparent double for B",
    )  # fmt: skip
    add_picture_options(parser)
    parser.add_argument(
        "--tolerance-torque", type=not_negative, metavar="NM",
        help="exit with 1 where measured torques differ by more, Nm (N)",
    )  # fmt: skip
    parser.add_argument(
        "--tolerance-angle", type=not_negative, metavar="DEG",
        help="likewise for angles, degrees; of sliding joints mm",
    )  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="no table, no progress bar")


def _offset(text: str) -> float | Literal["auto"]:
    if text == "auto":
        return "auto"
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"found '{text}'; expected a number of seconds, or auto")
    return value


def run(options: argparse.Namespace) -> int:
    """Compares; returns 0, or 1 when a tolerance is exceeded."""
    _check_names(options)
    from ..study.align import align
    from ..study.compare import as_json, as_table, compare, exceeded, write_csv

    a, b = _read(options)
    pair = align(a, b, options.robot, options.offset)
    if not pair.signals:
        raise UsageError(f"{a.name} and {b.name} have no signal in common")
    differences = compare(pair)
    over = exceeded(differences, torque=options.tolerance_torque, angle=_angle(options))
    if options.tolerance_torque is not None and "torques" not in pair.signals:
        raise UsageError("--tolerance-torque: there are no torques in both recordings")
    if options.json:
        found = {**as_json(pair, differences), "exceeded": [str(each) for each in over]}
        print(json.dumps(found, indent=2))
    elif not options.quiet:
        print_table(as_table(pair, differences))
        if pair.correlation is not None:
            print(f"offset {pair.offset:+.4f} s, correlation of the motions {pair.correlation:.3f}")
    if options.csv is not None:
        write_csv(pair, options.csv)
    if options.plot is not None:
        from ..study.plot import plot_pair

        plot_pair(pair, options.plot)
    if options.render is not None:
        _film(pair, a, options)
    for each in over:
        print(f"sero-mj: {each}", file=sys.stderr)
    return 1 if over else 0


def _check_names(options: argparse.Namespace) -> None:
    """Refuses unsuitable file names before anything is computed."""
    from ..study.figure import SUFFIXES

    if options.plot is not None:
        check_ending(f"--plot {options.plot}", options.plot, SUFFIXES, ", ")
    if options.render is not None:
        from ..show.headless.film import FILMS

        check_ending(f"--render {options.render}", options.render, FILMS, ", ")


def _angle(options: argparse.Namespace) -> float | None:
    degrees = options.tolerance_angle
    return None if degrees is None else math.radians(degrees)


def _read(options: argparse.Namespace) -> list[RunLog]:
    scene = None if options.scene is None else read_scene(options.scene)
    of_a, _, of_b = (options.source or "").partition(",")
    runs = []
    for path, source in ((options.a, of_a), (options.b, of_b or of_a)):
        runs.append(read_recorded_run(path, source or None, scene))
    return runs


def _film(pair: Pair, a: RunLog, options: argparse.Namespace) -> None:
    from ..study.compare import compare_scene
    from .render import film_with_progress

    film_with_progress(
        compare_scene(pair),
        options.render,
        quiet=options.quiet,
        duration=float(pair.times[-1] - pair.times[0]),
        size=options.size,
        quality=options.quality,
        camera=None,
        wait=0.0,
        clicks=[],
    )
