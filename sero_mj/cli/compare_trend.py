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
    from ..study.measured import Measured


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
            timeline, or a report (.md); with --baseline, a page that shows the trends.
        as_json: print the result as JSON.
        quiet: print no table and no progress bar.
    """

    robot: Flag = None
    baseline: Annotated[Path | None, Option("GOOD.mcap")] = None
    tolerance_change: Annotated[NotNegative, Option("PERCENT")] = 10.0
    limit: Annotated[Positive, Option("PERCENT")] = 50.0
    junit: Annotated[Path | None, ending(".xml"), Option("OUT.xml")] = None
    table: Annotated[Path | None, ending(".csv"), Option("OUT.csv")] = None
    output: Annotated[
        Path | None, ending(".html", ".md"), Option("OUT.html", ("-o", "--output"))
    ] = None
    quiet: bool = False


def outcomes(shared: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Measures one recording of a batch; returns it as `run`, see `EachRecording`."""
    own = {key: shared[key] for key in ("robot", *RunOptions.model_fields) if key in shared}
    return {"run": _measured(TrendOptions(**own), file)}


def _measured(options: TrendOptions, file: Path) -> Measured:
    from ..study.align import choose_robot
    from ..study.measured import measure

    log = options.read(file, options.source)
    return measure(file, log, choose_robot(log, options.robot))


def run_trend(options: TrendOptions, baseline: Path, recordings: list[Path]) -> int:
    """Reports the trends of recordings.

    Returns 0, 1 if a parameter changed, 2 if no recording can be used, or 130 if interrupted.

    Raises:
        SeroError: the baseline cannot be used.
    """
    from ..study.measured import notes_of
    from ..study.trend import as_json, as_table, find_trends, test_cases

    begin, good = time.perf_counter(), _measured(options, baseline)
    options = options.model_copy(update={"robot": good.robot})
    same = baseline.resolve()
    others = [path for path in dict.fromkeys(recordings) if path.resolve() != same]
    rows = examine_each(
        options, f"{__name__}:outcomes", others, options.files(), quiet=options.quiet
    )
    if options.table is not None:
        write_rows([(path, _columns(row)) for path, row in rows], options.table)
    used, skipped = _sorted_out(rows, good)
    for path, why in skipped:
        print(f"sero-mj: skipped {path}: {why}", file=sys.stderr)
    if not used:
        raise UsageError(f"none of {len(rows)} recordings can be compared with {baseline}")
    trends = find_trends(good, used, 0.01 * options.tolerance_change, 0.01 * options.limit)
    count = f"{len(used)} recordings" if len(used) > 1 else "1 recording"
    title = f"{good.robot}: {count} and the baseline {baseline.name}"
    notes = notes_of(good, used)
    if options.as_json:
        print_json({
            "baseline": str(baseline), "robot": good.robot, "notes": notes,
            "skipped": [{"recording": path, "reason": why} for path, why in skipped],
            "trends": [as_json(each) for each in trends],
        })  # fmt: skip
    elif not options.quiet:
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
    changed = ", ".join(each.name for each in trends if each.is_changed)
    if changed:
        print(f"sero-mj: changed: {changed}", file=sys.stderr)
    if len(rows) < len(others):
        return 130
    return 1 if changed else 0


def _sorted_out(rows: Rows, good: Measured) -> tuple[list[Measured], list[tuple[str, str]]]:
    # Recordings that can be compared with the baseline, and others with the reasons.
    from dataclasses import replace

    from ..study.measured import date_of, why_not

    used, skipped = [], []
    for path, row in rows:
        why = row["error"].removeprefix(f"{path}: ").removeprefix(f"{path} ")
        if why := why or why_not(row["run"], good):
            skipped.append((str(path), why))
        else:
            run = replace(row["run"], path=str(path))
            # A worker on another machine has a copy of the file.
            used.append(replace(run, date=date_of(path)[0]) if run.is_date_of_file else run)
    return used, skipped


def _columns(row: Mapping[str, Any]) -> dict[str, Any]:
    # For each parameter the value, the standard error and the unit, or the reason of no value.
    if row["error"]:
        return {"error": row["error"]}
    run: Measured = row["run"]
    columns = {"error": "", "date": run.date.isoformat(timespec="seconds"),
               "date_of_file": run.is_date_of_file, "robot": run.robot}  # fmt: skip
    for each in run.parameters:
        columns |= {each.key: each.value, f"{each.key}.error": each.error,
                    f"{each.key}.unit": each.unit}  # fmt: skip
    return columns
