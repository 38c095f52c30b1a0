"""Child processes and all their descendants end, regardless of how this process ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from polling import until

from sero_mj.base import child_process
from sero_mj.base.child_process import ChildProcess, end_all

pytestmark = pytest.mark.skipif(not Path("/proc/self/cwd").exists(), reason="looks into /proc")

# Starts another process, as a shell script does. Both ignore SIGTERM.
STUBBORN = """
import signal, subprocess, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
open("ready", "w").close()
time.sleep(600)
"""
# Starts a child process and does not end it.
PARENT = """
import os, sys, time
from pathlib import Path
from sero_mj.base.child_process import ChildProcess
child = ChildProcess([sys.executable, "-c", open("stubborn.py").read()], grace=0.1,
    leftovers=[Path("left")])
{end}
"""


def running_in(folder: Path) -> list[str]:
    """Returns the commands of the processes whose working directory is `folder`."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if os.readlink(place / "cwd") == str(folder):
                found.append((place / "cmdline").read_bytes().replace(b"\0", b" ").decode())
        except OSError:  # it has ended or belongs to another user
            continue
    return found


def started(folder: Path, **options: Any) -> ChildProcess:
    child = ChildProcess([sys.executable, "-c", STUBBORN], cwd=folder, **options)
    assert until((folder / "ready").exists, 20.0)
    return child


@pytest.mark.parametrize("end", ["end", "end_all", "forgotten"])
def test_child_process_ends_with_its_descendants(end: str, tmp_path: Path) -> None:
    left = tmp_path / "left"
    left.mkdir()
    child: ChildProcess | None = started(tmp_path, grace=0.1, leftovers=[left])
    assert len(running_in(tmp_path)) == 2
    if end == "end":
        child.end()
        assert child.status == "SIGKILL"
    elif end == "end_all":
        end_all()
    child = None
    assert until(lambda: not running_in(tmp_path))
    assert not left.exists()


def test_without_process_groups_only_the_process_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(os, "killpg")
    child = ChildProcess([sys.executable, "-c", "input()"], cwd=tmp_path, stdin=subprocess.PIPE)
    child.end()
    assert child.status == "SIGTERM"
    assert not running_in(tmp_path)


def test_interrupt_while_a_process_starts_ends_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def note(entry: bytes) -> None:
        if entry.startswith(b"+g"):
            raise KeyboardInterrupt

    monkeypatch.setattr(child_process, "_note", note)
    with pytest.raises(KeyboardInterrupt):
        ChildProcess([sys.executable, "-c", "import time; time.sleep(600)"], cwd=tmp_path)
    assert not running_in(tmp_path)


def test_output_is_read_while_it_is_written(tmp_path: Path) -> None:
    code = "import sys; print('x' * 200_000); print('last', flush=True); input(); sys.exit(3)"
    command = [sys.executable, "-c", code]
    child = ChildProcess(command, keeps_stdout=True, stdin=subprocess.PIPE)
    assert until(lambda: child.lines()[-1:] == ["last"])
    assert child.status == ""
    child.process.communicate(b"\n")
    assert child.status == "exit status 3"


@pytest.mark.slow
@pytest.mark.parametrize("end", ["sys.exit()", "time.sleep(600)"])
def test_child_process_ends_with_its_parent(end: str, tmp_path: Path) -> None:
    (tmp_path / "stubborn.py").write_text(STUBBORN)
    (tmp_path / "left").touch()
    wait = 'while not os.path.exists("ready"): time.sleep(0.001)'
    code = PARENT.format(end=f"{wait}\n{end}")
    parent = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path)
    if end.startswith("time"):
        assert until((tmp_path / "ready").exists, 20.0)
        parent.send_signal(signal.SIGKILL)
    parent.wait(20)
    assert until(lambda: not running_in(tmp_path), 10.0)
    assert until(lambda: not (tmp_path / "left").exists())
    assert until(lambda: not reapers_of(parent.pid))


def reapers_of(parent: int) -> list[str]:
    """Returns the processes that end the descendants of `pid`."""
    words = f"reaper.py\0{parent}\0".encode()
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if file.read_bytes().endswith(words):
                found.append(file.parent.name)
        except OSError:
            continue
    return found
