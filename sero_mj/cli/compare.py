"""`sero-mj compare`: how much recordings of a robot differ, and what explains it."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ..base.errors import UsageError
from ._arguments import (
    Commands,
    add_command,
    add_picture_options,
    check_ending,
    not_negative,
    print_json,
    print_table,
    read_recorded_run,
    read_scene,
)

if TYPE_CHECKING:
    from ..simulate.runs.run_log import RunLog
    from ..study.align import Pair
    from ..study.explanation import Explanation
    from ..study.torque_residuals import TorqueResiduals

_EPILOG = """\
examples:
  sero-mj compare simulated.mcap real.mcap
  sero-mj compare simulated.mcap real.mcap --offset auto --plot difference.pdf
  sero-mj compare a.mcap b.mcap --render difference.mp4     arrows on the difference
  sero-mj compare a.mcap b.mcap --tolerance-torque 2 --tolerance-angle 0.5 && echo the same
  sero-mj compare run.mcap                                  commanded with measured torque
  sero-mj compare run.mcap --against-model --plot run.pdf   the robot with its own model
  sero-mj compare a.csv b.mcap --scene lwr_udp              a table of export-csv, simulate --csv

Recordings of simulations and of robots alike; differences are A less B. Time counts from the start
of a simulation, or from the first packet of a robot. Beneath stands for every joint what explains
the difference: sign, gain, bias, delay or noise of a torque sensor or a drive, friction, a payload,
a joint that is stuck. The exit status is 1 when a tolerance is exceeded, 2 when they cannot be
compared.
"""
ORDER = 43  # in the help of `sero-mj`


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "compare", run, "compare recordings of a robot, joint by joint", _EPILOG
    )
    parser.add_argument("a", type=Path, metavar="A.mcap", help="a recording, or a table (.csv)")
    parser.add_argument(
        "b", type=Path, nargs="?", metavar="B.mcap",
        help="another one (default: commanded with measured torques of A)",
    )  # fmt: skip
    parser.add_argument(
        "--against-model", action="store_true",
        help="with the robot's own model, in the same motion, instead of another recording",
    )  # fmt: skip
    parser.add_argument(
        "--robot", metavar="NAME", help="which robot; NAME,NAME where it has two names"
    )
    parser.add_argument(
        "--scene",
        metavar="SCENE",
        help="robots and routes, where a recording has none, or of tables (default: what is in it)",
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
    _check_options(options)
    from ..study.compare import as_json, as_table, compare, exceeded, explanations_table, write_csv

    a, pair, explanations, about = _compared(options)
    if not pair.signals:
        raise UsageError(f"{pair.names[0]} and {pair.names[1]} have no signal in common")
    differences = compare(pair)
    over = exceeded(differences, torque=options.tolerance_torque, angle=_angle(options))
    if options.tolerance_torque is not None and "torques" not in pair.signals:
        raise UsageError("--tolerance-torque: there are no torques in both recordings")
    if options.json:
        found = as_json(pair, differences, explanations)
        print_json({**found, "about": about, "exceeded": list(map(str, over))})
    elif not options.quiet:
        print_table(as_table(pair, differences))
        if pair.correlation is not None:
            print(f"offset {pair.offset:+.4f} s, correlation of the motions {pair.correlation:.3f}")
        if explanations is not None:
            print_table(explanations_table(pair, explanations))
        for line in about:
            print(line)
    if options.csv is not None:
        write_csv(pair, options.csv)
    if options.plot is not None:
        from ..study.plot import plot_pair

        plot_pair(pair, options.plot, explanations=explanations or ())
    if options.render is not None:
        _film(pair, a, options)
    for each in over:
        print(f"sero-mj: {each}", file=sys.stderr)
    return 1 if over else 0


def _compared(
    options: argparse.Namespace,
) -> tuple[RunLog, Pair, list[Explanation] | None, list[str]]:
    """The first run, what is compared, what explains it, and lines about that."""
    from ..study.align import align, choose_robot, choose_robots, pair_with_commands
    from ..study.explain import explain_run, explain_runs
    from ..study.torque_residuals import pair_with_model, torque_residuals

    a, *others = _read(options)
    if others:
        pair = align(a, others[0], options.robot, options.offset)
        robots = choose_robots(a, others[0], options.robot)
        if "torques" not in pair.signals:
            return a, pair, None, ["nothing explains angles alone: torques are not in both"]
        try:
            return a, pair, explain_runs(a, others[0], robots, pair.offset), []
        except UsageError as error:
            return a, pair, None, [f"no explanation: {error}"]
    name = choose_robot(a, options.robot)
    if options.against_model:
        found = torque_residuals(a, name)
        explanations = explain_run(a, name, replace(found, has_model=True))
        pair = pair_with_model(a, found)
        return a, pair, explanations, [*_parted(pair, explanations), *_about_model(found)]
    pair = pair_with_commands(a, name)
    found = torque_residuals(a, name)
    return a, pair, explain_run(a, name, found), _about_model(found)


def _about_model(found: TorqueResiduals) -> list[str]:
    """What the explanation went by."""
    lines = ["model: inverse dynamics on the measured motion, both through a low pass of "
             f"{0.16 / found.width:.0f} Hz"]  # fmt: skip
    if found.torque_control:
        lines.append("commands are those of joint torque control: friction is made up for")
    if not found.has_model:
        lines.append("the links' masses are estimated, or something carries the robot")
    return lines


def _parted(pair: Pair, explanations: Sequence[Explanation]) -> list[str]:
    """Where robot and model part first."""
    if not explanations:
        return [f"{pair.robot.name} and its model agree"]
    first = min(explanations, key=lambda each: (not each.from_start, each.begin))
    return [f"{pair.robot.name} and its model part at {first.joint}, {first.when}: {first.kind}"]


def _check_options(options: argparse.Namespace) -> None:
    """Refuses what does not go together, and unsuitable file names, before anything is computed."""
    from ..study.figure import SUFFIXES

    if options.b is not None and options.against_model:
        raise UsageError(f"--against-model: found {options.b} as well; expected one recording")
    if options.b is None and options.offset != 0.0:
        raise UsageError("--offset is for two recordings; found one")
    if options.plot is not None:
        check_ending(f"--plot {options.plot}", options.plot, SUFFIXES, ", ")
    if options.render is not None:
        from ..viewer.headless.film import FILMS

        check_ending(f"--render {options.render}", options.render, FILMS, ", ")


def _angle(options: argparse.Namespace) -> float | None:
    degrees = options.tolerance_angle
    return None if degrees is None else math.radians(degrees)


def _read(options: argparse.Namespace) -> list[RunLog]:
    scene = None if options.scene is None else read_scene(options.scene)
    of_a, _, of_b = (options.source or "").partition(",")
    runs = []
    wanted = [(options.a, of_a), (options.b, of_b or of_a)]
    for path, source in wanted[: 1 if options.b is None else 2]:
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
