"""`sero-mj sweep`: a scenario many times, with other values each time, and what came of it."""

from __future__ import annotations

import math
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BeforeValidator, model_validator

from ..base.errors import Problem, UsageError
from ..base.options import Option, Seed, ending, positional
from ._arguments import (
    command,
    named_settings,
    overrides,
    pace,
    print_json,
    print_table,
    progress_bar,
)
from .shared_options import Count, EngineOptions, Figure, JsonOptions, Settings

if TYPE_CHECKING:
    from ..study.engine import Engine
    from ..study.sweep import Sweep
    from ..study.sweep_results import SweepSummary, SweepTable

_EPILOG = """\
examples:
  sero-mj sweep impedance_push --vary controllers.lwr.stiffness=100:2000 --samples 50
  sero-mj sweep my.toml --vary controllers.lwr.stiffness=log:50:5000 \\
      --vary controllers.lwr.damping=0.3:1 --samples 1000 -o sweep.csv --plot sweep.png
  sero-mj sweep my.toml --vary run.seed=0:9999 --samples 10000 -o noise.csv --resume
  sero-mj sweep my.toml --vary run.elastic=true,false --vary 'run.timestep=0.001,0.0005' --grid
  sero-mj sweep my.toml --vary run.seed=0:9999 --samples 10000 --print-sbatch 40 > noise.sbatch
  sero-mj sweep my.toml --vary run.seed=0:9999 --samples 10000 -o noise.csv \\
      --engine dask --scheduler tcp://head:8786

KEY is anything that `simulate --set` takes. VALUES is a range LOW:HIGH, evenly in orders of
magnitude with log:LOW:HIGH, whole numbers with int:LOW:HIGH, or a list A,B,C. Samples are a Latin
hypercube, none of them twice, or with --grid all values with all others, as are lists with fewer
combinations than --samples. A variant that is unstable or cannot be built is a row with its
error. Rows are written as they come: what was interrupted goes on with --resume. On several
machines each runs a shard of the variants, into a table of its own; --merge joins these. Workers of
a Dask cluster take variants with --engine dask; it needs `pip install 'sero-mj[dask]'`. Exits with
1 when not every variant held.
"""
ORDER = 25  # in the help of `sero-mj`


def _shard(value: Any) -> Any:
    """Reads `2/8`, which is the second of eight."""
    if not isinstance(value, str):
        return value
    number, _, of = value.partition("/")
    if not (number.isdecimal() and of.isdecimal() and 1 <= int(number) <= int(of)):
        raise ValueError(f"found '{value}'; expected I/N, the Ith of N, from 1/N to N/N")
    return int(number), int(of)


Shard = Annotated[tuple[int, int], BeforeValidator(_shard)]


class SweepOptions(EngineOptions, JsonOptions):
    """Run variants of a scenario side by side, and compare them.

    Attributes:
        scenario: a file, or a shipped scenario's name.
        vary: what differs; may be repeated.
        samples: how many variants; with --grid how many values of every range.
        grid: all values with all others.
        seed: of the samples.
        settings: set anything in all variants: run.duration=2; may be repeated.
        out: a row for each variant.
        plot: outcomes over the values.
        shard: run only every Nth variant, from the Ith on.
        merge: run nothing, and join tables of shards: a file, or a pattern 'part.*.csv'; may be
            repeated.
        print_sbatch: print a job of SLURM that runs N shards, and run nothing.
        resume: go on with an OUT.csv that is there.
        overwrite: write over it.
        as_json: print the result as JSON.
        quiet: no progress bar, no notes, no table.
    """

    scenario: Annotated[str, positional("SCENARIO")]
    vary: Annotated[list[str], Option("KEY=VALUES")]
    samples: Count = 20
    grid: bool = False
    seed: Annotated[Seed, Option("S")] = 0
    settings: Settings = []
    out: Annotated[Path | None, ending(".csv"), Option("OUT.csv", ("-o", "--out"))] = None
    plot: Annotated[Figure | None, Option("OUT.png")] = None
    shard: Annotated[Shard | None, Option("I/N")] = None
    merge: Annotated[list[Path], Option("PART.csv")] = []
    print_sbatch: Annotated[Count | None, Option("N")] = None
    resume: bool = False
    overwrite: bool = False
    quiet: bool = False

    @model_validator(mode="after")
    def _check_resume(self) -> Self:
        if self.resume and self.out is None:
            raise ValueError("--resume: expected the file to go on with, -o OUT.csv")
        if self.resume and self.overwrite:
            raise ValueError("--resume and --overwrite: expected one of them")
        if self.shard is not None and self.merge:
            raise ValueError("--shard and --merge: expected one of them")
        if (self.shard is not None or self.merge) and self.out is None:
            option = "--merge" if self.merge else "--shard"
            raise ValueError(f"{option}: expected a file for the rows, -o OUT.csv")
        return self


