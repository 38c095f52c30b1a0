"""Runs `sero-mj compare --baseline`: trends of a robot's parameters over many recordings."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..base.errors import UsageError
from ..base.options import NotNegative, Option, Positive, ending
from .arguments import print_json, print_table, print_wrapped, writing
from .each_recording import Rows, examine_each, write_rows
from .shared_options import EngineOptions, Flag, JsonOptions, RunOptions

if TYPE_CHECKING:
    from ..study.explanation import Parameter
    from ..study.trend import Measured


class TrendOptions(RunOptions, JsonOptions, EngineOptions):
    """Options of trends, and other options for comparing many recordings.

    Attributes:
        robot: robot to compare; NAME,NAME if the robot's name differs in A and B.
        baseline: recording of the intact robot; report the trend of A, B, ... relative to it.
        tolerance_change: maximum change of a trend relative to the baseline, in percent; exit with
            1 if exceeded (default: 10).
        limit: relative change of a drifting parameter whose date is predicted, in percent
            (default: 50).
        junit: write the trends as JUnit XML for CI.
        table: write one row per recording to a table.
        output: write a page that plays A and B, with explanations of the difference on the
            timeline; with --baseline, a page that shows the trends.
        as_json: print the result as JSON.
        quiet: print no table and no progress bar.
    """

    robot: Flag = None
    baseline: Annotated[Path | None, Option("GOOD.mcap")] = None
    tolerance_change: Annotated[NotNegative, Option("PERCENT")] = 10.0
    limit: Annotated[Positive, Option("PERCENT")] = 50.0
    junit: Annotated[Path | None, ending(".xml"), Option("OUT.xml")] = None
    table: Annotated[Path | None, ending(".csv"), Option("OUT.csv")] = None
    output: Annotated[Path | None, ending(".html"), Option("OUT.html", ("-o", "--output"))] = None
    quiet: bool = False


def outcomes(shared: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Measures one recording of a batch; returns a mapping from column names to results.

    The columns are the `date`, whether it is the date of the file, the `robot`, its `joints`, and
    for each parameter the value, the standard error (`.error`) and the unit (`.unit`).
    """
    own = {key: shared[key] for key in ("robot", *RunOptions.model_fields) if key in shared}
    run, robot, joints = _measured(TrendOptions(**own), file)
    row = {"date": run.date.isoformat(timespec="seconds"), "date_of_file": run.is_date_of_file,
           "robot": robot, "joints": ", ".join(joints), "motion": run.motion}  # fmt: skip
    for each in run.parameters:
        row |= {each.key: each.value, f"{each.key}.error": each.error,
                f"{each.key}.unit": each.unit, f"{each.key}.reason": each.reason}  # fmt: skip
    return row


def _measured(options: TrendOptions, file: Path) -> tuple[Measured, str, list[str]]:
    from ..study.align import choose_robot
    from ..study.trend import Measured, date_of, measure, motion_of

    log = options.read(file, options.source)
    robot = choose_robot(log, options.robot)
    date, is_of_file = date_of(file)
    motion = motion_of(log, robot)
    run = Measured(str(file), date, is_of_file, measure(log, robot), motion)
    return run, robot, list(log.robots[robot].names)


