"""`sero-mj sweep`: a scenario many times, with something else each time, and what came of it."""

from __future__ import annotations

import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BeforeValidator, model_validator

from ...base.errors import Problem, UsageError
from ...base.options import Option, Seed, ending, positional
from ...cli.arguments import (
    command,
    named_settings,
    overrides,
    pace,
    print_json,
    print_programs,
    progress_bar,
)
from ...cli.shared_options import Count, EngineOptions, Figure, JsonOptions, Settings

if TYPE_CHECKING:
    from ...study.engine import Engine
    from .sweep import Design, Sweep
    from .sweep_results import SweepTable

_HELP = """\
examples:
  sero-mj sweep impedance_push --vary controllers.lwr.stiffness=100:2000 --samples 50
  sero-mj sweep my.toml --vary run.elastic=true,false --vary run.seed=0:9 --grid -o sweep.csv
  sero-mj sweep my.toml --mutations faults.toml -o noticed.csv

KEY is anything that `simulate --set` takes. VALUES is a range LOW:HIGH, evenly in orders of
magnitude with log:LOW:HIGH, whole numbers with int:LOW:HIGH, or a list A,B,C. Samples are a Latin
hypercube, none of them twice, or with --grid all values with all others, as are lists with fewer
combinations than --samples. A variant that is unstable or cannot be built is a row with its
error. FILE.toml of --mutations has a table for everything that may be wrong, ["half as stiff"] say,
with keys and values: "controllers.lwr.stiffness" = 400. Rows are written as they come: what was
interrupted goes on with --resume. On several machines each runs a shard of the variants, into a
table of its own; --merge joins these. Workers of a Dask cluster take variants with --engine dask;
it needs `pip install 'sero-mj[dask]'`. Exits with 1 when not every variant held, or not every
mutation was noticed.
"""
GROUP, ORDER = "simulate", 32


def _shard(value: Any) -> Any:
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
        mutations: what may be wrong, one thing in each variant: does an expectation notice it?
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
    vary: Annotated[list[str], Option("KEY=VALUES")] = []
    mutations: Annotated[Path | None, ending(".toml"), Option("FILE.toml")] = None
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
    def _check_design(self) -> Self:
        if not self.vary and self.mutations is None:
            raise ValueError("--vary: expected what differs, KEY=VALUES, or --mutations FILE.toml")
        if self.vary and self.mutations is not None:
            raise ValueError("--vary and --mutations: expected one of them")
        if self.mutations is not None and self.plot is not None:
            raise ValueError("--plot: expected --vary; mutations have no axes")
        return self

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

    def design(self) -> Design:
        """Returns which variants there are."""
        if self.mutations is not None:
            from .mutations import Mutations

            return Mutations.read(self.mutations)
        from .samples import Samples, Vary

        varied = tuple(Vary.parse(option) for option in self.vary)
        return Samples(varied, self.samples, self.grid, self.seed)


def run(options: SweepOptions) -> int:
    """Runs; returns 0, or 1 when not every variant held or not every mutation was noticed."""
    from ...base.paths import find_scenario
    from .reports import report_of
    from .sweep import Sweep
    from .sweep_results import SweepTable

    design, fixed = options.design(), overrides(options.settings)
    keys = dict.fromkeys(design.columns)
    with named_settings(fixed), named_settings(keys, "--vary"):
        sweep = Sweep(find_scenario(options.scenario).resolve(), design, fixed)
    print_programs(sweep.base)
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
    seconds, new = time.perf_counter() - begin, len(table.rows) - before
    report = report_of(sweep, table.rows)
    if options.plot is not None:
        from .sweep_results import plot_sweep

        plot_sweep(sweep, table.rows, options.plot)
    if options.as_json:
        print_json({"scenario": sweep.base.name, "took": seconds, **report.as_json()})
    elif not options.quiet:
        rate = f"{new} in {seconds:.1f} s, {new / seconds:.1f} per second" if new else "all there"
        known = f"; {before} were there" if before and new else ""
        print(f"{sweep.base.name}: {len(table.rows)} variants ({rate}{known})")
        report.tell()
    if not is_whole:
        again = " --resume" if options.out else ""
        left = sum(number not in table.rows for number in wanted)
        hint = f"; the same with{again} goes on" if again else ""
        print(f"sero-mj: stopped with {left} variants to go{hint}", file=sys.stderr)
        return 130
    return 0 if report.is_good else 1


add_to = command("sweep", run, SweepOptions, _HELP)


def _parts(options: SweepOptions) -> list[Path]:
    found = []
    for path in options.merge:
        matches = sorted(path.parent.glob(path.name))
        if not matches:
            raise UsageError(Problem("--merge", "no file", found=str(path)))
        found += matches
    return found


def _sbatch(count: int, options: SweepOptions) -> str:
    words = ["sero-mj", "sweep", options.scenario]
    for option, values in (("--vary", options.vary), ("--set", options.settings)):
        words += [word for value in values for word in (option, str(value))]
    if options.mutations is not None:
        words += ["--mutations", str(options.mutations)]
    else:
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
