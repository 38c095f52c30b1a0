"""`sero-mj simulate`: runs a scenario, keeps what happened, and says whether it was right."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.errors import SimulationError, UsageError
from ._arguments import (
    Commands,
    add_command,
    add_picture_options,
    add_set_option,
    check_ending,
    named_settings,
    not_negative,
    overrides,
    positive,
    print_json,
    print_table,
    seed,
)
from ._sending import Sender, add_sink_options, in_real_time
from .render import check_picture_or_film, film_with_progress

if TYPE_CHECKING:
    from ..simulate.simulation import Simulation

_EPILOG = """\
examples:
  sero-mj simulate impedance_push                      runs it, says what held and what was found
  sero-mj simulate impedance_push --render out.mp4     and films it
  sero-mj simulate my.toml --record run.mcap --plot torques.png --csv run.csv
  sero-mj simulate impedance_push --set controllers.lwr.stiffness=200
  sero-mj simulate impedance_push --send lwr_udp       as a robot would, in real time, for a mirror

A scenario is a scene with [controllers], [targets], [disturbances], [faults], [expect]. Exits with
1 when something that was expected did not hold, or the simulation could not go on, and with 130
when Ctrl+C ended it; what was recorded until then is kept. The same seed gives the same run, bit
for bit.
"""
ORDER = 22  # in the help of `sero-mj`


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "simulate", run, "run a scenario faster than real time, and judge it", _EPILOG
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="a file, or a shipped scenario's name")
    parser.add_argument("--record", type=Path, metavar="OUT.mcap", help="keep every step")
    parser.add_argument(
        "--signals-rate", type=not_negative, default=5.0, metavar="HZ",
        help="of values as JSON in the recording, for other programs (default 5; 0 none)",
    )  # fmt: skip
    parser.add_argument("--csv", type=Path, metavar="OUT.csv", help="the same as a table")
    parser.add_argument("--plot", type=Path, metavar="OUT.png", help="torques of every joint")
    parser.add_argument(
        "--render", type=Path, metavar="OUT.mp4", help="film it (.webm, .gif), or OUT.png"
    )
    parser.add_argument(
        "--at", type=not_negative, metavar="S", help="time of a picture (default: the end)"
    )
    add_picture_options(parser)
    parser.add_argument(
        "--fps", type=positive, metavar="N", help="frames per second (default 30; of a GIF 20)"
    )
    parser.add_argument(
        "--camera", metavar="CAM", help="name of a camera, or azimuth,elevation,distance"
    )
    parser.add_argument("--seed", type=seed, metavar="N", help="of the noise, over the file's")
    about = "set anything over the file's: controllers.lwr.stiffness=200; may be repeated"
    add_set_option(parser, "KEY=VALUE", about)
    parser.add_argument("--real-time", action="store_true", help="no faster than a real robot")
    group = parser.add_argument_group("to send it in real time, as a robot would")
    group.add_argument(
        "--send", metavar="SCENE", help="what that scene's source expects: its structure and routes"
    )
    add_sink_options(group)
    parser.add_argument("--overwrite", action="store_true", help="record over a file that exists")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress bar, no notes, no table")


def run(options: argparse.Namespace) -> int:
    """Runs; returns 0, 1 when something did not hold, or 130 when it was interrupted."""
    from ..simulate.scenario_file import read_scenario
    from ..simulate.simulation import Simulation

    _check_options(options)
    given = overrides(options.settings)
    with named_settings(given):
        scenario = read_scenario(options.scenario, given)
    simulation = Simulation(scenario, options.seed)
    begin = time.perf_counter()
    error = _simulate(simulation, options)
    seconds = time.perf_counter() - begin
    if options.csv is not None:
        from ..simulate.runs.run_csv import write_run_csv

        write_run_csv(simulation.layout, simulation.rows[: simulation.step + 1], options.csv)
    if options.plot is not None:
        from ..study.plot import plot_run, spans_of

        plot_run(
            simulation.log,
            options.plot,
            findings=simulation.findings(),
            spans=spans_of(simulation.scenario),
        )
    if options.render is not None:
        _render(simulation, options)
    is_whole = not isinstance(error, KeyboardInterrupt)
    outcomes, findings = simulation.outcomes() if is_whole else [], simulation.findings()
    if options.json:
        print_json(_as_json(simulation, seconds, error, outcomes, findings))
    else:
        _print(simulation, seconds, outcomes, findings, quiet=options.quiet)
    if error is not None:
        print(f"sero-mj: {error}", file=sys.stderr)
    if not is_whole:
        return 130
    return 0 if error is None and all(outcome.holds for outcome in outcomes) else 1


def _check_options(options: argparse.Namespace) -> None:
    """Refuses options that would only fail at the end."""
    endings = {
        "record": (".mcap",),
        "csv": (".csv",),
        "plot": (".png", ".pdf", ".svg"),
    }
    for key, expected in endings.items():
        path: Path | None = getattr(options, key)
        if path is None:
            continue
        check_ending(f"--{key} {path}", path, expected)
        path.parent.mkdir(parents=True, exist_ok=True)
    is_picture = False
    if options.render is not None:
        is_picture = not check_picture_or_film("--render", options.render)
        options.render.parent.mkdir(parents=True, exist_ok=True)
    if options.at is not None and not is_picture:
        raise UsageError("--at is for a picture: --render OUT.png")
    if is_picture and options.fps:
        raise UsageError("--fps is for a film: --render OUT.mp4")


def _simulate(
    simulation: Simulation, options: argparse.Namespace
) -> SimulationError | KeyboardInterrupt | None:
    """Runs to the end, or as far as it goes; returns what stopped it."""
    from contextlib import ExitStack

    from rich import progress as bars
    from rich.console import Console

    from ..simulate.log_output import RunRecorder

    columns = (bars.TextColumn("simulating"), bars.BarColumn(), bars.TaskProgressColumn())
    console = Console(stderr=True)
    with ExitStack() as stack:
        recorder = None
        if options.record is not None:
            recorder = stack.enter_context(
                RunRecorder(
                    simulation,
                    options.record,
                    overwrite=options.overwrite,
                    signals_rate=options.signals_rate,
                )
            )
        quiet = options.quiet or not console.is_terminal
        progress = stack.enter_context(
            bars.Progress(*columns, console=console, disable=quiet, transient=True)
        )
        task = progress.add_task("", total=simulation.steps)
        if options.send is not None:
            sender = stack.enter_context(Sender(simulation, options))
            batches = sender.run()
        elif options.real_time:
            batches = in_real_time(simulation)
        else:
            batches = simulation.run()
        try:
            for first, stop in batches:
                if recorder is not None:
                    recorder.write(first, stop)
                progress.update(task, completed=stop - 1)
        except SimulationError as error:
            return error
        except KeyboardInterrupt:
            when = f"{simulation.time:.3f} s of {simulation.scenario.duration:g} s"
            return KeyboardInterrupt(f"stopped at {when}; what is expected was not judged")
    return None


def _render(simulation: Simulation, options: argparse.Namespace) -> None:
    from ..simulate.simulated_scene import simulated_scene
    from ..viewer.headless.render import render_picture

    scene = simulated_scene(simulation)
    if check_picture_or_film("--render", options.render):
        film_with_progress(
            scene, options.render, quiet=options.quiet, duration=max(simulation.time, 1e-3),
            fps=options.fps, size=options.size, camera=options.camera, quality=options.quality,
        )  # fmt: skip
        return
    at = simulation.time if options.at is None else options.at
    if at > simulation.time:
        raise UsageError(f"--at {at:g}: the run ends at {simulation.time:g} s")
    render_picture(
        scene, options.render,
        size=options.size, camera=options.camera, at=at, quality=options.quality,
    )  # fmt: skip


def _print(
    simulation: Simulation, seconds: float, outcomes: list[Any], findings: list[Any], *, quiet: bool
) -> None:
    if not quiet:
        from ..study.summary import as_table, summarise

        speed = simulation.time / seconds if seconds > 0 else float("inf")
        print(
            f"{simulation.scenario.name}: {simulation.time:g} s in {seconds:.2f} s "
            f"({speed:.0f} times real time), {simulation.step} steps"
        )
        print_table(as_table(summarise(simulation.log, findings)))
        for finding in findings[:20]:
            print(f"  found   {finding}")
        if len(findings) > 20:
            print(f"  found   ... {len(findings) - 20} more")
    for outcome in outcomes:
        if not (quiet and outcome.holds):
            print(f"  {'held' if outcome.holds else 'FAILED':7} {outcome.name}: {outcome.text}")


def _as_json(
    simulation: Simulation, seconds: float, error: Any, outcomes: list[Any], findings: list[Any]
) -> dict[str, Any]:
    from ..study import summary

    return {
        "scenario": simulation.scenario.name,
        "seconds": simulation.time,
        "took": seconds,
        "error": None if error is None else str(error),
        "expect": [
            {"name": o.name, "holds": o.holds, "text": o.text, "value": o.value} for o in outcomes
        ],
        "findings": [vars(finding) for finding in findings],
        "joints": summary.as_json(summary.summarise(simulation.log, findings)),
    }
