"""`Program`: a program of the user's, which is started with a run and ends with it."""

from __future__ import annotations

import ctypes
import os
import random
import shutil
import socket
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...base.child_process import ChildProcess
from ...base.errors import Problem

PORT = "{port}"  # in a command: what is put there
_LINES, _CHARACTERS = 5, 4000  # of its output, in errors
# Of the C library on Linux; None elsewhere.
_current_core: Any = getattr(
    ctypes.CDLL(None) if os.name == "posix" else None, "sched_getcpu", None
)
_random = random.Random()  # of its own: a seed of the user's neither sets nor is changed by ports


class Program:
    """A running program of the user's, which ends together with all that it has started.

    Attributes:
        name: of its file.

    Raises:
        DeclarationError: it cannot be started.
    """

    def __init__(
        self,
        command: Sequence[str],
        folder: Path,
        environment: Mapping[str, str] | None = None,
        leftovers: Sequence[Path] = (),
    ) -> None:
        self.name = Path(command[0]).name
        found = find_program(command, folder)
        try:
            self._child = ChildProcess(
                [found, *command[1:]],
                cwd=folder,
                env={**os.environ, **(environment or {})},
                stdin=subprocess.DEVNULL,
                keeps_stdout=True,
                leftovers=leftovers,
            )
        except OSError as error:
            problem = Problem("command", f"{command[0]} cannot be started: {error.strerror}")
            raise problem.error() from None
        self._core = SharedCore(self._child.process.pid)

    def come_beside(self) -> None:
        self._core.come()

    @property
    def has_ended(self) -> bool:
        """Whether it has ended by itself."""
        return self._child.process.poll() is not None

    @property
    def has_failed(self) -> bool:
        """Whether it has ended by itself, and not with exit status 0."""
        return bool(self._child.process.poll())

    def why(self) -> str:
        """How it has ended, and its last lines."""
        status = self._child.status
        if not status:
            how = "goes on"
        elif status.startswith("exit"):
            how = f"has ended with {status}"
        else:
            how = f"was ended by {status}"
        said = " | ".join(self._child.lines()[-_LINES:])[-_CHARACTERS:]
        return f"{self.name} {how}" + (f"; its last lines: {said}" if said else "")

    def end(self) -> None:
        """Ends it; harmless when it has ended."""
        self._child.end()


class SharedCore:
    """Has a process run on the core of the thread that waits for it.

    Of two in lockstep only one runs at a time, and to wake another core takes long: a round trip
    over a pipe took 50 us on a virtual machine of two cores, and 5 us on one of them. Only the main
    thread of the process is moved, and those that it starts later.
    """

    def __init__(self, process: int) -> None:
        self._process, self._core = process, -1
        self._can = _current_core is not None and hasattr(os, "sched_setaffinity")

    def come(self) -> None:
        """Moves the process to the core of the calling thread, unless it is there."""
        if not self._can or (core := _current_core()) == self._core:
            return
        try:
            os.sched_setaffinity(self._process, {core})
        except OSError:  # it has ended, or is not to be moved
            self._can = False
        self._core = core


def held_port() -> socket.socket:
    """A TCP socket at the number of a UDP port that nobody has.

    While it is open, no other run on this machine gives the number to its program, which may take
    a while to bind it. The system hands out other numbers, from 32768 on.
    """
    while True:
        held = socket.socket()
        with socket.socket(type=socket.SOCK_DGRAM) as found:
            address = "127.0.0.1", _random.randrange(20000, 30000)
            try:
                held.bind(address)
                found.bind(address)
            except OSError:
                held.close()
            else:
                return held


def is_file(path: Path) -> bool:
    """Whether there is a file of any name, also of one that no file can have."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, with NUL, or in a folder that cannot be read
        return False


def find_program(command: Sequence[str], folder: Path) -> str:
    """The path of a program.

    Raises:
        DeclarationError: there is none, or it cannot be executed.
    """
    name = command[0]
    beside = folder / name
    try:
        found = shutil.which(str(beside.absolute()) if os.sep in name else name)
    except (OSError, ValueError):  # too long for a name, or with NUL
        found = None
    if found is None and os.sep in name and is_file(beside):
        raise Problem("command", f"{beside} cannot be executed").error()
    if found is None:
        where = f"no file {beside}" if os.sep in name else f"no program {name} in the PATH"
        raise Problem("command", where).error()
    return found