def run(options: SweepOptions) -> int:
    """Runs; returns 0, or 1 when not every variant held."""
    from ..base.paths import find_scenario
    from ..study.sweep import Sweep, Vary
    from ..study.sweep_results import SweepTable, summarise_sweep

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
    if options.print_sbatch is not None:
        print(_sbatch(options.print_sbatch, options), end="")
        return 0
    wanted, engine = sweep.shard(*options.shard or (1, 1)), options.make_engine()
    with SweepTable(
        sweep, options.out, resume=options.resume, overwrite=options.overwrite
    ) as table:
        for part in _parts(options):
            table.take(part)
        before = len(table.rows)
        begin = time.perf_counter()
        todo = [number for number in wanted if number not in table.rows]
        is_whole = (
            not todo
            if options.merge
            else _run_variants(sweep, table, todo, engine, quiet=options.quiet)
        )
    seconds = time.perf_counter() - begin
    summary = summarise_sweep(table.rows, sweep.columns)
    if options.plot is not None:
        from ..study.sweep_results import plot_sweep

        plot_sweep(sweep, table.rows, options.plot)
    if options.as_json:
        print_json(_as_json(sweep, summary, seconds))
    elif not options.quiet:
        _print(sweep, table, summary, seconds, before)
    if not is_whole:
        again = " --resume" if options.out else ""
        left = sum(number not in table.rows for number in wanted)
        hint = f"; the same with{again} goes on" if again else ""
        print(f"sero-mj: stopped with {left} variants to go{hint}", file=sys.stderr)
        return 130
    return 0 if summary.held == summary.count else 1


add_to = command("sweep", run, SweepOptions, _EPILOG)


def _parts(options: SweepOptions) -> list[Path]:
    """The tables to join: files, and what patterns stand for."""
    found = []
    for path in options.merge:
        matches = sorted(path.parent.glob(path.name))
        if not matches:
            raise UsageError(Problem("--merge", "no file", found=str(path)))
        found += matches
    return found


def _sbatch(count: int, options: SweepOptions) -> str:
    """A job of SLURM with one task for each shard, which goes on where it is started again."""
    words = ["sero-mj", "sweep", options.scenario]
    for option, values in (("--vary", options.vary), ("--set", options.settings)):
        words += [word for value in values for word in (option, str(value))]
    words += ["--samples", str(options.samples), *(["--grid"] if options.grid else [])]
    words += ["--seed", str(options.seed)]
    same = shlex.join(words)
    out = options.out or Path(f"{Path(options.scenario).stem}.csv")
    part = f"{out.with_suffix('')}.$SLURM_ARRAY_TASK_ID.csv"
    parts = f"{out.with_suffix('')}.[0-9]*.csv"
    return f"""#!/bin/bash
#SBATCH --job-name=sero-mj
#SBATCH --array=1-{count}
#SBATCH --cpus-per-task=4
srun {same} \\
    --shard $SLURM_ARRAY_TASK_ID/{count} -o "{part}" \\
    --jobs "$SLURM_CPUS_PER_TASK" --resume --quiet
# Afterwards:
# {same} \\
#     --merge {shlex.quote(parts)} -o {shlex.quote(str(out))}
"""


def _run_variants(
    sweep: Sweep, table: SweepTable, todo: list[int], engine: Engine, *, quiet: bool
) -> bool:
    """Runs what is left to do; returns whether all was done."""
    from contextlib import closing

    before, failed, begin = len(table.rows), 0, time.perf_counter()
    count = before + len(todo)

    def note() -> str:
        about = pace(len(table.rows) - before, begin, engine.workers)
        return f"{about}, {failed} failed" if failed else about

    with (
        progress_bar("variants", quiet=quiet, note=note) as update,
        closing(sweep.run(engine, todo)) as results,
    ):
        update(before, count)
        try:
            for number, result in results:
                table.add(number, result)
                failed += not result["held"]
                update(len(table.rows), count)
        except KeyboardInterrupt:
            return False
    return True


def _print(
    sweep: Sweep, table: SweepTable, summary: SweepSummary, seconds: float, before: int
) -> None:
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
    print_table(shown)
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
