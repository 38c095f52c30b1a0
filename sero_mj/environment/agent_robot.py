"""`AgentRobot`: the simulated robot that an agent drives, as tasks see it."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from ..errors import SimulationError
from ..simulate.plant import Plant
from ..simulate.simulation import Simulation

Array = NDArray[np.float64]

_MAX_TRIES = 2000
_FROM_LIMITS = 0.05  # share of a joint's range that sampled poses keep from either end


class AgentRobot:
    """A robot of a simulation.

    Args:
        simulation: that it is in.
        name: of the robot.

    Attributes:
        simulation: of the current episode.
        name: as given.
    """

    def __init__(self, simulation: Simulation, name: str) -> None:
        self.simulation, self.name = simulation, name
        self._scratch = self.plant.world.make_data()

    @property
    def declared(self) -> SerialRobot:
        """Its declaration."""
        return self.simulation.robots[self.name]

    @property
    def plant(self) -> Plant:
        """The simulated robots of the current episode."""
        return self.simulation.plant

    @property
    def angles(self) -> Array:
        """True joint angles now, (n,), rad or m: a view."""
        return self.plant.actual[0, self.plant.world.robots[self.name].joints]

    @property
    def measured_angles(self) -> Array:
        """Measured joint angles now, (n,), rad or m: a view."""
        return self.plant.measured[0, self.plant.world.robots[self.name].joints]

    def flange(self) -> Array:
        """T_world_flange now, (4, 4), m; the true one."""
        return self.plant.flange(self.name)

    def free_pose(self, rng: np.random.Generator) -> Array:
        """Joint angles, (n,), within the limits, in which the robot touches nothing.

        Raises:
            SimulationError: none was found.
        """
        robot, model, data = self.declared, self.plant.model, self._scratch
        part = self.plant.world.robots[self.name]
        limits = robot.position_limits
        if limits is None:
            far = [np.pi if kind == "revolute" else 0.0 for kind in robot.types]
            limits = np.stack([-np.array(far), np.array(far)], axis=1)
        low, high = limits.T
        gap = _FROM_LIMITS * (high - low)
        torques = np.full(robot.n, np.inf) if robot.torque_limits is None else robot.torque_limits
        for _ in range(_MAX_TRIES):
            angles = rng.uniform(low + gap, high - gap)
            data.qpos[part.qpos] = angles
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            if data.ncon == 0 and (np.abs(data.qfrc_bias[part.dofs]) < torques).all():
                return np.asarray(angles)
        reason = f"found no pose in {_MAX_TRIES} that touches nothing and that its torques hold"
        raise SimulationError(0.0, robot.name, f"{reason}; expected other limits, or a start")
