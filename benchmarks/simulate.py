"""Measures the computing time of a simulated LWR, relative to a bare `mj_step` loop of the model.

    .venv/bin/python benchmarks/simulate.py

Scenarios have a controller with torque limits, sensors, and a log of every step at 1 kHz. The bare
loop holds the same arm. Times are medians of alternating measurements, so that other load affects
all of them.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from sero_mj import Scenario, Scene, SerialRobot, Simulation
from sero_mj.simulate.log_output import RunRecorder

HOME = [0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0]
RECORDING: list[float] = []  # recording times as shares of the rest of the same run
SECONDS, ROUNDS, TOGETHER = 8.0, 7, 64
SWING = {"kind": "sine", "amplitude_deg": 5.0, "frequency": 0.5}
GAINS = {"joint_impedance": {"stiffness": 800.0}}
NOISE = {"torques": {"noise": 0.05, "resolution": 0.01}, "velocities": {"noise": 1e-3}}


def scenario(controller: str, **fields: Any) -> Scenario:
    robot = SerialRobot.from_model("lwr", joint_angles=HOME)
    return Scenario(
        Scene(robots=[robot]),
        controllers={"lwr": {"kind": controller, **GAINS.get(controller, {})}},
        targets={} if controller in ("gravity_compensation", "torque") else {"lwr": SWING},
        duration=SECONDS,
        **fields,
    )


def simulation(controller: str, **fields: Any) -> Simulation:
    return Simulation(scenario(controller, **fields))


def together(controller: str, **fields: Any) -> float:
    """Returns microseconds per step and run, for runs that are simulated together."""
    runs = Simulation.together([scenario(controller, **fields)] * TOGETHER)
    assert isinstance(runs[0], Simulation)
    steps = runs[0].steps // 16
    start = time.perf_counter()
    runs[0].advance(steps)
    return (time.perf_counter() - start) / steps / TOGETHER * 1e6


def run(made: Simulation, record: Path | None = None) -> float:
    """Returns microseconds per step of a run, which is recorded if `record` is not None."""
    if record is not None:
        record.unlink(missing_ok=True)  # the time to delete the previous file is not measured
    start = time.perf_counter()
    if record is None:
        for _ in made.run():
            pass
        return (time.perf_counter() - start) / made.steps * 1e6
    with RunRecorder(made, record) as recorder:
        spent = time.perf_counter() - start
        for first, stop in made.run():
            before = time.perf_counter()
            recorder.write(first, stop)
            spent += time.perf_counter() - before
        closing = time.perf_counter()
    spent += time.perf_counter() - closing
    RECORDING.append(spent / (time.perf_counter() - start - spent))
    return (time.perf_counter() - start) / made.steps * 1e6


def bare() -> float:
    plant = simulation("gravity_compensation").plant
    model, data = plant.model, plant.data
    data.qfrc_applied[:] = data.qfrc_bias  # torques that hold the arm
    steps = round(SECONDS / plant.timestep)
    start = time.perf_counter()
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return (time.perf_counter() - start) / steps * 1e6


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        works: dict[str, Callable[[], float]] = {
            "bare mj_step": bare,
            "gravity compensation": lambda: run(simulation("gravity_compensation")),
            "joint impedance": lambda: run(simulation("joint_impedance")),
            "joint impedance, real sensors": lambda: run(
                simulation("joint_impedance", sensors={"lwr": NOISE})
            ),
            "joint impedance, recorded": lambda: run(simulation("joint_impedance"), file),
            "joint position": lambda: run(simulation("joint_position")),
            "Cartesian impedance": lambda: run(simulation("cartesian_impedance")),
            "joint impedance, torque loop at 3 kHz": lambda: run(
                simulation("joint_impedance", torque_control=True)
            ),
            "joint impedance, elastic joints": lambda: run(
                simulation("joint_impedance", elastic=True)
            ),
            f"joint impedance, {TOGETHER} together": lambda: together("joint_impedance"),
            f"Cartesian impedance, {TOGETHER} together": lambda: together("cartesian_impedance"),
        }
        for work in works.values():
            work()
        times = np.array([[work() for work in works.values()] for _ in range(ROUNDS)])
    medians = np.median(times, axis=0)
    table = Table(
        "simulation", "us per step", "times bare", "times real time", title="sero-mj simulate"
    )
    for name, median in zip(works, medians, strict=True):
        ratio, speed = median / medians[0], 1e3 / median
        table.add_row(name, f"{median:.1f}", f"{ratio:.2f}", f"{speed:.0f}")
    console = Console(width=100)
    console.print(table)
    share = 100 * float(np.median(RECORDING))
    console.print(
        f"recording adds {share:.0f} % to the time, mostly in the mcap package (goal: under 50 %)"
    )
    console.print("goals: at most 4 times bare, at least 25 times real time")


if __name__ == "__main__":
    main()
