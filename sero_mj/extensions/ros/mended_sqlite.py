"""Databases of bags that were not closed: their last messages are in a log beside them.

rosbags opens a database as one that nobody writes on, and so without its log.
"""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from functools import lru_cache
from pathlib import Path

from ...base.paths import make_temporary_folder

_LOGS = ("-wal", "-journal")  # behind the name of the database
_REMEMBERED = 8  # files; each is opened several times until it is shown


def log_of(file: Path) -> Path | None:
    """The log of a database that has something which the database itself lacks; None for none."""
    for log in (file.with_name(f"{file.name}{ending}") for ending in _LOGS):
        if log.is_file() and log.stat().st_size:
            return log
    return None


def with_log(file: Path, log: Path) -> Path:
    """Returns a copy of a database with what is in its log; it ends with this process.

    Raises:
        OSError: it cannot be read, or there is no room for the copy.
        sqlite3.Error: it is damaged.
    """
    states = [each.stat() for each in (file, log)]
    changed = tuple((each.st_size, each.st_mtime_ns) for each in states)
    return _copied(file.resolve(), log.resolve(), changed)


@lru_cache(_REMEMBERED)
def _copied(file: Path, log: Path, changed: tuple[tuple[int, int], ...]) -> Path:
    folder = make_temporary_folder()
    for each in (file, log):
        shutil.copyfile(each, folder / each.name)
    with closing(sqlite3.connect(folder / file.name)) as database:
        database.execute("PRAGMA journal_mode = DELETE").fetchall()  # SQLite takes its log first
    return folder / file.name
