"""Controllers in libraries and programs: equal logs, and handling of their errors."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import textwrap
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from polling import until
from test_cli import run

from sero_mj import SerialRobot
from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.cli.new import snippets
from sero_mj.data.drive.mirror import Mirror
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.control.controller import Sensed, Target
from sero_mj.simulate.control.robot_model import RobotModel
from sero_mj.simulate.external_control.exchange import State, modulus_of
from sero_mj.simulate.external_control.library import HEADER
from sero_mj.simulate.external_control.program import held_port
from sero_mj.simulate.runs.run_source import RunSource
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulated_scene import simulated_scene
from sero_mj.simulate.simulation import Simulation
from sero_mj.viewer.session.clock import Clock

SCENARIO = """
[robots.lwr]
model = "lwr"
joint_angles = [0, 0.6, 0, -1.2, 0, 1.2, 0]
[controllers.lwr]
{controller}
[targets.lwr]
kind = "sine"
amplitude_deg = 5
frequency = 0.5
[run]
duration = {duration}
"""
LIBRARY = 'kind = "library"\nfile = "law.so"'
PROGRAM = 'kind = "udp"\ncommand = ["{python}", "peer.py", "{{port}}", "{mode}"]'
LAW = """
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>
#include "sero_mj_controller.h"
void control(struct sero_mj_robot *r) {
  for (int i = 0; i < r->n; i++)
    r->torques_out[i] = 800.0 * (r->target_angles[i] - r->angles[i]) +
      40.0 * (r->target_velocities[i] - r->velocities[i]) + r->gravity[i];
}
void crash(struct sero_mj_robot *r) { if (r->time > 0.05) *(volatile int *)0 = 1; control(r); }
void hang(struct sero_mj_robot *r) { if (r->time > 0.05) for (;;); control(r); }
static void all(struct sero_mj_robot *r, double x) {
  for (int i = 0; i < r->n; i++) r->torques_out[i] = x;
}
void first(struct sero_mj_robot *r) { all(r, r->is_first); }
void without(struct sero_mj_robot *r) { all(r, !r->gravity); }
void eight(struct sero_mj_robot *r) { r->torques_out[7] = 0.0; control(r); }
void forks(struct sero_mj_robot *r) {
  pid_t child = r->is_first ? fork() : 1;
  if (child == 0) { sleep(600); _exit(0); }
  if (r->is_first) { FILE *file = fopen("forked", "w"); fprintf(file, "%d", child); fclose(file); }
  control(r);
}
void forks_and_exits(struct sero_mj_robot *r) { forks(r); exit(0); }
"""
# A correct program except for the errors of its mode. The control law is that of the library.
PEER = """
import os, socket, subprocess, sys, time
import numpy as np
n, mode = 7, sys.argv[2]
names = ("angles", "velocities", "torques", "target_angles", "target_velocities", "gravity")
head = [("step", "<u4"), ("flags", "<u4"), ("time", "<f8")]
state = np.dtype(head + [(name, "<f8", n) for name in names])
answer = np.dtype([("step", "<u4"), ("unused", "<u4"), ("torques", "<f8", n)])
peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
if mode == "late start":
    time.sleep(0.3)
peer.bind(("127.0.0.1", int(sys.argv[1])))
if mode == "forks":
    child = subprocess.Popen(["sleep", "1000"])
    open("child", "w").write(str(child.pid))
open("pid", "w").write(str(os.getpid()))
while True:
    packet, robot = peer.recvfrom(4096)
    said = np.frombuffer(packet, state)[0]
    k, back = int(said["step"]), np.zeros(1, answer)
    back["step"] = k
    back["torques"] = (800.0 * (said["target_angles"] - said["angles"])
        + 40.0 * (said["target_velocities"] - said["velocities"]) + said["gravity"])
    if mode == "never":
        continue
    if k >= 50:
        if mode == "dies":
            print("a line before", "the joint is too hot", sep=chr(10), flush=True)
            sys.exit(3)
        if mode == "crashes":
            os.abort()
        if mode in ("silent", "silent for a while") and (mode == "silent" or k < 60):
            continue
        if mode == "nan":
            back["torques"][0, 2] = np.nan
        if mode == "wrong size":
            peer.sendto(b"short", robot)
            peer.sendto(bytes(500), robot)
        if mode == "other steps":
            for other in (k - 3, k + 5):
                back["step"] = other
                peer.sendto(back, robot)
            back["step"] = k
        if mode == "twice":
            peer.sendto(back, robot)
        if mode == "megabytes":
            print("x" * 100_000, flush=True)
    peer.sendto(back, robot)
