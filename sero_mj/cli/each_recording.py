"""Examines many recordings on the engine that `--engine` selects, and prints a row for each."""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.errors import ClusterError
from .arguments import pace, print_json, print_table, progress_bar, writing
from .shared_options import EngineOptions, JsonOptions

if TYPE_CHECKING:
    from rich.table import Table

_MISSING = "no such file"
Rows = list[tuple[Path, dict[str, Any]]]  # recordings and their results by column


def examine_each(
    options: EngineOptions,
    study: str,
    recordings: Sequence[Path],
    needed: Sequence[Path] = (),
    *,
    quiet: bool = False,
) -> Rows:
    """Examines recordings in parallel; returns their results in order, or fewer if interrupted.

    `study` is the `module:name` of a function that takes the options as plain values and the path
    of a recording, and returns results by column. `needed` lists other files that the study reads.
    """
    from ..study.engine import EachRecording, Work

    shared = options.model_dump(mode="json", exclude_unset=True)
    missing = {k: _MISSING for k, path in enumerate(recordings) if not path.exists()}
    tasks = [(k, {"file": str(path.absolute())}) for k, path in enumerate(recordings)
             if k not in missing]  # fmt: skip
    job = EachRecording(study, _with_whole_paths(shared, needed), needed)
    engine, begin = options.make_engine(), time.perf_counter()
    found: dict[int, dict[str, Any]] = {k: {"error": text} for k, text in missing.items()}

    def note() -> str:
        return pace(len(found), begin, engine.workers)

    with (
        progress_bar("recordings", quiet=quiet, note=note) as update,
        closing(engine.run(Work(job, tasks))) as results,
        _stopped(found, len(recordings)),
    ):
        update(len(found), len(recordings))
        for number, result in results:
            path = recordings[number]
            error = result["error"].replace(str(path.absolute()), str(path))
            found[number] = {**result, "error": error}
            update(len(found), len(recordings))
    return [(path, found[k]) for k, path in enumerate(recordings) if k in found]


def _with_whole_paths(shared: Mapping[str, Any], needed: Sequence[Path]) -> dict[str, Any]:
    whole = {path.absolute() for path in needed}
    return {
        key: str(Path(value).absolute())
        if isinstance(value, str) and Path(value).absolute() in whole
        else value
        for key, value in shared.items()
    }


@contextmanager
def _stopped(found: Mapping[int, Any], count: int) -> Iterator[None]:
    try:
        yield
    except (KeyboardInterrupt, ClusterError) as error:
        if isinstance(error, ClusterError):
            if not found:
                raise
            print(f"sero-mj: {error}", file=sys.stderr)
        print(f"sero-mj: stopped after {len(found)} of {count} recordings", file=sys.stderr)


def report_rows(
    rows: Rows,
    count: int,
    options: JsonOptions,
    to: Path | None,
    table_of: Callable[[], Table],
    *,
    quiet: bool,
) -> int:
    """Writes rows to the file `to`, and prints the table and the errors.

    Returns the exit status: 130 if there are fewer than `count` rows because of an interruption,
    2 if a recording failed, otherwise 0.
    """
    if to is not None:
        write_rows(rows, to)
    if options.as_json:
        print_json([{"recording": str(path), **row} for path, row in rows])
    elif not quiet:
        print_table(table_of())
    errors = [(path, row["error"]) for path, row in rows if row["error"]]
    for path, error in errors:
        print(f"sero-mj: {error if str(path) in error else f'{path}: {error}'}", file=sys.stderr)
    if len(rows) < count:
        return 130
    return 2 if errors else 0


def write_rows(rows: Rows, path: Path) -> None:
    """Writes a table with one row per recording; raises UsageError if it cannot be written."""
    outcomes = dict.fromkeys(key for _, row in rows for key in row if key != "error")
    with writing(), path.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, ["recording", *outcomes, "error"], restval="")
        table.writeheader()
        table.writerows({"recording": name, **row} for name, row in rows)
