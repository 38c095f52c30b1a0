"""`sero-mj sweep`: runs variants of a scenario, and compares their outcomes."""

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

KEY is any key of `simulate --set`. VALUES is a range LOW:HIGH, a logarithmic range log:LOW:HIGH, a
range of integers int:LOW:HIGH, or a list A,B,C. Samples are a Latin hypercube without repetitions.
With --grid, or if there are fewer combinations than --samples, all combinations are run. If a
variant is invalid or unstable, its row contains the error. The FILE.toml of --mutations has one
table per mutation, for example ["half as stiff"] with "controllers.lwr.stiffness" = 400. Rows are
written immediately; --resume continues an interrupted sweep. To use several machines, run a --shard
on each of them, and join the tables with --merge, or use a Dask cluster with --engine dask, which
requires `pip install 'sero-mj[dask]'`. The exit status is 1 if a variant failed, or if a mutation
was not detected.
"""
GROUP, ORDER = "simulate", 32


def _shard(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    number, _, of = value.partition("/")
    if not (number.isdecimal() and of.isdecimal() and 1 <= int(number) <= int(of)):
        raise ValueError(f"found '{value}'; expected I/N, from 1/N to N/N")
    return int(number), int(of)


Shard = Annotated[tuple[int, int], BeforeValidator(_shard)]


class SweepOptions(EngineOptions, JsonOptions):
    """Run variants of a scenario in parallel, and compare their outcomes.

    Attributes:
        scenario: file or included name of a scenario.
        vary: key to vary, and its values; repeatable.
        mutations: file with mutations that expectations should detect.
        samples: number of variants; with --grid, number of values per range (default: 20).
        grid: run all combinations of the values.
        seed: seed of the samples.
        settings: set a value in all variants, for example run.duration=2; repeatable.
        out: output table with one row per variant.
        plot: file for a plot of outcomes over values.
        shard: run only every Nth variant, starting from the Ith.
        merge: join tables of shards (a file, or a pattern such as 'part.*.csv') instead of running
            variants; repeatable.
        print_sbatch: print a SLURM job that runs N shards, instead of running variants.
        resume: continue an existing OUT.csv.
        overwrite: replace an existing OUT.csv.
        as_json: print the result as JSON.
        quiet: hide the progress bar, notes and table.
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
            raise ValueError("--vary: expected KEY=VALUES, or --mutations FILE.toml")
        if self.vary and self.mutations is not None:
            raise ValueError("--vary cannot be combined with --mutations")
        if self.mutations is not None and self.plot is not None:
            raise ValueError("--plot needs --vary, because mutations have no axes")
        return self

    @model_validator(mode="after")
    def _check_resume(self) -> Self:
        if self.resume and self.out is None:
            raise ValueError("--resume needs the file to continue: add -o OUT.csv")
        if self.resume and self.overwrite:
            raise ValueError("--resume cannot be combined with --overwrite")
        if self.shard is not None and self.merge:
            raise ValueError("--shard cannot be combined with --merge")
        if (self.shard is not None or self.merge) and self.out is None:
            option = "--merge" if self.merge else "--shard"
            raise ValueError(f"{option} needs a file for the rows: add -o OUT.csv")
        return self

    def design(self) -> Design:
        if self.mutations is not None:
            from .mutations import Mutations

            return Mutations.read(self.mutations)
        from .samples import Samples, Vary

        varied = tuple(Vary.parse(option) for option in self.vary)
        return Samples(varied, self.samples, self.grid, self.seed)


def run(options: SweepOptions) -> int:
    """Runs a sweep.

    Returns 0 if all variants passed or all mutations were detected, 130 if the sweep was
    interrupted, otherwise 1.
    """
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
        rate = f"{new} in {seconds:.1f} s, {new / seconds:.1f} per second" if new else "none new"
        known = f"; {before} from earlier runs" if before and new else ""
        print(f"{sweep.base.name}: {len(table.rows)} variants ({rate}{known})")
        report.show()
    if not is_whole:
        again = " --resume" if options.out else ""
        left = sum(number not in table.rows for number in wanted)
        hint = f"; repeat the command with{again} to continue" if again else ""
        print(f"sero-mj: stopped; {left} variants are left{hint}", file=sys.stderr)
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
    """Runs the remaining variants; returns False if interrupted."""
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
