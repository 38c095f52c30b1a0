"""`sero-mj export-csv`: a recording as a table."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from ..base.errors import UsageError
from ._arguments import Commands, add_command, check_span, not_negative

_EPILOG = """\
examples:
  sero-mj export-csv run.mcap run.csv
  sero-mj export-csv run.mcap run.csv --source udp --start 2 --stop 5

A row for every good packet: its time in s since the recording began, then all of its numbers, to
the last digit. With several sources, --source chooses one.
"""
ORDER = 37  # in the help of `sero-mj`


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(commands, "export-csv", run, "write a recording as a table", _EPILOG)
    parser.add_argument("recording", type=Path, metavar="REC.mcap", help="a recording")
    parser.add_argument("output", type=Path, metavar="OUT.csv", help="where to")
    parser.add_argument("--source", metavar="NAME", help="which source (default: the only one)")
    parser.add_argument("--start", type=not_negative, metavar="S", help="from this time on")
    parser.add_argument("--stop", type=not_negative, metavar="S", help="until before this time")
    parser.add_argument("--overwrite", action="store_true", help="write over a file that exists")


def run(options: argparse.Namespace) -> int:
    """Writes; returns 0, or 1 where there are packets and none could be read."""
    from ..data.record.csv_files import export_csv
    from ..data.record.recording import Recording
    from ..data.record.replay import Replay

    if options.output.exists() and not options.overwrite:
        raise UsageError(f"{options.output}: exists already; choose another name, or --overwrite")
    with Recording(options.recording) as recording:
        name = recording.choose_source(options.source or "")
        check_span(recording, options.start, options.stop)
        source = Replay(file=options.recording, source=name)
        source.allow_nan(source.events)  # a table has a place for them
        start = -math.inf if options.start is None else options.start
        written = export_csv(
            recording, name, options.output, source.decode, start=start, stop=options.stop
        )
        for fault in recording.faults:
            print(f"note: {options.recording}: {fault}")
        damaged = bool(recording.faults)
    left_out = f", {written.malformed} malformed packets left out" if written.malformed else ""
    print(f"{options.output}: {written.rows} rows{left_out}")
    return 1 if (damaged or written.malformed) and not written.rows else 0
