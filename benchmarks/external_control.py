"""Measures the time that controllers outside of Python add to a simulated step, and their delay.

    .venv/bin/python benchmarks/external_control.py [--seconds 2] [--rounds 3]

Requires a C compiler. The same control law (joint impedance) runs in Python, as a C library in the
same process and in a separate process, as a C program over UDP and over shared memory, as an FMU
(if FMPy is installed), in a C client of FRI 1.0, and in a ROS 2 node (if Cyclone DDS is installed).
The controllers are measured alternately.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from sero_mj.cli.new import snippets
from sero_mj.simulate.external_control.library import HEADER
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

HERE = Path(__file__).parent
sys.path[:0] = [
    str(HERE.parent / "tests"),
    str(HERE.parent / "tests/extensions/fmu"),
    str(HERE.parent / "tests/extensions/ros"),
]
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
duration = {seconds}
"""
LIBRARY = 'kind = "library"\nfile = "controller.so"'
UDP = 'kind = "udp"\ncommand = ["./controller", "{port}"]'
MEMORY = 'kind = "shm"\ncommand = ["./by_memory", "{memory}", "{turn}", "{done}"]'
FRI = 'kind = "fri"\nport = 0\ncommand = ["./fri_client", "{port}"]'
BY_MEMORY = """
#include <fcntl.h>
#include <sys/mman.h>
int by_memory(char **argv) {
  int file = open(argv[1], O_RDWR), turn = open(argv[2], O_RDONLY), done = open(argv[3], O_WRONLY);
  size_t at = (sizeof(struct sero_state) + 63) / 64 * 64;
  size_t size = at + sizeof(struct sero_answer);
  char *memory = mmap(0, size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  const struct sero_state *state = (const struct sero_state *)memory;
  struct sero_answer *answer = (struct sero_answer *)(memory + at);
  for (char byte; read(turn, &byte, 1) == 1; write(done, &byte, 1)) {
    answer->step = state->step;
    for (int i = 0; i < SERO_JOINTS; i++)
      answer->torques[i] = 800.0 * (state->target_angles[i] - state->angles[i]) +
        40.0 * (state->target_velocities[i] - state->velocities[i]) + state->gravity[i];
  }
  return 0;
}
int main(int argc, char **argv) { return argc > 3 ? by_memory(argv) : 1; }
"""


class Law:
    """The control law in Python."""

    def __init__(self, model: Any) -> None:
        self.model = model

    def torques(self, sensed: Any, target: Any, out: np.ndarray) -> None:
        """Computes the torques of a step."""
        self.model.update(sensed.motor_angles, sensed.motor_velocities)
        np.subtract(target.angles, sensed.angles, out)
        out *= 800.0
        out += 40.0 * (target.velocities - sensed.velocities)
        out += self.model.gravity()


def build(folder: Path) -> None:
    """Compiles the C programs and the library in a folder."""
    cc = os.environ.get("CC", "cc")
    (folder / "controller.c").write_text(snippets()["controller-c"].text)
    shared = ["-O2", "-shared", "-fPIC", f"-I{HEADER.parent}"]
    subprocess.run([cc, *shared, "controller.c", "-o", "controller.so"], cwd=folder, check=True)
    program = snippets()["controller-udp-c"].text
    (folder / "udp.c").write_text(program)
    subprocess.run([cc, "-O2", "udp.c", "-o", "controller"], cwd=folder, check=True)
    head = program[: program.index("int main")].replace("#include <stdio.h>", "#include <unistd.h>")
    (folder / "memory.c").write_text(head + BY_MEMORY)
    subprocess.run([cc, "-O2", "-w", "memory.c", "-o", "by_memory"], cwd=folder, check=True)
    client = str(HERE / "fri_client.c")
    subprocess.run([cc, "-O2", client, "-o", "fri_client"], cwd=folder, check=True)


def simulated(folder: Path, controller: str, seconds: float) -> Simulation:
    file = folder / "scenario.toml"
    file.write_text(SCENARIO.format(controller=controller or LIBRARY, seconds=seconds))
    scenario = read_scenario(file)
    if not controller:
        whole = Simulation(scenario)
        scenario.controllers["lwr"] = Law(whole.robot_model(whole.controlled[0].robot))
    return Simulation(scenario)


def per_step(simulation: Simulation) -> float:
    """Returns the duration of a step in microseconds, without the start of programs."""
    simulation.advance(100)
    begin = time.perf_counter()
    simulation.advance(simulation.steps)
    return (time.perf_counter() - begin) / (simulation.steps - 100) * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build(folder)
        ways = {
            "control law in Python": "",
            "C library": LIBRARY,
            "C library, separate process": f"{LIBRARY}\nisolated = true",
            "C program, shared memory": MEMORY,
            "C program, UDP in lockstep": UDP,
            "C client of FRI 1.0, in lockstep": FRI,
        }
        if find_spec("fmpy"):
            from test_fmu import write_fmu

            ways["FMU (FMI 2)"] = f'kind = "fmu"\nfile = "{write_fmu(folder, 2)}"'
        if find_spec("cyclonedds"):
            from test_ros2_robot import NODE

            (folder / "node.py").write_text(NODE)
            ways["ROS 2 node in Python"] = (
                f'kind = "ros2"\ndomain = 33\ncommand = ["{sys.executable}", "node.py", "right"]'
            )
        times: dict[str, list[float]] = {title: [] for title in ways}
        for _ in range(options.rounds):
            for title, controller in ways.items():
                times[title].append(per_step(simulated(folder, controller, options.seconds)))
        table = Table("controller", "us per step", "more than Python", title="LWR at 1 kHz")
        base = min(times["control law in Python"])
        for title, found in times.items():
            table.add_row(title, f"{min(found):.1f}", f"{min(found) - base:+.1f}")
        late = Table("in real time at 1 kHz", "commands in time", "maximum delay, ms")
        for title, controller in (("C program, UDP", UDP), ("C client of FRI 1.0", FRI)):
            text = f'{controller}\nclock = "real_time"'
            simulation = simulated(folder, text, options.seconds)
            simulation.advance(simulation.steps)
            signals = simulation.log.signals
            ages = signals.get("lwr_command_age", signals.get("lwr_fri_quality"))[200:]
            share = (ages < 5e-4).mean() if "lwr_command_age" in signals else float("nan")
            lateness = signals["lwr_step_lateness"].max() * 1e3
            late.add_row(title, "" if np.isnan(share) else f"{share:.2%}", f"{lateness:.2f}")
    Console().print(table)
    Console().print(late)


if __name__ == "__main__":
    main()
