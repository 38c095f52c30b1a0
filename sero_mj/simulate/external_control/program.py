"""`Program`: a program of the user's, which is started with a run and ends with it."""

from __future__ import annotations

import ctypes
import os
import random
import shutil
import signal
import socket
import subprocess
import tempfile
import time
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from ...base.errors import Problem

PORT = "{port}"  # in a command: what is put there
_LINES, _BYTES = 5, 4000  # of its output, in errors
_GRACE = 2.0  # s between the request to end and the end
_IS_POSIX = os.name == "posix"
# Of the C library on Linux; None elsewhere.
_current_core: Any = getattr(ctypes.CDLL(None) if _IS_POSIX else None, "sched_getcpu", None)


class Program:
    """A running program, in a session of its own: with it end those that it has started.

    What it prints goes to a file, which cannot fill up as a pipe would.

    Args:
        command: its name or path, and its arguments.
        folder: where it runs.
        environment: what is set over that of this process.

    Attributes:
        name: of its file.
        output: the file with what it has printed.

    Raises:
        DeclarationError: it cannot be started.
    """

    def __init__(
        self, command: Sequence[str], folder: Path, environment: Mapping[str, str] | None = None
    ) -> None:
        self.name = Path(command[0]).name
        handle, path = tempfile.mkstemp(prefix="sero-mj-program-", suffix=".log")
        self.output = Path(path)
        with os.fdopen(handle, "wb") as output:
            self._process = _started(command, folder, output, environment or {})
        self._core = SharedCore(self._process.pid)
        self._end = weakref.finalize(self, _end, self._process, self.output)

    def come_beside(self) -> None:
        """See `SharedCore.come`."""
        self._core.come()

    @property
    def has_ended(self) -> bool:
        """Whether it has ended by itself."""
        return self._process.poll() is not None

    @property
    def has_failed(self) -> bool:
        """Whether it has ended by itself, and not with exit status 0."""
        return bool(self._process.poll())

    def why(self) -> str:
        """How it has ended, and its last lines."""
        code = self._process.poll()
        if code is None:
            how = "goes on"
        elif code < 0:
            how = f"was ended by {signal.Signals(-code).name}"
        else:
            how = f"has ended with exit status {code}"
        lines = self.output.read_bytes()[-_BYTES:].decode(errors="replace").strip().splitlines()
        said = " | ".join(lines[-_LINES:])
        return f"{self.name} {how}" + (f"; its last lines: {said}" if said else "")

    def end(self) -> None:
        """Ends it; harmless when it has ended."""
        self._end()


class SharedCore:
    """Has a process run on the core of the thread that waits for it.

    Of two in lockstep only one runs at a time, and to wake another core takes long: a round trip
    over a pipe took 50 us on a virtual machine of two cores, and 5 us on one of them. Only the main
    thread of the process is moved, and those that it starts later.

    Args:
        process: its id.
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
            address = "127.0.0.1", random.randrange(20000, 30000)
            try:
                held.bind(address)
                found.bind(address)
            except OSError:
                held.close()
            else:
                return held


def find_program(command: Sequence[str], folder: Path) -> str:
    """The path of a program.

    Args:
        command: its name, or its path in the folder.
        folder: where it is to run.

    Raises:
        DeclarationError: there is none, or it cannot be executed.
    """
    name = command[0]
    beside = folder / name
    found = shutil.which(str(beside.absolute()) if os.sep in name else name)
    if found is None and os.sep in name and beside.is_file():
        raise Problem("command", f"{beside} cannot be executed").error()
    if found is None:
        where = f"no file {beside}" if os.sep in name else f"no program {name} in the PATH"
        raise Problem("command", where).error()
    return found


def _started(
    command: Sequence[str], folder: Path, output: IO[bytes], environment: Mapping[str, str]
) -> subprocess.Popen[bytes]:
    name, found = command[0], find_program(command, folder)
    try:
        return subprocess.Popen(
            [found, *command[1:]],
            cwd=folder,
            env={**os.environ, **environment},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=_IS_POSIX,
        )
    except OSError as error:
        raise Problem("command", f"{name} cannot be started: {error.strerror}").error() from None


def _end(process: subprocess.Popen[bytes], output: Path) -> None:
    """Ends a program with all that it has started, and removes its output."""
    _signal(process, signal.SIGTERM)
    deadline = time.monotonic() + _GRACE
    while process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    _signal(process, getattr(signal, "SIGKILL", signal.SIGTERM))  # also those it left behind
    process.wait()
    output.unlink(missing_ok=True)


def _signal(process: subprocess.Popen[bytes], number: int) -> None:
    try:
        if _IS_POSIX:
            os.killpg(process.pid, number)
        elif process.poll() is None:
            process.send_signal(number)
    except (ProcessLookupError, PermissionError):
        pass
