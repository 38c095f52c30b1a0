"""`Plant`: the simulated robots, which take motor torques and give what their sensors read."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ..base.declaration import numbers
from ..base.errors import Problem
from ..base.frames import Array, RowIndex
from ..robots.assemble.world import World
from .plant_rows import PlantRow, PlantRows
from .rows import OneRow
from .sensors import Sensors


class Plant(PlantRows, PlantRow):
    """All robots of a dynamic world, joint after joint in the order of `world.robots`.

    After construction and, if `joints.looks_ahead`, after every step `data` holds the kinematics,
    the mass matrix and the bias torques (`qfrc_bias`) of the state that it is in, so a controller
    need not compute them.

    Args:
        world: compiled with `dynamic=True`.
        sensors: what the robots have; perfect ones when None.
        timestep: s; the model's when None.

    Attributes:
        model: its `MjModel`; payloads and frictions change it.
        data: its `MjData`.
        motor_torques: (n,), what acted in the last step.

    Raises:
        ValueError: the world is not dynamic, or the timestep not positive.
    """

    index: RowIndex = ...

    def __init__(
        self, world: World, sensors: Sensors | None = None, timestep: float | None = None
    ) -> None:
        if not world.dynamic:
            raise ValueError("found a world to look at; expected World(scene, dynamic=True)")
        if timestep is not None:
            if not 0 < timestep < 1:
                raise Problem(
                    "timestep", found=timestep, of="s", expected="more than 0, below 1"
                ).error()
            world.model.opt.timestep = timestep
        super().__init__(world, OneRow(world.model, world.make_data()), sensors)
        self._settle()

    @property
    def _plant(self) -> Plant:  # type: ignore[override]
        return self

    def row(self, row: RowIndex) -> Plant:
        """Itself: it has no other row."""
        return self

    @property
    def time(self) -> float:
        """Since the start, s."""
        return float(self.data.time)

    @property
    def motor_torques(self) -> Array:
        """What acted on the motors in the last step, (n,), Nm."""
        return np.asarray((self.rows.applied - self.pushed)[self.joints.motor_dofs])

    def reset(self, joint_angles: Any | None = None) -> None:
        """Puts the robots where they are declared to be, at rest, and ends pushes.

        Payloads, frictions and faults of sensors stay; the noise begins anew.

        Args:
            joint_angles: (n,), of all robots, rad; the declared ones when None.

        Raises:
            ValueError: not n finite numbers.
        """
        self.world.reset(self.data)
        self.pushes[...].clear()
        self.rows.applied[:] = self.pushed[:] = 0.0
        if joint_angles is not None:
            angles = numbers(joint_angles)
            if angles.shape != (self.n,):
                raise Problem(
                    "joint_angles", found=angles.size, of="numbers", expected=self.n
                ).error()
            for part in self.world.robots.values():
                self.data.qpos[part.qpos] = angles[part.joints]
        self._settle()

    def _settle(self) -> None:
        """Computes kinematics and sensor readings of a state at rest."""
        mujoco.mj_forward(self.model, self.data)
        self.rows.is_ahead = True
        if self.joints.elastic:
            self.joints.load_springs()
            mujoco.mj_forward(self.model, self.data)
        self.joints.read_at_rest(self._readings)
        self._is_measured = False
        self.sensors.reset(self._actual)

    def external_torques(self) -> Array:
        """What acted on the links from outside in the last step, (n,), Nm, true.

        Of pushes, contacts and stops; a payload is a part of its robot.
        """
        return self.joints.external(self.pushed)
