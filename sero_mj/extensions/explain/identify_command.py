"""`sero-mj identify`: estimates friction, payload and torque offsets of a robot from recordings."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from pydantic import model_validator

from ...base.options import Option, ending, positional
from ...cli.arguments import command, print_json, print_table, writing
from ...cli.shared_options import EngineOptions, Figure, Flag, JsonOptions, PartOptions
from .design_command import DESIGN, DesignOptions, design

if TYPE_CHECKING:
    from rich.table import Table

    from ...cli.each_recording import Rows
    from ...simulate.runs.run_log import RunLog

_HELP = """\
examples:
  sero-mj identify run.mcap --plot fit.pdf -o found.toml   the fit, and lines for a robot file
  sero-mj identify run.mcap --links --validate other.mcap -o found.toml   whole robot
  sero-mj identify --design --robot lwr -o excite.csv      a motion that excites all parameters

The command estimates friction and motor inertia from commanded minus measured torque, and payload
and sensor offsets from measured minus model torque, by linear regression with standard errors.
With --links, it estimates the masses, centers and inertias of all links as far as the motion
excites them, together with friction, motor inertia and offsets. It needs neither torque sensors nor
declared masses. --validate compares predicted torques with another recording.
Parameters that the motion does not excite are reported as not identifiable. All joints should move
back and forth, at low and high speed, and the wrist far enough to change the direction of gravity.
Several recordings are summarized by median, extremes and the median of the standard errors. They
are analyzed in parallel by local processes or by the workers of a Dask cluster.

