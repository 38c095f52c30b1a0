"""Simulated runs of an LWR with faults, for the tests of explanations."""

from __future__ import annotations

import json
from contextlib import suppress
from functools import cache

from runs import HOME

from sero_mj.base.errors import SimulationError
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation

BEGIN = 1.3  # s, start of the faults


def simulated_swing(
    fault: str = "{}", load: str = "{}", seed: int = 0, loop: bool = False
) -> Simulation:
    """Returns a run of an LWR with realistic sensors, 2.6 s of sines, and a fault."""
    return finished(Simulation(swinging(fault, load, seed, loop)))


def swinging(
    fault: str, load: str, seed: int = 0, loop: bool = False, *,
    stiffness: float = 1200, duration: float = 2.6,
) -> Scenario:  # fmt: skip
    faults, loads = json.loads(fault), json.loads(load)
    return Scenario(
        Scene(robots=[SerialRobot.from_model("lwr", joint_angles=HOME)], floor=False),
        controllers={"lwr": {"kind": "joint_impedance", "stiffness": stiffness}},
        targets={"lwr": {"kind": "sine", "amplitude_deg": 9.0, "frequency": 0.5}},
        sensors={"lwr": {"angles": {"resolution": 1e-5}, "torques": {"noise": 0.03}}},
        faults={"it": {"begin": BEGIN, **faults}} if faults else None,
        disturbances={"load": {"begin": BEGIN, **loads}} if loads else None,
        duration=duration, seed=seed, torque_control=loop, name="swing",
    )  # fmt: skip


def finished(simulation: Simulation) -> Simulation:
    with suppress(SimulationError):  # a drive with the wrong sign runs away
        for _ in simulation.run():
            pass
    return simulation


@cache
def swing(fault: str = "{}", load: str = "{}", seed: int = 0, loop: bool = False) -> RunLog:
    """Returns the log alone, because simulations use much memory."""
    return simulated_swing(fault, load, seed, loop).log
