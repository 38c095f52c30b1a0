"""Options of `sero-mj compare` for trends of a robot's parameters over many recordings."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from ...base.errors import UsageError
from ...base.options import NotNegative, Option, Positive, ending
from ...cli.arguments import print_json, print_table, print_wrapped, writing
from ...cli.compare import CompareOptions
from ...cli.shared_options import RunOptions

if TYPE_CHECKING:
    from ...cli.each_recording import Rows
    from .measured import Measured

_OF_TRENDS = ("junit", "limit", "tolerance_change")
_OF_PAIRS = (
    "each", "against_model", "offset", "plot", "csv", "render", "tolerance_torque",
    "tolerance_angle",
)  # fmt: skip


class TrendOptions(CompareOptions):
    """Options of trends.

    Attributes:
        baseline: recording of the intact robot; report the trend of A, B, ... relative to it.
        tolerance_change: maximum change of a trend relative to the baseline, in percent; exit with
            1 if exceeded (default: 10).
        limit: relative change of a drifting parameter whose date is predicted, in percent
            (default: 50).
        junit: write the trends as JUnit XML for CI.
        output: write a page that plays A and B, with explanations of the difference on the
            timeline, or a report (.md); with --baseline, a page that shows the trends.
    """

    title: ClassVar[str] = "trends over many recordings"
    notes: ClassVar[str] = """\
With --baseline, the report shows friction, offsets, gravity errors, torque errors and temperatures
of each joint over time, with change points and drifts. Recordings that cannot be compared are
skipped. The exit status is 1 if a parameter changed beyond --tolerance-change. Example:
  sero-mj compare nightly/*.mcap --baseline good.mcap -o trend.html
"""
    baseline: Annotated[Path | None, Option("GOOD.mcap")] = None
    tolerance_change: Annotated[NotNegative, Option("PERCENT")] = 10.0
    limit: Annotated[Positive, Option("PERCENT")] = 50.0
    junit: Annotated[Path | None, ending(".xml"), Option("OUT.xml")] = None

    def check_combination(self) -> None:
        if self.baseline is not None:
            self.refuse(_OF_PAIRS, " cannot be combined with --baseline")
            if self.output is not None and self.output.suffix.lower() != ".html":
                raise ValueError(f"--output: found '{self.output}'; expected .html with --baseline")
        else:
            self.refuse(_OF_TRENDS, " needs --baseline")
            super().check_combination()

    def compare(self) -> int:
        return super().compare() if self.baseline is None else _report(self, self.baseline)


def outcomes(shared: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Measures one recording of a batch; returns it as `run`, see `EachRecording`."""
    own = {key: shared[key] for key in ("robot", *RunOptions.model_fields) if key in shared}
    return {"run": _measured(TrendOptions(a=file, **own), file)}


def _measured(options: TrendOptions, file: Path) -> Measured:
    from ...study.align import choose_robot
    from .measured import measure

    log = options.read(file, options.source)
    return measure(file, log, choose_robot(log, options.robot))


def _report(options: TrendOptions, baseline: Path) -> int:
    # Returns 0, 1 if a parameter changed, or 130 if interrupted.
    from ...cli.each_recording import examine_each, write_rows
    from .measured import notes_of
    from .trend import as_json, as_table, find_trends, test_cases

    begin, good = time.perf_counter(), _measured(options, baseline)
    options = options.model_copy(update={"robot": good.robot})
    recordings = dict.fromkeys(path for path in (options.a, options.b, *options.more) if path)
    others = [path for path in recordings if path.resolve() != baseline.resolve()]
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
            from .trend_page import write_trend_page

            write_trend_page(options.output, title, trends, skipped, notes)
        if options.junit is not None:
            from ...study.junit import write_junit

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
    from .measured import date_of, why_not

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
