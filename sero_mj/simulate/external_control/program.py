"""`Program`: a user's program, which starts and ends with a run."""

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

PORT = "{port}"  # placeholder for the port in a command
_LINES, _CHARACTERS = 5, 4000  # maximum length of a program's output in errors
# Function of the C library on Linux that returns the current core; None elsewhere.
_current_core: Any = getattr(
    ctypes.CDLL(None) if os.name == "posix" else None, "sched_getcpu", None
)
_random = random.Random()  # independent of the user's seed


class Program:
    """A user's program that runs as a child process. It ends with all of its own children.

    Attributes:
        name: file name of the program.

    Raises:
        DeclarationError: the program cannot be started.
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
        """Whether the program has exited."""
        return self._child.process.poll() is not None

    @property
    def has_failed(self) -> bool:
        """Whether the program has exited with a status other than 0."""
        return bool(self._child.process.poll())

    def why(self) -> str:
        """Returns a message with the program's exit status and its last lines of output."""
        status = self._child.status
        if not status:
            how = "is still running"
        elif status.startswith("exit"):
            how = f"has ended with {status}"
        else:
            how = f"was ended by {status}"
        output = " | ".join(self._child.lines()[-_LINES:])[-_CHARACTERS:]
        return f"{self.name} {how}" + (f"; its last output: {output}" if output else "")

    def end(self) -> None:
        """Ends the program, if it is running."""
        self._child.end()


class SharedCore:
    """Moves a process to the core of the thread that waits for it.

    In lockstep, only one of the two runs at a time, and waking another core is slow. A round trip
    over a pipe takes 50 us on two cores of a virtual machine, and 5 us on one core. Only the main
    thread and the threads that it starts afterwards are moved.
    """

    def __init__(self, process: int) -> None:
        self._process, self._core = process, -1
        self._can = _current_core is not None and hasattr(os, "sched_setaffinity")

    def come(self) -> None:
        """Moves the process to the core of the calling thread."""
        if not self._can or (core := _current_core()) == self._core:
            return
        try:
            os.sched_setaffinity(self._process, {core})
        except OSError:  # the process has ended, or must not be moved
            self._can = False
        self._core = core


def held_port() -> socket.socket:
    """Returns a TCP socket that reserves the number of a free UDP port.

    While it is open, no other run on this machine uses the number. The number is below 32768, where
    the system does not assign ports.
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
    """Returns whether a path is a file, and False for paths that are invalid or unreadable."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, with NUL, or in a folder that cannot be read
        return False


def find_program(command: Sequence[str], folder: Path) -> str:
    """Returns the path of a program.

    Raises:
        DeclarationError: the program does not exist, or cannot be executed.
    """
    name = command[0]
    beside = folder / name
    try:
        found = shutil.which(str(beside.absolute()) if os.sep in name else name)
    except (OSError, ValueError):  # too long for a name, or with NUL
        found = None
    if found is None and os.sep in name and is_file(beside):
        raise Problem("command", f"{beside} is not executable").error()
    if found is None:
        where = f"no file {beside}" if os.sep in name else f"no program {name} in PATH"
        raise Problem("command", where).error()
    return found
