"""Measures the computing time of a step of a simulated LWR, relative to `mj_step` of the model.

    .venv/bin/python benchmarks/plant.py

Times are medians of alternating measurements, so that other load affects all of them.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import mujoco
import numpy as np

from sero_mj import Plant, Scene, SensorErrors, Sensors, SerialRobot, World

HOME = np.deg2rad([0, 30, 0, -90, 0, 60, 0])
STEPS, ROUNDS = 4000, 15


def microseconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    for _ in range(STEPS):
        work()
    return (time.perf_counter() - start) / STEPS * 1e6


def measure(elastic: bool) -> None:
    robot = SerialRobot.from_model("lwr", elastic_joints=elastic, joint_angles=HOME)
    world = World(Scene(robots=[robot]), dynamic=True)
    real = Sensors(
        7,
        angles=SensorErrors(resolution=1e-5),
        velocities=SensorErrors(noise=1e-3),
        torques=SensorErrors(noise=0.05, bias=0.1, delay=1),
    )
    plants = [Plant(world), Plant(world, real), Plant(world)]
    torques = plants[0].actual[2].copy()
    plants[2].step(torques)  # the arm of the bare loop is held by the same torques
    data = plants[2].data
    works: list[Callable[[], object]] = [
        lambda: mujoco.mj_step(world.model, data),
        lambda: plants[0].step(torques),
        lambda: plants[1].step(torques),
    ]
    times = np.array([[microseconds(work) for work in works] for _ in range(ROUNDS)])
    bare, perfect, noisy = np.median(times, axis=0)
    kind = "elastic" if elastic else "rigid"
    print(f"LWR, {kind} joints: mj_step {bare:.1f} us per step")
    print(f"  Plant.step, perfect sensors {perfect:.1f} us: {perfect / bare:.2f} times")
    print(f"  Plant.step, real sensors    {noisy:.1f} us: {noisy / bare:.2f} times")


if __name__ == "__main__":
    for elastic in (False, True):
        measure(elastic)
