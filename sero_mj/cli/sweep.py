"""`sero-mj sweep`: a scenario many times, with other values each time, and what came of it."""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.errors import UsageError
from ._arguments import (
    Commands,
    add_command,
    add_set_option,
    check_ending,
    check_whole,
    named_settings,
    overrides,
    print_json,
    seed,
)

if TYPE_CHECKING:
    from ..study.sweep import Sweep
    from ..study.sweep_results import SweepSummary, SweepTable

_EPILOG = """\
examples:
  sero-mj sweep impedance_push --vary controllers.lwr.stiffness=100:2000 --samples 50
  sero-mj sweep my.toml --vary controllers.lwr.stiffness=log:50:5000 \\
      --vary controllers.lwr.damping=0.3:1 --samples 1000 -o sweep.csv --plot sweep.png
  sero-mj sweep my.toml --vary run.seed=0:9999 --samples 10000 -o noise.csv --resume
  sero-mj sweep my.toml --vary run.elastic=true,false --vary 'run.timestep=0.001,0.0005' --grid

KEY is anything that `simulate --set` takes. VALUES is a range LOW:HIGH, evenly in orders of
magnitude with log:LOW:HIGH, whole numbers with int:LOW:HIGH, or a list A,B,C. Samples are a Latin
hypercube, none of them twice, or with --grid all values with all others, as are lists with fewer
combinations than --samples. A variant that is unstable or cannot be built is a row with its
error. Rows are written as they come: what was interrupted goes on with --resume. Exits with 1 when
not every variant held.
"""
ORDER = 25  # in the help of `sero-mj`


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "sweep", run, "run variants of a scenario side by side, and compare them", _EPILOG
    )
    parser.add_argument("scenario", metavar="SCENARIO", help="a file, or a shipped scenario's name")
    parser.add_argument(
        "--vary", action="append", default=[], metavar="KEY=VALUES", required=True,
        help="what differs; may be repeated",
    )  # fmt: skip
    parser.add_argument(
        "--samples", type=_count, default=20, metavar="N",
        help="how many variants; with --grid how many values of every range (default 20)",
    )  # fmt: skip
    parser.add_argument("--grid", action="store_true", help="all values with all others")
    parser.add_argument(
        "--jobs", type=_count, metavar="J", help="how many at once (default: one per core)"
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="S", help="of the samples")
    about = "set anything in all variants: run.duration=2; may be repeated"
    add_set_option(parser, "KEY=VALUE", about)
    parser.add_argument("-o", "--out", type=Path, metavar="OUT.csv", help="a row for each variant")
    parser.add_argument("--plot", type=Path, metavar="OUT.png", help="outcomes over the values")
    parser.add_argument("--resume", action="store_true", help="go on with an OUT.csv that is there")
    parser.add_argument("--overwrite", action="store_true", help="write over it")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--quiet", action="store_true", help="no progress bar, no notes, no table")


def _count(text: str) -> int:
    return check_whole(text, "a whole number from 1 to 200000", 1, 200_000)


def run(options: argparse.Namespace) -> int:
    """Runs; returns 0, or 1 when not every variant held."""
    from ..base.paths import find_scenario
    from ..study.sweep import Sweep, Vary
    from ..study.sweep_results import SweepTable, summarise_sweep

    _check_options(options)
    varied = tuple(Vary.parse(option) for option in options.vary)
    fixed = overrides(options.settings)
    keys = {vary.key: None for vary in varied}
    with named_settings(fixed), named_settings(keys, "--vary"):
        sweep = Sweep(
            find_scenario(options.scenario).resolve(),
            varied,
            options.samples,
            options.grid,
            options.seed,
            fixed,
        )
    with SweepTable(
        sweep, options.out, resume=options.resume, overwrite=options.overwrite
    ) as table:
        before = len(table.rows)
        begin = time.perf_counter()
        is_whole = _run_variants(sweep, table, options)
    seconds = time.perf_counter() - begin
    summary = summarise_sweep(table.rows, sweep.columns)
    if options.plot is not None:
        from ..study.sweep_results import plot_sweep

        plot_sweep(sweep, table.rows, options.plot)
    if options.json:
        print_json(_as_json(sweep, summary, seconds))
    elif not options.quiet:
        _print(sweep, table, summary, seconds, before)
    if not is_whole:
        again = " --resume" if options.out else ""
        left = len(sweep.variants) - len(table.rows)
        hint = f"; the same with{again} goes on" if again else ""
        print(f"sero-mj: stopped with {left} variants to go{hint}", file=sys.stderr)
        return 130
    return 0 if summary.held == summary.count else 1