With --design, the command writes a motion that excites all parameters, within the limits of the
robot and without collisions, as a table for `sero-mj send --play` and for targets of scenarios.
"""
GROUP, ORDER = "analyze", 44
_OF_RECORDINGS = (
    "recordings", "source", "columns", "begin", "end", "table", "jobs", "engine", "scheduler",
    "ship", "links", "validate_with",
)  # fmt: skip
_OF_ROBOTS = (".toml", ".urdf", ".xml")
_BATCH_OPTIONS = ("recordings", "jobs", "engine", "scheduler", "ship", "table")


class IdentifyOptions(PartOptions, JsonOptions, EngineOptions, DesignOptions):
    """Estimate friction, payload and torque offsets of a robot.

    Attributes:
        recordings: recordings or tables (.csv).
        robot: robot to identify (default: the only robot).
        links: identify all links instead of a payload.
        validate_with: another recording, whose torques are predicted (needs --links).
        output: file for the estimates as lines of a robot file (.toml), or for a designed motion
            (.csv). With --links, a robot file (.toml), URDF, or MJCF (.xml).
        plot: file for a figure of the fit or of the designed motion: .png, .pdf or .svg.
        table: write one row per recording to a table.
        as_json: print the estimates as JSON.
        quiet: print no table.
    """

    recordings: Annotated[list[Path], positional("RUN.mcap")] = []
    robot: Flag = None
    links: bool = False
    validate_with: Annotated[Path | None, Option("RUN.mcap", ("--validate",))] = None
    output: Annotated[
        Path | None, ending(*_OF_ROBOTS, ".csv"), Option("OUT", ("-o", "--output"))
    ] = None
    plot: Figure | None = None
    table: Annotated[Path | None, ending(".csv"), Option("OUT.csv")] = None
    quiet: bool = False

    @model_validator(mode="after")
    def _check_design(self) -> Self:
        if self.design:
            self.refuse(_OF_RECORDINGS, " cannot be combined with --design")
        elif not self.recordings:
            raise ValueError("expected a recording, or --design")
        self.refuse(() if self.design else DESIGN, " needs --design")
        needed = [".csv"] if self.design else _OF_ROBOTS if self.links else [".toml"]
        if self.output is not None and self.output.suffix.lower() not in needed:
            expected = f"expected a name that ends in {', '.join(needed)}"
            raise ValueError(f"--output: found '{self.output}'; {expected}")
        return self

    @model_validator(mode="after")
    def _check_number(self) -> Self:
        if self.is_batch:
            self.refuse(
                ("plot", "output", "validate_with"), " needs a single recording without --table"
            )
        self.refuse(("plot",) if self.links else (), " is not available with --links")
        self.refuse(() if self.links else ("validate_with",), " needs --links")
        return self

    @property
    def is_batch(self) -> bool:
        """Whether the result has one row per recording."""
        return len(self.recordings) > 1 or self.table is not None


def run(options: IdentifyOptions) -> int:
    """Identifies a robot and returns the exit status."""
    if options.design:
        return design(
            options, options.scene, options.robot, output=options.output, plot=options.plot,
            as_json=options.as_json, quiet=options.quiet,
        )  # fmt: skip
    if options.is_batch:
        return _identify_many(options)
    from ...study.align import choose_robot
    from .identify import as_json, as_table, as_toml, identify, plot_identified, remarks

    log = options.read_part(options.recordings[0])
    if options.links:
        return _identify_links(options, log, choose_robot(log, options.robot))
    found = identify(log, choose_robot(log, options.robot))
    if options.as_json:
        print_json(as_json(found))
    elif not options.quiet:
        print_table(as_table(found))
        for line in remarks(found):
            print(line)
        if options.output is None:
            print()
            print(as_toml(found), end="")
    if options.output is not None:
        with writing():
            options.output.write_text(as_toml(found), encoding="utf-8")
    if options.plot is not None:
        plot_identified(found, options.plot)
    return 0


def _identify_links(options: IdentifyOptions, log: RunLog, name: str) -> int:
    from ...study.align import choose_robot
    from .links.identify_links import identify_links, prediction_errors
    from .links.report import as_json, base_table, error_table, joint_table, remarks
    from .links.robot_files import write_identified

    whole, errors, other = identify_links(log, name), [], None
    if options.validate_with is not None:
        other = options.read(options.validate_with, options.source)
        errors = prediction_errors(whole, other, choose_robot(other, options.robot))
    if options.as_json:
        print_json(as_json(whole, errors))
    elif not options.quiet:
        print_table(joint_table(whole))
        print_table(base_table(whole))
        for line in remarks(whole):
            print(line)
        if other is not None:
            print_table(error_table(errors, other.name))
    if options.output is not None:
        with writing():
            write_identified(whole, options.output)
    return 0


def outcomes(shared: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """Returns the results of one recording of a batch by column; see `EachRecording`.

    The columns are `robot`, and three columns for each parameter, such as `JOINT.NAME` and
    `payload.NAME`: the value (None if not identifiable), the standard error (`.error`) and the unit
    (`.unit`).
    """
    from ...study.align import choose_robot
    from .identify import figures, identify
    from .links.identify_links import identify_links

    single = {key: value for key, value in shared.items() if key not in _BATCH_OPTIONS}
    options = IdentifyOptions(**{**single, "recordings": [str(file)]})
    log = options.read_part(file)
    robot = choose_robot(log, options.robot)
    whole = identify_links(log, robot) if options.links else None
    named = figures(identify(log, robot)) if whole is None else whole.named()
    row: dict[str, Any] = {"robot": log.robots[robot].name}
    for name, (each, unit) in named.items():
        row |= {name: each.value, f"{name}.error": each.error, f"{name}.unit": unit}
    return row


def _identify_many(options: IdentifyOptions) -> int:
    from ...cli.each_recording import examine_each, report_rows

    recordings, needed, quiet = options.recordings, options.files(), options.quiet
    rows = examine_each(options, f"{__name__}:outcomes", recordings, needed, quiet=quiet)
    status = report_rows(
        rows, len(recordings), options, options.table, lambda: _table_of(rows), quiet=quiet
    )
    robots = {row["robot"]: path for path, row in rows if "robot" in row}
    if len(robots) > 1 and not (options.as_json or quiet):
        named = ", ".join(f"{name} in {path}" for name, path in robots.items())
        print(f"sero-mj: warning: the recordings have different robots: {named}", file=sys.stderr)
    return status


def _table_of(rows: Rows) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    headings = ("", "recordings", "median", "minimum", "in", "maximum", "in", "standard error")
    for heading in headings:
        table.add_column(heading, justify="left" if heading in ("", "in") else "right")
    for name in dict.fromkeys(key for _, row in rows for key in row if f"{key}.error" in row):
        known = [(path, row) for path, row in rows if row.get(name) is not None]
        if not known:
            table.add_row(name, f"0 of {len(rows)}")
            continue
        values = np.array([row[name] for _, row in known])
        low, high = (known[k][0].name for k in (int(values.argmin()), int(values.argmax())))
        error = np.median([row[f"{name}.error"] or np.nan for _, row in known])
        unit = known[0][1][f"{name}.unit"]
        table.add_row(
            f"{name} [{unit}]", f"{len(known)} of {len(rows)}",
            f"{np.median(values):.4g}", f"{values.min():.4g}", low, f"{values.max():.4g}", high,
            f"± {error:.2g}",
        )  # fmt: skip
    return table


add_to = command("identify", run, IdentifyOptions, _HELP)
