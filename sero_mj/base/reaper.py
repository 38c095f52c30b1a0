"""A script that ends process groups and removes files after its parent process has died.

A process that crashes, or is killed by `kill -9`, cannot clean up itself. The script reads process
groups and files from its standard input. It starts quickly because it imports nothing of sero-mj.
"""

from __future__ import annotations

import os
import select
import shutil
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

_GRACE = 5.0  # s between SIGTERM and SIGKILL
_EVERY = 1.0  # s between checks of the parent, because a forked copy of it leaves the input open


def main(parent: int) -> None:
    """Reads entries until the parent process has died, then ends its groups and removes its files.

    Each entry ends with a NUL byte. `+g` and a number add a process group, `+p` and a path add a
    file or folder, `-g` and `-p` remove an entry.
    """
    entries: set[bytes] = set()
    rest = b""
    while True:
        if not select.select([0], [], [], _EVERY)[0]:
            if os.getppid() != parent:
                break
            continue
        data = os.read(0, 1 << 16)
        if not data:
            break
        *words, rest = (rest + data).split(b"\0")
        for word in words:
            (entries.add if word[:1] == b"+" else entries.discard)(word[1:])
    _end_groups({int(entry[1:]) for entry in entries if entry[:1] == b"g"})
    for entry in entries:
        if entry[:1] == b"p":
            remove(Path(os.fsdecode(entry[1:])))


def _end_groups(groups: set[int]) -> None:
    left = {group for group in groups if _is_signaled(group, signal.SIGTERM)}
    deadline = time.monotonic() + _GRACE
    while left and time.monotonic() < deadline:
        time.sleep(0.01)
        left = {group for group in left if _is_signaled(group, 0)}
    for group in left:
        _is_signaled(group, signal.SIGKILL)


def _is_signaled(group: int, number: int) -> bool:
    try:
        os.killpg(group, number)
    except (ProcessLookupError, PermissionError):
        return False
    return True


def remove(path: Path) -> None:
    """Removes a file or a folder, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