def _check_options(options: argparse.Namespace) -> None:
    for key, endings in (("out", (".csv",)), ("plot", (".png", ".pdf", ".svg"))):
        path: Path | None = getattr(options, key)
        if path is not None:
            check_ending(f"--{key} {path}", path, endings)
    if options.resume and options.out is None:
        raise UsageError("--resume: expected the file to go on with, -o OUT.csv")
    if options.resume and options.overwrite:
        raise UsageError("--resume and --overwrite: expected one of them")


def _run_variants(sweep: Sweep, table: SweepTable, options: argparse.Namespace) -> bool:
    """Runs what is left to do; returns whether all was done."""
    from contextlib import closing

    from rich import progress as bars
    from rich.console import Console

    from ..study.workers import available_cpus

    columns = (
        bars.TextColumn("variants"), bars.BarColumn(), bars.MofNCompleteColumn(),
        bars.TimeRemainingColumn(),
    )  # fmt: skip
    console = Console(stderr=True)
    quiet = options.quiet or not console.is_terminal
    count = len(sweep.variants)
    jobs = min(options.jobs or available_cpus(), max(count - len(table.rows), 1))
    with bars.Progress(*columns, console=console, disable=quiet, transient=True) as progress:
        task = progress.add_task("", total=count, completed=len(table.rows))
        with closing(sweep.run(jobs, done=set(table.rows))) as results:
            try:
                for number, result in results:
                    table.add(number, result)
                    progress.update(task, completed=len(table.rows))
            except KeyboardInterrupt:
                return False
    return True


def _print(
    sweep: Sweep, table: SweepTable, summary: SweepSummary, seconds: float, before: int
) -> None:
    from rich.console import Console
    from rich.table import Table

    new = summary.count - before
    rate = f"{new} in {seconds:.1f} s, {new / seconds:.1f} per second" if new else "all there"
    known = f"; {before} were there" if before and new else ""
    print(f"{sweep.base.name}: {summary.count} variants ({rate}{known})")
    shown = Table(box=None, pad_edge=False)
    shown.add_column("")
    for heading in ("held", "lowest", "at", "median", "highest", "at"):
        shown.add_column(heading, justify="left" if heading == "at" else "right")
    for each in summary.outcomes:
        held = "" if each.held is None else f"{each.held}/{summary.count}"
        lowest, median, highest = (
            "" if math.isnan(value) else f"{value:.4g}"
            for value in (each.lowest[0], each.median, each.highest[0])
        )
        low, high = (_values(sweep, number) for _, number in (each.lowest, each.highest))
        shown.add_row(each.name, held, lowest, low, median, highest, high)
    Console(width=200 if not sys.stdout.isatty() else None, highlight=False).print(shown)
    for number, error in list(summary.errors.items())[:5]:
        print(f"  stopped {_values(sweep, number)}: {error}")
    if len(summary.errors) > 5:
        print(f"  stopped ... {len(summary.errors) - 5} more")
    failed = summary.count - summary.held - len(summary.errors)
    print(f"{summary.held} held, {failed} did not, {len(summary.errors)} stopped with an error")


def _values(sweep: Sweep, number: int) -> str:
    """The values of a variant, in short: the last part of each key."""
    if number < 0:
        return ""
    parts = []
    for key, value in sweep.variants[number].items():
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        parts.append(f"{key.rpartition('.')[2]} {text}")
    return ", ".join(parts)


def _as_json(sweep: Sweep, summary: SweepSummary, seconds: float) -> dict[str, Any]:
    def at(value: float, number: int) -> Any:
        if math.isnan(value):
            return None
        return {"value": value, "variant": number, "values": sweep.variants[number]}

    return {
        "scenario": sweep.base.name,
        "variants": summary.count,
        "held": summary.held,
        "took": seconds,
        "errors": {str(number): error for number, error in summary.errors.items()},
        "outcomes": {
            each.name: {
                "held": each.held,
                "known": each.known,
                "lowest": at(*each.lowest),
                "median": each.median,
                "highest": at(*each.highest),
            }
            for each in summary.outcomes
        },
    }