def run_trend(options: TrendOptions, baseline: Path, recordings: list[Path]) -> int:
    """Reports the trends of recordings.

    Returns 0, 1 if a parameter changed, 2 if no recording can be used, or 130 if interrupted.

    Raises:
        SeroError: the baseline cannot be used.
    """
    from ..study.trend import (
        as_json,
        as_table,
        find_trends,
        is_other_motion,
        missing_parameters,
        test_cases,
    )

    begin, quiet = time.perf_counter(), options.quiet
    good, robot, joints = _measured(options, baseline)
    options = options.model_copy(update={"robot": robot})
    same = baseline.resolve()
    others = [path for path in dict.fromkeys(recordings) if path.resolve() != same]
    needed = options.files()
    rows = examine_each(options, f"{__name__}:outcomes", others, needed, quiet=quiet)
    if options.table is not None:
        write_rows([(path, _without_reasons(row)) for path, row in rows], options.table)
    used, skipped = _sorted_out(rows, good, robot, joints)
    for path, why in skipped:
        print(f"sero-mj: skipped {path}: {why}", file=sys.stderr)
    if not used:
        raise UsageError(f"none of {len(rows)} recordings can be compared with {baseline}")
    notes = [f"{run.path}: {why}" for run in used for why in missing_parameters(run, good)]
    if of_files := [run for run in (good, *used) if run.is_date_of_file]:
        notes.append(f"no start time in {_named(of_files)}: the date is that of the file")
    if moved := [run for run in used if is_other_motion(run.motion, good.motion)]:
        notes.append(f"another motion than in the baseline in {_named(moved)}: parameters may "
                     "differ because of the motion")  # fmt: skip
    tolerance, limit = 0.01 * options.tolerance_change, 0.01 * options.limit
    trends = find_trends(good, used, tolerance, limit)
    changed = [each for each in trends if each.is_changed]
    count = f"{len(used)} recordings" if len(used) > 1 else "1 recording"
    title = f"{robot}: {count} and the baseline {baseline.name}"
    if options.as_json:
        print_json({
            "baseline": str(baseline), "robot": robot, "trends": [as_json(each) for each in trends],
            "skipped": [{"recording": path, "reason": why} for path, why in skipped],
            "notes": notes,
        })  # fmt: skip
    elif not quiet:
        print_table(as_table(trends, title))
        print_wrapped([*(event for each in trends for event in each.events), *notes])
    with writing():
        if options.output is not None:
            from ..study.trend_page import write_trend_page

            write_trend_page(options.output, title, trends, skipped, notes)
        if options.junit is not None:
            from ..study.junit import write_junit

            seconds = time.perf_counter() - begin
            write_junit(options.junit, "trend", test_cases(trends, skipped), seconds=seconds)
    if changed:
        print(f"sero-mj: changed: {', '.join(each.name for each in changed)}", file=sys.stderr)
    if len(rows) < len(others):
        return 130
    return 1 if changed else 0


def _named(runs: list[Measured]) -> str:
    more = f" and {len(runs) - 1} more" if len(runs) > 1 else ""
    return f"{Path(runs[0].path).name}{more}"


def _sorted_out(
    rows: Rows, good: Measured, robot: str, joints: list[str]
) -> tuple[list[Measured], list[tuple[str, str]]]:
    # Recordings that can be compared with the baseline, and others with the reasons.
    from datetime import datetime

    from ..study.trend import Measured

    used, skipped = [], []
    for path, row in rows:
        if row["error"]:
            skipped.append((str(path), row["error"].removeprefix(f"{path}: ").removeprefix(
                f"{path} ")))  # fmt: skip
            continue
        if row["joints"] != ", ".join(joints):
            expected = f"the baseline has {', '.join(joints)}"
            skipped.append((str(path), f"{robot} has the joints {row['joints']}; {expected}"))
            continue
        parameters = [_parameter(row, each) for each in good.parameters]
        if not any(a.value is not None and b.value is not None
                   for a, b in zip(parameters, good.parameters, strict=True)):  # fmt: skip
            reasons = dict.fromkeys(each.reason for each in parameters if each.reason)
            why = "; ".join(reasons) or "no data"
            skipped.append((str(path), f"no parameter in common with the baseline: {why}"))
            continue
        date = datetime.fromisoformat(row["date"])
        used.append(Measured(str(path), date, row["date_of_file"], parameters, row["motion"]))
    return used, skipped


def _parameter(row: Mapping[str, Any], wanted: Parameter) -> Parameter:
    from dataclasses import replace

    value, error = row.get(wanted.key), row.get(f"{wanted.key}.error")
    return replace(wanted, value=value, error=error, reason=row.get(f"{wanted.key}.reason"))


def _without_reasons(row: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: value for key, value in row.items() if key != "motion" and not key.endswith(".reason")
    }
