"""`sero-mj identify`: a robot's friction, payload and torque offsets, from recordings."""

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

if TYPE_CHECKING:
    from rich.table import Table

    from ...cli.each_recording import Rows

_HELP = """\
examples:
  sero-mj identify run.mcap --robot lwr
  sero-mj identify run.mcap --plot fit.pdf -o found.toml   the fit, and lines of a robot file
  sero-mj identify runs/*.mcap --table found.csv           how far many recordings agree

Linear regression on both sides of the torque sensors: friction and motor inertia by commanded less
measured torque, payload and offsets by measured torque less that of the robot's model, each with
its standard error. What the motion does not tell is said, and not guessed: all joints should move,
to and fro, slowly and faster, and the wrist far enough that gravity changes. Of several recordings
it is said how far they agree (median, extremes, and the median of the standard errors); they are
examined by all cores, or by workers of a Dask cluster, which are sent the recordings.
"""
GROUP, ORDER = "analyse", 44
_OF_MANY = ("recordings", "jobs", "engine", "scheduler", "ship", "table")


class IdentifyOptions(PartOptions, JsonOptions, EngineOptions):
    """Estimate friction, payload and torque offsets.

    Attributes:
        recordings: recordings, or tables (.csv).
        robot: which robot (default: the only one).
        output: lines of a robot's file.
        plot: the fit: .png, .pdf or .svg.
        table: a row for each recording.
        as_json: print what is found as JSON.
        quiet: no table.
    """

    recordings: Annotated[list[Path], positional("RUN.mcap")]
    robot: Flag = None
    output: Annotated[Path | None, ending(".toml"), Option("OUT.toml", ("-o", "--output"))] = None
    plot: Figure | None = None
    table: Annotated[Path | None, ending(".csv"), Option("OUT.csv")] = None
    quiet: bool = False

    @model_validator(mode="after")
    def _check_number(self) -> Self:
        if self.is_many:
            self.refuse(("plot", "output"), " is for one recording, without --table")
        return self

    @property
    def is_many(self) -> bool:
        """Whether there is a row for every recording."""
        return len(self.recordings) > 1 or self.table is not None


def run(options: IdentifyOptions) -> int:
    """Identifies; returns 0."""
    if options.is_many:
        return _identify_many(options)
    from ...study.align import choose_robot
    from .identify import as_json, as_table, as_toml, identify, plot_identified, remarks

    log = options.read_part(options.recordings[0])
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


def outcomes(shared: Mapping[str, Any], file: Path) -> dict[str, Any]:
    """What is found in one of many recordings, by column; see `EachRecording`.

    Args:
        shared: the options, with all recordings.
        file: the recording.

    Returns:
        the `robot`; of every `JOINT.FIGURE` and `payload.FIGURE` its value, None where the motion
        does not tell, and with `.error` its standard error, with `.unit` its unit.
    """
    from ...study.align import choose_robot
    from .identify import figures, identify

    given = {key: value for key, value in shared.items() if key not in _OF_MANY}
    options = IdentifyOptions(**{**given, "recordings": [str(file)]})
    log = options.read_part(file)
    found = identify(log, choose_robot(log, options.robot))
    row: dict[str, Any] = {"robot": found.robot.name}
    for name, (each, unit) in figures(found).items():
        row |= {name: each.value, f"{name}.error": each.error, f"{name}.unit": unit}
    return row


def _identify_many(options: IdentifyOptions) -> int:
    from ...cli.each_recording import ask_each, status, tell

    recordings, needed = options.recordings, options.files()
    rows = ask_each(options, f"{__name__}:outcomes", recordings, needed, quiet=options.quiet)
    failed = tell(rows, options, options.table, lambda: _table_of(rows), quiet=options.quiet)
    robots = {row["robot"]: path for path, row in rows if "robot" in row}
    if len(robots) > 1 and not (options.as_json or options.quiet):
        named = ", ".join(f"{name} in {path}" for name, path in robots.items())
        print(f"sero-mj: these are several robots: {named}", file=sys.stderr)
    return status(rows, len(recordings), failed)


def _table_of(rows: Rows) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("", "told by", "median", "lowest", "in", "highest", "in", "its own error"):
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
