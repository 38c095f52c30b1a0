"""`sero-mj simulate`: runs a scenario, records it, and evaluates its expectations."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import model_validator

from ..base.errors import SimulationError, UsageError
from ..base.options import NotNegative, Option, Seed, Time, ending, positional
from ..viewer.image.image_options import (
    VIDEO_FORMATS,
    CameraOptions,
    MotionOptions,
    Rate,
    SizeOptions,
    VideoOptions,
)
from .arguments import (
    command,
    finite,
    named_settings,
    overrides,
    print_json,
    print_programs,
    print_table,
    progress_bar,
)
from .render import ImageOrVideo, video_with_progress
from .send import Sender, SinkOptions, in_real_time
from .shared_options import Figure, JsonOptions, Settings

if TYPE_CHECKING:
    from ..simulate.simulation import Simulation

_HELP = """\
examples:
  sero-mj simulate impedance_push                       run and evaluate a scenario
  sero-mj simulate my.toml --record run.mcap --plot torques.png --render out.mp4
  sero-mj simulate impedance_push --send lwr_udp        send it in real time, like a robot

A scenario is a scene with [controllers], [targets], [disturbances], [faults] and [expect]. The exit
status is 1 if an expectation does not hold or the simulation fails, and 130 after Ctrl+C; all data
recorded until then stays on disk. Runs with the same seed are identical, bit for bit.
"""
GROUP, ORDER = "simulate", 30


class SimulateOptions(SizeOptions, CameraOptions, MotionOptions, JsonOptions, SinkOptions):
    """Run a scenario faster than real time and evaluate its expectations.

    Attributes:
        scenario: file or included name of a scenario.
        record: record every step in an MCAP file.
        signals_rate: rate of decoded values for other programs to store in the recording, in Hz,
            or 0 for none.
        csv: write every step to a table.
        plot: draw the torques of all joints.
        report: folder for a page that plays the run, a figure, report.json, and junit.xml for CI.
        render: render a video (.mp4, .webm, .gif) or an image (.png, .jpg, .webp).
        at: time of the image in seconds (default: the end).
        fps: frames per second (default: 30; GIF: 20).
        seed: seed of the noise; overrides the seed in the scenario.
        settings: override a field, for example controllers.lwr.stiffness=200; repeatable.
        real_time: run no faster than real time.
        send: scene whose source receives the run in real time; defines packet layout and routes.
        overwrite: replace an existing recording.
        as_json: print the result as JSON.
        quiet: print only failed expectations.
    """

    scenario: Annotated[str, positional("SCENARIO")]
    record: Annotated[Path | None, ending(".mcap"), Option("OUT.mcap")] = None
    signals_rate: Annotated[NotNegative, Option("HZ")] = 5.0
    csv: Annotated[Path | None, ending(".csv"), Option("OUT.csv")] = None
    plot: Annotated[Figure | None, Option("OUT.png")] = None
    report: Annotated[Path | None, Option("DIR")] = None
    render: Annotated[ImageOrVideo | None, Option("OUT.mp4")] = None
    at: Time | None = None
    fps: Rate | None = None
    seed: Seed | None = None
    settings: Settings = []
    real_time: bool = False
    send: Annotated[str | None, Option("SCENE")] = None
    overwrite: bool = False
    quiet: bool = False

    @property
    def is_image(self) -> bool:
        """Whether --render writes an image instead of a video."""
        return self.render is not None and self.render.suffix.lower() not in VIDEO_FORMATS

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        if self.at is not None and not self.is_image:
            raise ValueError("--at needs an image: --render OUT.png")
        is_video = self.render is not None and not self.is_image
        if not is_video:
            names = ("fps", "orbit", "camera_path") if self.is_image else ("orbit", "camera_path")
            self.refuse(names, " needs a video: --render OUT.mp4")
        return self


def run(options: SimulateOptions) -> int:
    """Runs the scenario.

    Returns 0, 1 if an expectation failed, or 130 if the run was interrupted.
    """
    from ..simulate.scenario_file import read_scenario
    from ..simulate.simulation import Simulation

    for path in (options.record, options.csv, options.plot, options.render):
        if path is not None:  # an error is reported before the run
            path.parent.mkdir(parents=True, exist_ok=True)
    settings = overrides(options.settings)
    with named_settings(settings):
        scenario = read_scenario(options.scenario, settings)
    print_programs(scenario)
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
        _render(simulation, options, options.render)
    is_whole = not isinstance(error, KeyboardInterrupt)
    outcomes, findings = simulation.outcomes() if is_whole else [], simulation.findings()
    if options.report is not None and is_whole:
        from ..study.run_report import write_report

        about = finite(_as_json(simulation, seconds, error, outcomes, findings))
        write_report(simulation, options.report, about, error=error)
    if options.as_json:
        print_json(_as_json(simulation, seconds, error, outcomes, findings))
    else:
        held = "held" if error is None else "so far"
        _print(simulation, seconds, outcomes, findings, held, quiet=options.quiet)
    if error is not None:
        print(f"sero-mj: {error}", file=sys.stderr)
    if not is_whole:
        return 130
    return 0 if error is None and all(outcome.holds for outcome in outcomes) else 1


add_to = command("simulate", run, SimulateOptions, _HELP)


def _simulate(
    simulation: Simulation, options: SimulateOptions
) -> SimulationError | KeyboardInterrupt | None:
    from contextlib import ExitStack

    from ..simulate.log_output import RunRecorder

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
        update = stack.enter_context(progress_bar("simulating", quiet=options.quiet))
        if options.send is not None:
            sender = stack.enter_context(Sender(simulation, options.send, options))
            batches = sender.run()
        elif options.real_time:
            batches = in_real_time(simulation)
        else:
            batches = simulation.run()
        try:
            for first, stop in batches:
                if recorder is not None:
                    recorder.write(first, stop)
                update(stop - 1, simulation.steps)
        except SimulationError as error:
            return error
        except KeyboardInterrupt:
            when = f"{simulation.time:.3f} s of {simulation.scenario.duration:g} s"
            return KeyboardInterrupt(f"stopped at {when}; expectations were not evaluated")
    return None


def _render(simulation: Simulation, options: SimulateOptions, output: Path) -> None:
    from ..simulate.simulated_scene import simulated_scene
    from ..viewer.image.render import render_image

    scene, rendered = simulated_scene(simulation), VideoOptions.taken_from(options)
    if not options.is_image:
        rendered = rendered.model_copy(update={"duration": max(simulation.time, 1e-3)})
        video_with_progress(scene, output, rendered, quiet=options.quiet)
        return
    at = simulation.time if options.at is None else options.at
    if at > simulation.time:
        raise UsageError(f"--at {at:g}: the run ends at {simulation.time:g} s")
    render_image(scene, output, rendered, at=at)


def _print(
    simulation: Simulation,
    seconds: float,
    outcomes: list[Any],
    findings: list[Any],
    held: str,
    *,
    quiet: bool,
) -> None:
    if not quiet:
        from ..simulate.real_time import real_time_of
        from ..study.summary import as_table, summarise

        speed = simulation.time / seconds if seconds > 0 else float("inf")
        print(
            f"{simulation.scenario.name}: {simulation.time:g} s in {seconds:.2f} s "
            f"({speed:{'.0f' if speed >= 10 else '.2g'}} times real time), {simulation.step} steps"
        )
        for name, found in real_time_of(simulation.log).items():
            print(
                f"  {name}: {found.factor:.2g} times real time, "
                f"steps delayed by up to {found.max_lateness:.3g} s"
            )
        print_table(as_table(summarise(simulation.log, findings)))
        for finding in findings[:20]:
            print(f"  found   {finding}")
        if len(findings) > 20:
            print(f"  found   ... {len(findings) - 20} more")
    if not (outcomes or simulation.scenario.expect or quiet):
        print("  no expectations: the file has no [expect]")
    for outcome in outcomes:
        if not (quiet and outcome.holds):
            print(f"  {held if outcome.holds else 'FAILED':7} {outcome.name}: {outcome.text}")


def _as_json(
    simulation: Simulation, seconds: float, error: Any, outcomes: list[Any], findings: list[Any]
) -> dict[str, Any]:
    from ..simulate.real_time import real_time_of
    from ..study import summary

    return {
        "scenario": simulation.scenario.name,
        "seconds": simulation.time,
        "took": seconds,
        "error": None if error is None else str(error),
        "expect": [
            {"name": o.name, "holds": o.holds, "text": o.text, "value": o.value} for o in outcomes
        ],
        "real_time": {name: vars(found) for name, found in real_time_of(simulation.log).items()},
        "findings": [vars(finding) for finding in findings],
        "joints": summary.as_json(summary.summarise(simulation.log, findings)),
    }
