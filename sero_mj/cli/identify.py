"""`sero-mj identify`: a robot's friction, payload and torque offsets, from recordings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import model_validator

from ..base.options import Option, ending, positional
from ._arguments import command, print_json, print_table, writing
from .shared_options import EngineOptions, Figure, Flag, JsonOptions, PartOptions

_EPILOG = """\
examples:
  sero-mj identify run.mcap --robot lwr
  sero-mj identify run.mcap --plot fit.pdf -o found.toml   the fit, and lines of a robot's file
  sero-mj identify run.mcap --from 2 --to 12 --json
  sero-mj identify run.csv --scene lwr                     of simulate --csv, or export-csv
  sero-mj identify runs/*.mcap --csv found.csv             how far many recordings agree

Linear regression on both sides of the torque sensors: friction and motor inertia by commanded less
measured torque, payload and offsets by measured torque less that of the robot's model, each with
its standard error. What the motion does not tell is said, and not guessed: all joints should move,
to and fro, slowly and faster, and the wrist far enough that gravity changes. Of several recordings
it is said how far they agree; they are examined by all cores, or by workers of a Dask cluster,
which are sent the recordings.
"""
ORDER = 46  # in the help of `sero-mj`
_OF_MANY = ("recordings", "jobs", "engine", "scheduler", "ship", "csv")


class IdentifyOptions(PartOptions, JsonOptions, EngineOptions):
    """Estimate friction, payload and torque offsets.

    Attributes:
        recordings: recordings, or tables (.csv).
        robot: which robot (default: the only one).
        output: lines of a robot's file.
        plot: the fit: .png, .pdf or .svg.
        csv: of several recordings, a row for each.
        as_json: print what is found as JSON.
        quiet: no table.
    """

    recordings: Annotated[list[Path], positional("RUN.mcap")]
    robot: Flag = None
    output: Annotated[Path | None, ending(".toml"), Option("OUT.toml", ("-o", "--output"))] = None
    plot: Figure | None = None
    csv: Annotated[Path | None, ending(".csv"), Option("OUT.csv")] = None
    quiet: bool = False

    @model_validator(mode="after")
    def _check_number(self) -> Self:
        if len(self.recordings) > 1:
            self.refuse(("plot", "output"), " is for one recording; found several")
        else:
            self.refuse(("csv", "jobs", "engine"), " is for several recordings; found one")
        return self


def run(options: IdentifyOptions) -> int:
    """Identifies; returns 0."""
    if len(options.recordings) > 1:
        return _identify_many(options)
    from ..study.align import choose_robot
    from ..study.identify import as_json, as_table, as_toml, identify, plot_identified, remarks

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
        `JOINT.FIGURE` and `payload.FIGURE` to its value, and to its standard error with `.error`.
    """
    from ..study.align import choose_robot
    from ..study.identify import figures, identify

    given = {key: value for key, value in shared.items() if key not in _OF_MANY}
    options = IdentifyOptions(**{**given, "recordings": [str(file)]})
    log = options.read_part(file)
    found = figures(identify(log, choose_robot(log, options.robot)))
    return {key: value for name, each in found.items()
            for key, value in ((name, each.value), (f"{name}.error", each.error))}  # fmt: skip


def _identify_many(options: IdentifyOptions) -> int:
    from rich.table import Table

    from ._each_recording import ask_each, status, tell_errors, write_rows

    needed = [Path(options.scene)] if options.scene and Path(options.scene).is_file() else []
    recordings = options.recordings
    rows = ask_each(options, f"{__name__}:outcomes", recordings, needed, quiet=options.quiet)
    if options.csv is not None:
        write_rows(rows, options.csv)
    if options.as_json:
        print_json([{"recording": str(path), **row} for path, row in rows])
    elif not options.quiet:
        names = dict.fromkeys(key for _, row in rows for key in row if f"{key}.error" in row)
        table = Table(box=None, pad_edge=False)
        for heading in ("", "recordings", "median", "lowest", "highest", "standard error"):
            table.add_column(heading, justify="left" if not heading else "right")
        for name in names:
            known = [row for _, row in rows if row.get(name) is not None]
            if not known:
                continue
            values = np.array([row[name] for row in known])
            errors = np.array([row[f"{name}.error"] or np.nan for row in known])
            shown = (np.median(values), values.min(), values.max(), np.median(errors))
            table.add_row(name, str(len(known)), *(f"{value:.4g}" for value in shown))
        print_table(table)
    failed = tell_errors(rows)
    return status(rows, len(recordings), failed) or (1 if failed else 0)


add_to = command("identify", run, IdentifyOptions, _EPILOG)
