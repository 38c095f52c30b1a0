"""Terminated commands leave no program, library or unit running, and no file behind."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from fmu_tools import write_fmu
from polling import until
from test_child_process import running_in
from web_tools import ARGUMENTS, CHROMIUM

from sero_mj.base.child_process import ChildProcess
from sero_mj.simulate.external_control.library import HEADER

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/cwd").exists(), reason="looks into /proc"),
]

SCENARIO = """
[robots.lwr]
model = "lwr"
joint_angles = [0, 0.6, 0, -1.2, 0, 1.2, 0]
[controllers.lwr]
{controller}
[run]
duration = 100
[expect.stays]
measure = "position_error"
below = 0.5
[targets.lwr]
kind = "sine"
amplitude_deg = 1
frequency = 0.1
"""
# Holds the robot, with a child process that must be killed.
PEER = """
import os, signal, socket, struct, subprocess, sys
peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
peer.bind(("127.0.0.1", int(sys.argv[1])))
ignored = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)"
subprocess.Popen([sys.executable, "-c", ignored])
open("started", "a").write("program\\n")
print("what it prints goes to a file", flush=True)
while True:
    packet, robot = peer.recvfrom(4096)
    peer.sendto(packet[:4] + bytes(4) + packet[-56:], robot)  # step, and torques that hold it
"""
UNIT = 'kind = "fmu"\nfile = "impedance2.fmu"'
PROGRAM = f'kind = "udp"\ncommand = ["{sys.executable}", "peer.py", "{{port}}"]'
LIBRARY = 'kind = "library"\nfile = "law.so"\nisolated = true'
LAW = """
#include <stdio.h>
#include <unistd.h>
#include "sero_mj_controller.h"
void control(struct sero_mj_robot *r) {
  if (r->is_first) {
    FILE *file = fopen("started", "a");
    fprintf(file, "library\\n");
    fclose(file);
    if (!fork()) { sleep(600); _exit(0); }
  }
  for (int i = 0; i < r->n; i++) r->torques_out[i] = r->gravity[i];
}
"""


class Command:
    """A command that runs in a folder, with its temporary files below it."""

    def __init__(self, folder: Path, controller: str, words: list[str]) -> None:
        self.folder, self.temporary = folder, folder / "temporary"
        self.temporary.mkdir()
        (folder / "peer.py").write_text(PEER)
        (folder / "scenario.toml").write_text(SCENARIO.format(controller=controller))
        if controller == LIBRARY:
            if shutil.which("cc") is None:
                pytest.skip("needs a C compiler")
            (folder / "law.c").write_text(LAW)
            compiled = ["cc", "-shared", "-fPIC", "-I", str(HEADER.parent), "law.c", "-o", "law.so"]
            subprocess.run(compiled, cwd=folder, check=True)
        if controller == UNIT:
            write_fmu(folder, 2)
        self.shared: list[str] = []  # files shared with libraries
        self.out = folder / "out.txt"
        with self.out.open("wb") as out:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "sero_mj", *words],
                cwd=folder, stdout=out, stderr=subprocess.STDOUT,
                env={**os.environ, "TMPDIR": str(self.temporary)}, start_new_session=True,
                # The signal may be ignored here, for example in the background of a shell.
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
            )  # fmt: skip

    @property
    def started(self) -> int:
        """The number of programs, libraries or units that have started."""
        if units := len([*self.temporary.glob("sero-mj-fmu-*")]):
            return units
        file = self.folder / "started"
        return len(file.read_text().splitlines()) if file.exists() else 0

    def wait(self, condition: Callable[[], object]) -> None:
        """Waits for a condition; fails with the output of a command that ends earlier."""
        assert until(lambda: condition() or self.process.poll() is not None, 60.0)
        assert self.process.poll() is None, self.out.read_text()

    def end(self, sent: signal.Signals, *, group: bool = False) -> int:
        """Sends a signal, to the process group like a terminal, and returns the exit status."""
        self.shared = re.findall(r"\S*/sero-mj-library-\S+", " ".join(running_in(self.folder)))
        (os.killpg if group else os.kill)(self.process.pid, sent)
        return self.process.wait(30)

    def check_nothing_is_left(self, seconds: float = 10.0) -> None:
        """Fails if one of its processes or files remains after a number of seconds."""
        assert until(lambda: not running_in(self.folder), seconds), running_in(self.folder)
        assert until(lambda: not [*self.temporary.iterdir()], seconds), [*self.temporary.iterdir()]
        assert until(lambda: not any(Path(each).exists() for each in self.shared), seconds)


@pytest.mark.parametrize(
    ("controller", "sent"),
    [(PROGRAM, signal.SIGINT), (LIBRARY, signal.SIGTERM), (PROGRAM, signal.SIGKILL)],
)
def test_simulate_ends_the_programs_it_has_started(
    tmp_path: Path, controller: str, sent: signal.Signals
) -> None:
    command = Command(tmp_path, controller, ["simulate", "scenario.toml"])
    command.wait(lambda: command.started)
    status = command.end(sent, group=sent == signal.SIGINT)
    assert status == (-9 if sent == signal.SIGKILL else 130)
    command.check_nothing_is_left()


SWEEP = ["--vary", "run.seed=0,1,2,3,4,5,6,7", "--jobs", "2", "-o", "out.csv"]


@pytest.mark.parametrize(
    ("controller", "sent"),
    [
        (PROGRAM, signal.SIGINT),
        pytest.param(LIBRARY, signal.SIGKILL, marks=pytest.mark.thorough),
        pytest.param(UNIT, signal.SIGINT, marks=pytest.mark.thorough),
    ],
)
def test_sweep_starts_one_program_per_worker_and_ends_it(
    tmp_path: Path, controller: str, sent: signal.Signals
) -> None:
    command = Command(tmp_path, controller, ["sweep", "scenario.toml", *SWEEP])
    command.wait(lambda: command.started >= 2)
    assert not until(lambda: command.started > 2, 0.3)
    status = command.end(sent, group=sent == signal.SIGINT)
    assert status == (-9 if sent == signal.SIGKILL else 130)
    command.check_nothing_is_left()


@pytest.mark.live
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.parametrize(
    ("controller", "sent"),
    [(PROGRAM, signal.SIGTERM), pytest.param(LIBRARY, signal.SIGINT, marks=pytest.mark.thorough)],
)
def test_page_ends_the_programs_it_has_started(
    tmp_path: Path, controller: str, sent: signal.Signals
) -> None:
    command = Command(tmp_path, controller, ["view", "scenario.toml", "--web", "--fresh"])
    address = re.compile(r"http://\S+")
    command.wait(lambda: address.search(command.out.read_text()))
    url = address.search(command.out.read_text())
    assert url is not None and CHROMIUM is not None
    profile = tmp_path.with_name(f"{tmp_path.name}-profile")
    browser = ChildProcess(
        [CHROMIUM, "--headless", *ARGUMENTS, f"--user-data-dir={profile}", url[0]], cwd="/"
    )
    try:
        command.wait(lambda: command.started)
        command.end(sent, group=sent == signal.SIGINT)
        command.check_nothing_is_left()
    finally:
        browser.end()