"""

# The same program over shared memory.
MEMORY = (
    PEER[: PEER.index("peer = socket")]
    + """
import mmap
file = open(sys.argv[1], "r+b")
memory = mmap.mmap(file.fileno(), 0)
turn, done = os.open(sys.argv[3], os.O_RDONLY), os.open(sys.argv[4], os.O_WRONLY)
at = -(-state.itemsize // 64) * 64
open("pid", "w").write(str(os.getpid()))
while os.read(turn, 1):
    said = np.frombuffer(memory, state, 1)[0]
    k, back = int(said["step"]), np.frombuffer(memory, answer, 1, at)
    if mode == "never":
        continue
    if mode == "late once" and k == 50:
        time.sleep(0.3)
    if mode == "dies" and k >= 50:
        print("the joint is too hot", flush=True)
        sys.exit(3)
    back["step"] = k + (mode == "other steps")
    back["torques"] = (800.0 * (said["target_angles"] - said["angles"])
        + 40.0 * (said["target_velocities"] - said["velocities"]) + said["gravity"])
    os.write(done, b"1")
"""
)
BY_MEMORY = (
    'kind = "shm"\n'
    'command = ["{python}", "memory.py", "{{memory}}", "{mode}", "{{turn}}", "{{done}}"]'
)


class Law:
    """The same control law in Python."""

    def __init__(self, model: Any) -> None:
        self.model = model

    def torques(self, sensed: Sensed, target: Target, out: np.ndarray) -> None:
        self.model.update(sensed.motor_angles, sensed.motor_velocities)
        out[:] = (
            800.0 * (target.angles - sensed.angles)
            + 40.0 * (target.velocities - sensed.velocities)
            + self.model.gravity()
        )


def compiled(folder: Path, text: str, name: str = "law.so") -> None:
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    (folder / "law.c").write_text(text)
    shared = ["-O2", "-shared", "-fPIC", "-ffp-contract=off", "-I", str(HEADER.parent)]
    subprocess.run(["cc", *shared, "law.c", "-o", name], cwd=folder, check=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("external")
    compiled(found, LAW)
    (found / "peer.py").write_text(PEER)
    (found / "memory.py").write_text(MEMORY)
    return found


def simulation(folder: Path, controller: str, duration: float = 0.1, **settings: Any) -> Simulation:
    file = folder / "scenario.toml"
    file.write_text(SCENARIO.format(controller=controller, duration=duration))
    over = {f"controllers.lwr.{key}": value for key, value in settings.items()}
    return Simulation(read_scenario(file, over))


def program(mode: str) -> str:
    return PROGRAM.format(python=sys.executable, mode=mode)


def by_memory(mode: str) -> str:
    return BY_MEMORY.format(python=sys.executable, mode=mode)


def signals(simulated: Simulation) -> dict[str, np.ndarray]:
    for _ in simulated.run():
        pass
    own = ("lwr_command_age", "lwr_step_lateness")
    return {key: value for key, value in simulated.log.signals.items() if key not in own}


def test_logs_are_equal_for_a_control_law_in_python_library_and_program(folder: Path) -> None:
    by_library = signals(simulation(folder, LIBRARY))
    for other in (
        simulation(folder, LIBRARY, isolated=True),
        simulation(folder, program("right")),
        simulation(folder, program("right")),
        simulation(folder, by_memory("right")),
    ):
        found = signals(other)
        assert found.keys() == by_library.keys()
        for key, values in found.items():
            assert np.array_equal(values, by_library[key]), key
    declared = simulation(folder, LIBRARY)
    robot = declared.controlled[0]
    declared.scenario.controllers["lwr"] = Law(declared.robot_model(robot.robot))
    in_python = signals(Simulation(declared.scenario))
    for key, values in in_python.items():
        assert values == pytest.approx(by_library[key], abs=1e-9), key


def test_library_gets_the_first_step_and_the_gravity_flag(folder: Path) -> None:
    first = signals(simulation(folder, LIBRARY, duration=0.01, function="first"))
    assert first["lwr_commanded_torques"][1].tolist() == [1.0] * 7
    assert first["lwr_commanded_torques"][2].tolist() == [0.0] * 7
    for isolated in (False, True):
        settings = {"function": "without", "gravity": False, "isolated": isolated}
        found = signals(simulation(folder, LIBRARY, duration=0.01, **settings))
        assert found["lwr_commanded_torques"][1].tolist() == [1.0] * 7


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        ("crash", r"law.so: crash ended its process: SIGSEGV"),
        ("hang", "hang did not return within 0.5 s"),
    ],
)
def test_errors_of_an_isolated_library_are_reported(
    folder: Path, function: str, expected: str
) -> None:
    settings = {"function": function, "isolated": True, "patience": 0.5}
    with pytest.raises(SimulationError, match=rf"lwr at 0.051\d* s: .*{expected}"):
        signals(simulation(folder, LIBRARY, **settings))


@pytest.mark.parametrize(
    ("constructor", "expected"),
    [
        ("*(volatile int *)0 = 1", "SIGSEGV; Fatal Python error: Segmentation fault"),
        ("exit(0)", "exit status 0; constructor"),
        ("for (;;) pause()", "is not loaded within 0.5 s"),
        ("", "SIGBUS; Fatal Python error: Bus error"),  # the file is corrupted
    ],
)
def test_constructor_of_a_library_ends_only_its_own_process(
    tmp_path: Path, constructor: str, expected: str
) -> None:
    begin = 'fprintf(stderr, "constructor in %d\\n", getpid());'
    boot = f"static void __attribute__((constructor)) boot(void) {{ {begin} {constructor}; }}"
    compiled(tmp_path, f"{LAW}\n{boot}")
    if not constructor:
        library = tmp_path / "law.so"
        library.write_bytes(library.read_bytes()[: library.stat().st_size // 2])
    settings = {"isolated": True, "first_patience": 10.0 if "pause" not in constructor else 0.5}
    with pytest.raises(DeclarationError) as caught:
        simulation(tmp_path, LIBRARY, **settings)
    (problem,) = caught.value.problems
    assert problem.key == "controllers.lwr.file"
    assert "law.so" in problem.message and expected in problem.message


def test_simulate_fails_if_an_isolated_library_exits(tmp_path: Path, capsys: Any) -> None:
    boot = "static void __attribute__((constructor)) boot(void) { exit(0); }"
    compiled(tmp_path, f"{LAW}\n{boot}")
    with pytest.raises(DeclarationError):
        simulation(tmp_path, LIBRARY, isolated=True)
    isolated = "controllers.lwr.isolated=true"
    status, _, err = run(capsys, "simulate", str(tmp_path / "scenario.toml"), "--set", isolated)
    assert status == 2 and "law.so has ended the process that loads it: exit status 0" in err


def test_isolated_library_is_never_loaded_in_this_process(folder: Path) -> None:
    shutil.copy(folder / "law.so", folder / "alone.so")
    signals(simulation(folder, LIBRARY, isolated=True, file="alone.so"))
    assert "alone.so" not in Path("/proc/self/maps").read_text()


def test_process_forked_by_an_isolated_library_ends_with_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    simulated = simulation(folder, LIBRARY, isolated=True, function="forks")
    signals(simulated)
    pid = int((folder / "forked").read_text())
    assert until(lambda: not is_running(pid))
    simulated = simulation(folder, LIBRARY, isolated=True, function="forks_and_exits")
    with pytest.raises(SimulationError, match="forks_and_exits ended its process: exit status"):
        signals(simulated)


@pytest.mark.parametrize("isolated", [False, True])
def test_library_for_more_joints_is_reported(folder: Path, isolated: bool) -> None:
    said = r"law.so: eight has written torques of more than 7 joints$"
    with pytest.raises(SimulationError, match=said):
        signals(simulation(folder, LIBRARY, function="eight", isolated=isolated))


def test_library_that_crashes_in_this_process_is_named(folder: Path) -> None:
    simulation(folder, LIBRARY)  # writes the file
    command = [
        "-m",
        "sero_mj",
        "simulate",
        "scenario.toml",
        "--set",
        "controllers.lwr.function=crash",
    ]
    done = subprocess.run(
        [sys.executable, *command], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == -signal.SIGSEGV
    assert f"library {folder / 'law.so'}" in done.stderr


@pytest.mark.parametrize(
    ("settings", "key", "expected"),
    [
        ({"file": "none.so"}, "file", "no file"),
        ({"file": "peer.py"}, "file", "cannot be loaded"),
        ({"function": "contrl"}, "function", 'in C++ extern "C", in Rust #[no_mangle]'),
        ({"function": "contrl", "isolated": True}, "function", "has no function contrl"),
    ],
)
def test_library_that_cannot_be_loaded_is_reported(
    folder: Path, settings: dict[str, Any], key: str, expected: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        simulation(folder, LIBRARY, **settings)
    (problem,) = caught.value.problems
    assert problem.key == f"controllers.lwr.{key}"
    assert expected in problem.message


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        ("never", r"no answer from .*python.* to step 1 within 0.3 s"),
        ("silent", r"no answer from .* to step 50 within 0.2 s"),
        ("dies", r"exit status 3; its last output: a line before \| the joint is too hot"),
        ("crashes", "was ended by SIGABRT"),
    ],
)
def test_program_that_does_not_answer_ends_the_run(folder: Path, mode: str, expected: str) -> None:
    settings = {"first_patience": 0.3 if mode == "never" else 10.0, "patience": 0.2}
    with pytest.raises(SimulationError, match=expected):
        signals(simulation(folder, program(mode), **settings))


def test_live_run_reports_that_its_program_has_ended(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shown = RunSource(run=simulation(folder, program("dies")))
    shown.advance_to(0.1)
    assert "the run has ended: lwr at 0.0" in caplog.text
    assert "has ended with exit status 3" in str(shown.error)


def test_timeline_ends_where_a_program_has_ended(folder: Path) -> None:
    simulated = simulation(folder, program("dies"))
    with Mirror(simulated_scene(simulated)) as mirror:
        clock = Clock(mirror)
        for _ in range(4):
            clock.advance(0.05)
        assert clock.is_at_end
        assert clock.time == clock.end == pytest.approx(simulated.step * 1e-3)
        assert 0.0 < clock.time < 0.1


@pytest.mark.parametrize("mode", ["late start", "wrong size", "other steps", "twice", "megabytes"])
def test_other_errors_of_programs_do_not_change_the_run(
    folder: Path, mode: str, caplog: pytest.LogCaptureFixture
) -> None:
    expected = signals(simulation(folder, LIBRARY))
    found = signals(simulation(folder, program(mode)))
    for key, values in found.items():
        assert np.array_equal(values, expected[key]), key
    told = [record.message for record in caplog.records if "answers were ignored" in record.message]
    assert bool(told) == (mode in ("wrong size", "other steps", "twice"))


@pytest.mark.skipif(sys.platform != "linux", reason="its libraries are ELF files")
def test_library_for_another_machine_is_reported(folder: Path) -> None:
    library = bytearray((folder / "law.so").read_bytes())
    is_arm = library[18] == 183
    library[18] = 62 if is_arm else 183
    (folder / "other.so").write_bytes(library)
    said = f"is a library for {'x86-64' if is_arm else 'aarch64'}; expected a library for"
    with pytest.raises(DeclarationError, match=said):
        simulation(folder, LIBRARY, file="other.so")


@pytest.mark.parametrize(
    ("mode", "why"),
    [
        ("wrong size", r"\(found \w+ bytes; expected 64\)"),
        ("other steps", r"\(expected step \d+\)"),
    ],
)
def test_reasons_for_ignored_answers_are_reported(
    folder: Path, mode: str, why: str, caplog: pytest.LogCaptureFixture
) -> None:
    signals(simulation(folder, program(mode)))
    assert re.search(rf"\d+ answers were ignored {why}, 0 steps had no answer", caplog.text)


def test_nan_command_is_not_applied(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(SimulationError, match="to step 50"):
        signals(simulation(folder, program("nan"), patience=0.1))
    assert "1 answers were ignored (step 50: not finite), 1 steps had no answer" in caplog.text


def test_program_arguments_can_be_numbers(folder: Path) -> None:
    """This lets a sweep vary the program's gains."""
    words = ["cat", "{port}", 0.5, 3]
    declared = simulation(folder, program("right"), command=words).scenario.controllers["lwr"]
    assert declared.command == ["cat", "{port}", "0.5", "3"]
    with pytest.raises(DeclarationError, match="expected string"):
        simulation(folder, program("right"), command=["cat", "{port}", False])


@pytest.mark.parametrize("on_silence", ["hold", "gravity_compensation"])
def test_run_continues_without_answers_if_declared(
    folder: Path, on_silence: str, caplog: pytest.LogCaptureFixture
) -> None:
    settings = {"on_silence": on_silence, "patience": 0.05}
    simulated = simulation(folder, program("silent for a while"), **settings)
    found = signals(simulated)["lwr_commanded_torques"]
    if on_silence == "hold":
        assert (found[50:60] == found[49]).all()
    else:
        model = simulated.robot_model(simulated.controlled[0].robot)
        angles = simulated.log.signals["lwr_joint_angles"][54]
        model.update(angles, np.zeros(7))
        assert found[55] == pytest.approx(model.gravity(), abs=1e-9)
    assert (found[60] != found[59]).any()
    shown = RunSource(run=simulated)
    (said,) = shown.link_faults(*shown.link_state({"lwr_command_age": np.array([0.25])}))
    assert said == "no command for 0.25 s"
    assert not shown.link_faults(*shown.link_state({"lwr_command_age": np.array([0.0])}))
    ages = simulated.log.signals["lwr_command_age"].ravel()
    assert ages[[49, 50, 59, 60]] == pytest.approx([0.0, 0.001, 0.010, 0.0])
    said = [record.message for record in caplog.records]
    assert any(f"to step 50 within 0.05 s; {on_silence}" in text for text in said)
    assert any("answers again at 0.059 s" in text for text in said)


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        ("never", r"no answer from .*python.* to step 1 within 0.3 s"),
        ("dies", r"exit status 3; its last output: the joint is too hot"),
        ("other steps", r"to step 1 within 0.3 s"),
    ],
)
def test_errors_of_programs_over_shared_memory_are_reported(
    folder: Path, mode: str, expected: str
) -> None:
    settings = {"first_patience": 10.0 if mode == "dies" else 0.3}
    with pytest.raises(SimulationError, match=expected):
        signals(simulation(folder, by_memory(mode), **settings))
    pid = int((folder / "pid").read_text())
    assert until(lambda: not is_running(pid))


