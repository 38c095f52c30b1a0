"""Child processes that are ended together with all processes that they have started.

Each child process has its own process group, so that Ctrl+C in the terminal does not reach it.
"""

from __future__ import annotations

import atexit
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from . import reaper
from .reaper import remove

_GRACE = 2.0  # s
_TAIL = 1 << 16  # bytes at the end of the output that are read


class ChildProcess:
    """A child process that is ended when this object is deleted or the parent process ends.

    Its standard error is written to an unnamed temporary file, which cannot block like a full pipe.

    Args:
        grace: time in seconds between SIGTERM and SIGKILL.
        leftovers: files and folders to remove after the process has ended.
        keeps_stdout: whether standard output is written to the temporary file, too.

    Raises:
        OSError: the program cannot be started.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        grace: float = _GRACE,
        leftovers: Sequence[Path] = (),
        keeps_stdout: bool = False,
        **options: Any,
    ) -> None:
        self._output: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (open as long as this)
        if keeps_stdout:
            options["stdout"] = self._output
        if os.name == "posix":
            options["start_new_session"] = True
        elif sys.platform == "win32":
            options["creationflags"] = subprocess.CREATE_NEW_PROCESS_GROUP
        for path in leftovers:
            add_leftover(path)
        # Registered before the start, because an interrupt may occur during the start.
        self.process: subprocess.Popen[bytes] = subprocess.Popen.__new__(subprocess.Popen)
        self._end = weakref.finalize(
            self, _end, self.process, grace, tuple(leftovers), self._output, os.getpid()
        )
        self._end.atexit = False  # see `_at_exit`
        try:
            subprocess.Popen.__init__(self.process, command, stderr=self._output, **options)
            _note(b"+g%d" % self.process.pid)
        except BaseException:
            self._end()
            raise
        _running.add(self)

    @property
    def status(self) -> str:
        """Signal name or exit status of the ended process; empty while the process is running."""
        code = self.process.poll()
        if code is None:
            return ""
        if code < 0:
            with suppress(ValueError):
                return signal.Signals(-code).name
        return f"exit status {code}"

    def lines(self) -> list[str]:
        if self._output.closed:
            return []
        size = os.fstat(self._output.fileno()).st_size
        text = _read(self._output, max(size - _TAIL, 0)).decode(errors="replace")
        return [line.strip() for line in text.splitlines() if line.strip()]

    def end(self) -> None:
        self._end()
        _running.discard(self)


_running: weakref.WeakSet[ChildProcess] = weakref.WeakSet()


def end_all() -> None:
    """Ends all child processes, for example before `os._exit`."""
    for child in list(_running):
        child.end()


def _read(file: IO[bytes], begin: int) -> bytes:
    if hasattr(os, "pread"):  # `seek` would move the write position of the child process
        return os.pread(file.fileno(), _TAIL, begin)
    file.seek(begin)
    return file.read()


def _end(
    process: subprocess.Popen[bytes],
    grace: float,
    leftovers: Sequence[Path],
    output: IO[bytes],
    owner: int,
) -> None:
    if os.getpid() != owner:  # in a forked copy
        return
    pid = getattr(process, "pid", None)
    if pid is not None:
        try:
            _signal(process, signal.SIGTERM)
            deadline = time.monotonic() + grace
            while process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.005)
        finally:
            _signal(process, getattr(signal, "SIGKILL", signal.SIGTERM))  # also its children
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    with suppress(OSError):
                        pipe.close()
            _note(b"-g%d" % pid)
    output.close()
    for path in leftovers:
        remove_leftover(path)


def add_leftover(path: Path) -> None:
    """Registers a file or folder for removal in case this process dies before removing it."""
    _note(b"+p" + os.fsencode(path.absolute()))


def remove_leftover(path: Path) -> None:
    """Removes a file or folder that was registered by `add_leftover`."""
    remove(path)
    _note(b"-p" + os.fsencode(path.absolute()))


def _signal(process: subprocess.Popen[bytes], number: int) -> None:
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)
            return
        if process.returncode is None:  # it is not yet a group leader
            process.send_signal(number)
    elif process.poll() is None:
        if sys.platform == "win32":  # `taskkill /T` also ends the children
            words = ["taskkill", "/F", "/T", "/PID", str(process.pid)]
            subprocess.run(words, check=False, capture_output=True)
        else:
            process.send_signal(number)


# PID of the owner, and the process that cleans up if the owner is killed; see `reaper`.
_reaper: tuple[int, subprocess.Popen[bytes]] | None = None
_reaper_lock = threading.Lock()
_is_exiting = False


def _note(entry: bytes) -> None:
    """Sends an entry to the reaper, and starts the reaper before the first entry."""
    if os.name != "posix" or not sys.executable or _is_exiting:
        return
    global _reaper  # noqa: PLW0603
    with _reaper_lock:
        if _reaper is None or _reaper[0] != os.getpid():
            command = [sys.executable, "-I", "-S", reaper.__file__, str(os.getpid())]
            started = subprocess.Popen(
                command, bufsize=0, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL, cwd="/", start_new_session=True,
            )  # fmt: skip
            _reaper = os.getpid(), started
        pipe = _reaper[1].stdin
        assert pipe is not None
        with suppress(OSError):  # the reaper was killed
            pipe.write(entry + b"\0")


# Registered early, so that it runs after handlers that still use the processes.
@atexit.register
def _at_exit() -> None:
    global _is_exiting  # noqa: PLW0603
    end_all()
    _is_exiting = True
    if _reaper is not None and _reaper[0] == os.getpid():
        _reaper[1].communicate()
