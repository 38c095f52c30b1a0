"""`sero-mj export-csv`: a recording as a table."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from ..base.options import Option, Options, Time, positional
from ._arguments import check_new, check_span, command

_EPILOG = """\
examples:
  sero-mj export-csv run.mcap run.csv
  sero-mj export-csv run.mcap run.csv --source udp --start 2 --stop 5

A row for every good packet: its time in s since the recording began, then all of its numbers, to
the last digit. With several sources, --source chooses one.
"""
ORDER = 37  # in the help of `sero-mj`


class ExportCsvOptions(Options):
    """Write a recording as a table.

    Attributes:
        recording: a recording.
        output: where to.
        source: which source (default: the only one).
        start: from this time on, s.
        stop: until before this time, s.
        overwrite: write over a file that exists.
    """

    recording: Annotated[Path, positional("REC.mcap")]
    output: Annotated[Path, positional("OUT.csv")]
    source: Annotated[str | None, Option("NAME")] = None
    start: Time | None = None
    stop: Time | None = None
    overwrite: bool = False


def run(options: ExportCsvOptions) -> int:
    """Writes; returns 0, or 1 if there are packets and none could be decoded."""
    from ..data.record.bag import open_recording
    from ..data.record.csv_files import export_csv
    from ..data.record.replay import Replay

    if not options.overwrite:
        check_new([options.output], "choose another name, or --overwrite")
    with open_recording(options.recording) as recording:
        name = recording.choose_source(options.source or "", by="--source NAME")
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


add_to = command("export-csv", run, ExportCsvOptions, _EPILOG)
