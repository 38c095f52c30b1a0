"""Measures the computing time of a step of each controller, relative to `mj_step` of the robot.

    .venv/bin/python benchmarks/controllers.py

Each time is the minimum of many short measurements, so that other load has little effect.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from sero_mj import Scene, SerialRobot, World
from sero_mj.simulate.control.controller import Sensed, Target
from sero_mj.simulate.control.make_controller import controller_from, make_controller
from sero_mj.simulate.control.observer import MomentumObserver
from sero_mj.simulate.control.robot_model import RobotModel

STEP = 1e-3  # time step of the controllers, s
TABLES: tuple[dict[str, object], ...] = (
    {"kind": "gravity_compensation"},
    {"kind": "torque"},
    {"kind": "joint_impedance", "stiffness": 1000.0},
    {"kind": "joint_impedance", "stiffness": 1000.0, "torque_rate_limits": 1000.0},
    {"kind": "joint_position"},
    {"kind": "cartesian_impedance"},
)


def microseconds(call: Callable[[], object], chunks: int = 150, calls: int = 200) -> float:
    """Returns the duration of a call in microseconds, as the minimum over many chunks of calls."""
    best = np.inf
    for _ in range(chunks):
        begin = time.perf_counter()
        for _ in range(calls):
            call()
        best = min(best, (time.perf_counter() - begin) / calls)
    return 1e6 * float(best)


def main() -> None:
    robot = SerialRobot.from_model("lwr")
    world = World(Scene(robots=[robot], floor=False))
    data = world.make_data()
    start = np.deg2rad([10.0, 40.0, -20.0, -80.0, 30.0, 50.0, 15.0])
    data.qpos[:] = start
    bare = microseconds(lambda: mujoco.mj_step(world.model, data))
    model = RobotModel.of(robot)
    sensed, target, out = Sensed(7), Target(7), np.zeros(7)
    sensed.angles[:] = target.angles[:] = target.posture[:] = start
    model.update(start, sensed.velocities)
    target.pose[:] = model.flange()

    table = Table("one step for the LWR", "us", "times mj_step")
    table.add_row("bare mj_step", f"{bare:.1f}", "1.0")
    for fields in TABLES:
        control = make_controller(controller_from(fields), model, STEP, robot.torque_limits)
        cost = microseconds(lambda: control.torques(sensed, target, out))
        name = str(fields["kind"]) + (", rate limits" if "torque_rate_limits" in fields else "")
        table.add_row(name, f"{cost:.1f}", f"{cost / bare:.1f}")
    observer = MomentumObserver(model, 25.0, STEP)
    cost = microseconds(lambda: observer.update(sensed))
    table.add_row("momentum observer", f"{cost:.1f}", f"{cost / bare:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