@pytest.mark.parametrize("answer", ["< step:1I 4x torques:7d", "< 8x torques:7d"])
def test_program_over_shared_memory_may_be_late_once(
    folder: Path, answer: str, caplog: pytest.LogCaptureFixture
) -> None:
    settings = {"on_silence": "hold", "patience": 0.1, "answer": answer}
    simulated = simulation(folder, by_memory("late once"), **settings)
    found = signals(simulated)["lwr_commanded_torques"]
    ages = simulated.log.signals["lwr_command_age"].ravel()
    late = np.flatnonzero(ages[1:]) + 1  # a row after the step
    assert late[0] == 50 and late[-1] < 75 and len(late) == late[-1] - 49  # 20 ms for each step
    assert (found[late] == found[49]).all()
    after = late[-1] + 1
    assert found[after] != pytest.approx(found[49], abs=1e-6)
    assert any("answers again" in record.message for record in caplog.records)


def is_running(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False


def test_program_and_its_children_end_with_the_run(folder: Path) -> None:
    signals(simulation(folder, program("forks")))
    for name in ("pid", "child"):
        pid = int((folder / name).read_text())
        assert until(lambda pid=pid: not is_running(pid)), name


def test_ports_of_programs_are_unique() -> None:
    held = [held_port() for _ in range(300)]
    numbers = {each.getsockname()[1] for each in held}
    for each in held:
        each.close()
    assert len(numbers) == 300 and max(numbers) < 32768  # the start of the system's ephemeral ports


def test_choosing_ports_does_not_change_the_random_state_of_the_user() -> None:
    random.seed(1)
    before = random.getstate()
    ports = []
    for _ in range(2):
        random.seed(1)
        with held_port() as held:
            ports.append(held.getsockname()[1])
    assert random.getstate() == before
    assert ports[0] != ports[1]


def test_deleted_run_ends_its_program(folder: Path) -> None:
    simulated = simulation(folder, program("right"))
    simulated.advance(10)
    pid = int((folder / "pid").read_text())
    assert is_running(pid)
    del simulated
    assert until(lambda: not is_running(pid))


def test_ctrl_c_while_waiting_for_a_program_ends_everything(folder: Path) -> None:
    (folder / "pid").unlink(missing_ok=True)
    simulation(folder, program("never"), first_patience=60.0)
    command = [
        "-m",
        "sero_mj",
        "simulate",
        "scenario.toml",
        "--set",
        "controllers.lwr.first_patience=60",
    ]
    process = subprocess.Popen([sys.executable, *command], cwd=folder)
    try:
        file = folder / "pid"
        assert until(lambda: file.exists() and file.read_text(), 20.0)
        pid = int(file.read_text())
        os.kill(process.pid, signal.SIGINT)
        process.wait(5)
        assert until(lambda: not is_running(pid))
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize(
    ("clock", "kind"), [("lockstep", "B"), ("lockstep", "b"), ("real_time", "B")]
)
def test_small_counter_wraps_to_0(folder: Path, clock: str, kind: str) -> None:
    (folder / "counts.py").write_text(
        "import socket, sys\n"
        "peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "peer.bind(('127.0.0.1', int(sys.argv[1])))\n"
        "while True:\n"
        "    packet, robot = peer.recvfrom(4096)\n"
        "    peer.sendto(packet, robot)  # gravity\n"
    )
    settings = {"state": f"gravity:7d step:1{kind}", "answer": f"torques:7d step:1{kind}"}
    controller = program("").replace("peer.py", "counts.py")
    simulated = simulation(folder, controller, duration=0.6, clock=clock, **settings)
    signals(simulated)
    ages = simulated.log.signals["lwr_command_age"].ravel()[1:]
    assert ages.max() == 0.0 if clock == "lockstep" else (ages < 0.005).mean() > 0.8


@pytest.mark.parametrize(
    ("kind", "expected"), [("<u2", 1 << 16), ("<f4", 1 << 24), ("<f8", 1 << 53)]
)
def test_modulus_of_counters_follows_their_type(kind: str, expected: int) -> None:
    assert modulus_of(np.zeros(1, kind)) == expected


def test_real_time_commands_arrive_within_their_step(folder: Path) -> None:
    simulated = simulation(folder, program("right"), duration=0.5, clock="real_time")
    for _ in simulated.run():
        pass
    ages = simulated.log.signals["lwr_command_age"].ravel()[1:]
    assert ages.min() == 0.0 and ages.max() < 0.4  # on a busy machine
    assert (simulated.log.signals["lwr_step_lateness"] >= 0.0).all()


def test_missed_real_time_is_reported_and_can_be_expected(
    folder: Path, capsys: Any, caplog: pytest.LogCaptureFixture
) -> None:
    simulation(folder, program("right"), duration=0.2)  # writes the file
    file = folder / "scenario.toml"
    expect = """
    [expect.in_time]
    measure = "real_time_factor"
    above = 0.95
    [expect.in_some_time]
    measure = "real_time_factor"
    above = 0.001
    [expect.behind]
    measure = "step_lateness"
    above = 0.1
    """
    file.write_text(file.read_text() + textwrap.dedent(expect))
    in_real_time = ("--set", "controllers.lwr.clock=real_time", "--set", "run.timestep=0.00002")
    status, out, _ = run(capsys, "simulate", str(file), *in_real_time, "--json")
    told = json.loads(out)
    assert status == 1
    holds = {each["name"]: each["holds"] for each in told["expect"]}
    assert holds == {"in_time": False, "in_some_time": True, "behind": True}
    factor, late = told["real_time"]["lwr"]["factor"], told["real_time"]["lwr"]["max_lateness"]
    assert 0.001 < factor < 0.95 and late > 0.1
    assert factor == pytest.approx(0.2 / (0.2 + late), rel=0.1)
    texts = [record.message for record in caplog.records if "times real time" in record.message]
    assert re.match(r"scenario is late: .* s took .* s: [\d.]+ times real time$", texts[0])
    assert texts[-1].startswith("scenario was late: 0.2 s took")
    assert len(texts) < 2 + told["took"] / 5.0
    with pytest.raises(DeclarationError) as caught:
        read_scenario(file)
    assert {problem.key for problem in caught.value.problems} == {
        f"expect.{name}.measure" for name in holds
    }
    assert "is not controlled in real time" in str(caught.value)


class SlowInRealTime:
    """A third-party controller, which waits for the wall clock and logs nothing."""

    is_in_real_time = True

    def torques(self, sensed: Any, target: Any, out: Any) -> None:
        clock.sleep(0.003)


def test_step_lateness_of_any_real_time_controller_can_be_expected() -> None:
    scenario = Scenario(
        Scene(robots=[SerialRobot.from_model("lwr")]),
        controllers={"lwr": SlowInRealTime()},
        expect={
            "in_time": {"measure": "real_time_factor", "above": 0.95},
            "late": {"measure": "step_lateness", "above": 0.01},
        },
        duration=0.02,
    )
    simulated = Simulation(scenario)
    for _ in simulated.run():
        pass
    assert {each.name: each.holds for each in simulated.outcomes()} == {
        "in_time": False,
        "late": True,
    }


def test_end_of_a_program_is_detected_at_once_in_real_time(folder: Path) -> None:
    with pytest.raises(SimulationError, match="exit status 3") as caught:
        signals(simulation(folder, program("dies"), duration=0.5, clock="real_time"))
    assert caught.value.time < 0.4  # with a patience of 1 s, on a busy machine


def test_old_command_at_the_end_of_a_real_time_run_is_reported(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    signals(simulation(folder, program("silent"), duration=0.2, clock="real_time"))
    assert any("no command in the last 0.1" in record.message for record in caplog.records)


def test_live_real_time_run_gets_its_steps_answered(folder: Path) -> None:
    simulated = simulation(folder, program("right"), duration=0.5, clock="real_time")
    shown = RunSource(run=simulated)
    for time in np.arange(0.0, 0.51, 0.05):  # all steps of a frame at once
        clock.sleep(0.05)
        shown.advance_to(time)
    ages = simulated.log.signals["lwr_command_age"].ravel()[1:]
    assert (ages < 0.005).mean() > 0.8  # on a busy machine


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="threads cannot be moved here")
@pytest.mark.parametrize("same_core", [True, False])
def test_lockstep_program_runs_on_the_core_of_the_simulation(folder: Path, same_core: bool) -> None:
    simulated = simulation(folder, program("right"), same_core=same_core)
    simulated.advance(50)
    process = simulated.controlled[0].controller.controller._link._program._child.process
    cores = os.sched_getaffinity(process.pid)
    simulated.close()
    assert cores <= os.sched_getaffinity(0)
    assert len(cores) == (1 if same_core else len(os.sched_getaffinity(0)))


def test_program_can_command_angles_to_joint_springs(folder: Path) -> None:
    law = PEER[PEER.index('    back["torques"] = (') : PEER.index('    if mode == "never"')]
    (folder / "angles.py").write_text(
        PEER.replace('("torques", "<f8", n)])\npeer', '("joint_angles", "<f8", n)])\npeer')
        .replace(law, '    back["joint_angles"] = said["angles"] + 0.01 * said["time"]\n')
    )  # fmt: skip
    controller = (
        f'kind = "udp"\ncommand = ["{sys.executable}", "angles.py", "{{port}}", "right"]\n'
        'answer = "< step:1I 4x joint_angles:7d"\nstiffness = 800\ndamping = 40'
    )
    simulated = simulation(folder, controller)
    found = signals(simulated)
    model = simulated.robot_model(simulated.controlled[0].robot)
    for k in (1, 50):
        angles, velocities = found["lwr_joint_angles"][k - 1], found["lwr_joint_velocities"][k - 1]
        model.update(angles, velocities)
        commanded = angles + 0.01 * found["time"][k - 1]
        assert found["lwr_target_angles"][k] == pytest.approx(commanded)
        wanted = 800 * (commanded - angles) - 40 * velocities
        assert found["lwr_commanded_torques"][k] == pytest.approx(wanted + model.gravity())


@pytest.mark.parametrize(
    ("controller", "key", "expected"),
    [
        ('kind = "udp"', "port", "is required"),
        ('kind = "udp"\nport = 9\nstate = "1I"', "state", "values0"),
        ('kind = "udp"\nport = 9\nstate = "angels:7F"', "state", "did you mean 'angles'"),
        ('kind = "udp"\nport = 9\nstate = "angles:6F"', "state", "6 numbers; expected 7"),
        (
            'kind = "udp"\nport = 9\nanswer = "step:1I"',
            "answer",
            "expected either torques or joint_angles",
        ),
        ('kind = "udp"\nport = 9\nanswer = "joint_angles:7F"', "stiffness", "stiffness in answer"),
        (
            'kind = "udp"\nport = 9\nanswer = "torques:7F damping:7F"',
            "answer",
            "`damping` requires",
        ),
        ('kind = "udp"\nport = 9\nclock = "lock"', "clock", "lockstep"),
        ('kind = "shm"\ncommand = ["./a", "{memory}", "{turn}"]', "command", "{done}"),
        ('kind = "shm"\ncommand = ["{memory}{turn}{done}"]\nport = 9', "port", "UDP"),
    ],
)
def test_invalid_declarations_name_their_key(
    tmp_path: Path, controller: str, key: str, expected: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        simulation(tmp_path, controller)
    assert [problem.key for problem in caught.value.problems] == [f"controllers.lwr.{key}"]
    assert expected in caught.value.problems[0].message


def test_states_contain_the_terms_for_computed_torque_control() -> None:
    model = RobotModel.of(SerialRobot.from_model("lwr"))
    state = State("< coriolis:7d mass_matrix:49d step:1I", model)
    sensed, target = Sensed(7), Target(7)
    sensed.angles[:], sensed.velocities[:] = np.linspace(0.1, 0.7, 7), np.linspace(-1, 1, 7)
    state.fill(3, sensed, target)
    values = state.structure.decode(bytes(state.packet))
    other = RobotModel.of(SerialRobot.from_model("lwr"))
    other.update(sensed.angles, sensed.velocities)
    assert values["mass_matrix"].reshape(7, 7) == pytest.approx(other.mass())
    assert values["coriolis"] == pytest.approx(other.coriolis())
    assert abs(values["coriolis"]).max() > 0.01


def test_port_without_a_listener_is_reported(folder: Path) -> None:
    controller = 'kind = "udp"\nport = 9\nfirst_patience = 0.2'
    with pytest.raises(
        SimulationError, match=r"within 0\.2 s: no program listens at 127\.0\.0\.1:9"
    ):
        signals(simulation(folder, controller))


def test_missing_program_is_reported(folder: Path) -> None:
    with pytest.raises(
        DeclarationError, match=r"scenario\.toml:\d+: controllers\.lwr\.command: no file "
    ):
        signals(simulation(folder, 'kind = "udp"\ncommand = ["./none", "{port}"]'))


def build_c(folder: Path) -> None:
    flags = ["-O2", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "controller.c", "-o", "controller.so"], cwd=folder, check=True)


def build_cpp(folder: Path) -> None:
    flags = ["-O2", "-std=c++17", "-Wall", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["c++", *flags, "controller.cpp", "-o", "controller.so"], cwd=folder, check=True)


def build_rust(folder: Path) -> None:
    if shutil.which("rustc") is None:
        pytest.skip("needs the compiler rustc")
    flags = ["-O", "-D", "warnings", "--crate-type", "cdylib"]
    subprocess.run(
        ["rustc", *flags, "controller.rs", "-o", "controller.so"], cwd=folder, check=True
    )


def build_program(folder: Path) -> None:
    flags = ["-O2", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(["cc", *flags, "controller.c", "-o", "controller"], cwd=folder, check=True)


@pytest.mark.parametrize(
    ("name", "ending", "build"),
    [
        ("controller-c", "c", build_c),
        ("controller-cpp", "cpp", build_cpp),
        ("controller-rust", "rs", build_rust),
        ("controller-udp-c", "c", build_program),
        ("controller-udp-python", "py", lambda folder: None),
    ],
)
def test_printed_controller_snippets_follow_their_target(
    name: str, ending: str, build: Callable[[Path], None], tmp_path: Path, capsys: Any
) -> None:
    assert name in snippets()
    status, text, _ = run(capsys, "new", "--snippet", name)
    assert status == 0
    (tmp_path / f"controller.{ending}").write_text(text)
    status, scenario, _ = run(capsys, "new", "--snippet", name, "--scene")
    (tmp_path / "controller.toml").write_text(scenario.replace('"python3"', f'"{sys.executable}"'))
    build(tmp_path)
    status, out, _ = run(capsys, "simulate", str(tmp_path / "controller.toml"))
    assert status == 0, out


def test_controller_with_a_wrong_sign_fails_its_expectations(tmp_path: Path, capsys: Any) -> None:
    _, text, _ = run(capsys, "new", "--snippet", "controller-c")
    (tmp_path / "controller.c").write_text(text.replace("stiffness = 800.0", "stiffness = -80.0"))
    _, scenario, _ = run(capsys, "new", "--snippet", "controller-c", "--scene")
    (tmp_path / "controller.toml").write_text(scenario)
    build_c(tmp_path)
    status, out, error = run(capsys, "simulate", str(tmp_path / "controller.toml"))
    assert status == 1, out + error
