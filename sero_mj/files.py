"""Opens files that somebody else has named: never waits for a pipe, never reads without end."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)
_MB = 1_000_000


def open_file(path: Path | str, most: int | None = None) -> BinaryIO:
    """Opens a file to be read.

    Args:
        path: of the file.
        most: bytes that it may have.

    Raises:
        OSError: it cannot be opened, is no regular file (a pipe would keep its reader waiting, a
            device may have no end), or is longer; `strerror` says so.
        ValueError: no file can have this name.
    """
    # Without O_NONBLOCK a pipe keeps even its opener waiting.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    file = os.open(path, flags)
    try:
        status = os.fstat(file)
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(status.st_mode):
            what = next((name for is_it, name in _KINDS if is_it(status.st_mode)), "something else")
            raise OSError(errno.EINVAL, f"is {what}; expected a file", str(path))
        if most is not None and status.st_size > most:
            found = f"has {status.st_size / _MB:.1f} MB; expected at most {most / _MB:g} MB"
            raise OSError(errno.EFBIG, found, str(path))
        return os.fdopen(file, "rb")
    except BaseException:
        os.close(file)
        raise


def read_file(path: Path | str, most: int) -> bytes:
    """Returns what is in a file of at most so many bytes; raises as `open_file` does."""
    with open_file(path, most) as file:
        return file.read(most)
