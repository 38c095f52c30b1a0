"""Tables of comma-separated values that are there when all of them is there."""

from __future__ import annotations

import contextlib
import csv
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import CsvError, SeroError

if TYPE_CHECKING:
    from _csv import Writer


@contextlib.contextmanager
def csv_table(path: Path | str, failed: str = "cannot be written") -> Iterator[Writer]:
    """Gives a writer of rows; a file of this name is replaced when all of them are written.

    Until then they are in a file beside it, which goes when something fails. What is no file, a
    pipe say, is written to as it is.

    Args:
        path: the table.
        failed: what is said when it fails, in front of the reason.

    Raises:
        CsvError: the file cannot be written.
    """
    path = Path(path)
    is_file = path.is_file() or not path.exists()
    whole = path.resolve() if is_file else path  # what a link leads to, not the link
    partial = whole.with_name(f"{whole.name}.part") if is_file else whole
    try:
        with open(partial, "w", newline="", encoding="utf-8") as file:
            yield csv.writer(file, lineterminator="\n")
        if is_file:
            os.replace(partial, whole)
    except BaseException as error:
        if is_file:
            with contextlib.suppress(OSError):  # it may be its folder that is not there
                partial.unlink()
        # Some of this package's own errors are OSErrors as well: of where the rows come from.
        if isinstance(error, OSError) and not isinstance(error, SeroError):
            raise CsvError(path, f"{failed}: {error.strerror}") from error
        raise
