"""The signals of a simulated robot for packets that are sent."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..runs.run_log import MEASURED, event_of
from .simulation import Simulation

Array = NDArray[np.float64]


class LogSignals:
    """The signals of one robot of a simulation at any time until now; stands in for a motion.

    Args:
        simulation: it is not run here.
        robot: whose signals.
    """

    def __init__(self, simulation: Simulation, robot: str) -> None:
        self._simulation = simulation
        self._robot = simulation.scenario.scene.robots[robot]
        columns = simulation.layout.columns
        self._columns = {
            signal: columns[event_of(robot, signal)]
            for signal in (*MEASURED, "commanded_torques", "target_angles", "external_torques")
            if event_of(robot, signal) in columns
        }

    def signals(self, t: float) -> Mapping[str, Array]:
        """What is measured at time t, s."""
        simulation, timestep = self._simulation, self._simulation.scenario.run.timestep
        row = min(round(t / timestep), simulation.step)
        found = {signal: simulation.rows[row, columns] for signal, columns in self._columns.items()}
        angles, velocities = found["joint_angles"], found["joint_velocities"]
        before = simulation.rows[max(row - 1, 0), self._columns["joint_velocities"]]
        return {
            **found,
            "commanded_angles": found.get("target_angles", angles),
            "joint_accelerations": (velocities - before) / timestep,
            "billboard_values": velocities,
            "flange_check": self._robot.fwd_kin_base_to_flange(angles),
            "further": found["external_torques"],
        }
