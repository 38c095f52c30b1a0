"""`PlantRows`: simulated robots in one world or in many equal ones, in rows."""

from __future__ import annotations

from typing import NoReturn

import numpy as np

from ..base.frames import Array
from ..robots.assemble.world import World
from .joint_model import JointModel
from .rows import ManyRows, OneRow
from .sensors import Sensors


class PlantRows:
    """Takes motor torques and gives what sensors read, row by row; `Plant` for one world.

    Args:
        world: compiled with `dynamic=True`.
        rows: one world as it is, or many, whose arrays have the rows as their first axis.
        sensors: what the robots have, of as many rows.

    Attributes:
        world: as given.
        rows: likewise.
        n: number of joints of all robots of a row together.
        joints: motors, links and torque sensors in MuJoCo.
        measured: (3, n), what the sensors read.
        motor_angles: (n,), true, rad: before the spring of an elastic joint. Always the same
            array, to read only; so is the next.
        motor_velocities: (n,), likewise, rad/s.
        sensors: as given.

    Raises:
        ValueError: the sensors are not those of n joints.
    """

    def __init__(self, world: World, rows: OneRow | ManyRows, sensors: Sensors | None) -> None:
        self.world, self.rows = world, rows
        self.joints = JointModel(world, rows)
        self.n = self.joints.n
        self.motor_angles = self.joints.motor_angles
        self.motor_velocities = self.joints.motor_velocities
        self.sensors = Sensors(self.n) if sensors is None else sensors
        if self.sensors.n != self.n:
            raise ValueError(f"found sensors of {self.sensors.n} joints; expected {self.n}")
        self.measured = self.sensors.measured
        self._actual: Array = np.zeros_like(self.measured)
        self._is_measured = False  # whether what perfect sensors measured is what is
        column = (*rows.shape, -1, 1)
        self._readings = self._actual.reshape(column)
        self._measured_readings = self.measured.reshape(column)

    @property
    def timestep(self) -> float:
        """Of a step, s."""
        return float(self.world.model.opt.timestep)

    @property
    def actual(self) -> Array:
        """(3, n), true angles and velocities of the links and torques between motors and links.

        The latter during the last step; rad, rad/s, Nm. Not to be written into.
        """
        if self._is_measured and not self.sensors.is_perfect:  # since a moment ago
            np.copyto(self._actual, self.measured)
            self._is_measured = False
        return self.measured if self._is_measured else self._actual

    def step(self, motor_torques: Array) -> Array:
        """Simulates one timestep.

        Args:
            motor_torques: (n,), before gear friction and as seen at the joint, Nm.

        Returns:
            `measured`, (3, n): the same array every time.
        """
        self.joints.motor_torques[...] = motor_torques
        return self.step_given()

    def step_given(self) -> Array:
        """Simulates one timestep with what is in `joints.motor_torques`, which is not looked at.

        Returns:
            `measured`, (3, n): the same array every time.

        Raises:
            SimulationError: the motion of the only row has become unstable.
        """
        joints = self.joints
        if not joints.advance(self._gather_pushes()):
            self._stop_for_motion()
        sensors = self.sensors
        if sensors.is_perfect:
            joints.read(self._measured_readings)
            self._is_measured = True
            return self.measured
        joints.read(self._readings)
        self._is_measured = False
        return sensors.measure(self._actual)

    def place(self, row: int, plant: PlantRows) -> None:
        """Puts one of many rows where a plant by itself is, at rest, with the seed of its noise."""
        assert isinstance(self.rows, ManyRows) and isinstance(plant.rows, OneRow)
        self.rows.place(row, plant.world.model, plant.rows.data)
        self.joints.update_motors()
        self.actual[row] = plant.actual
        self.sensors.reset_row(row, plant.actual, plant.sensors.seed)

    def _gather_pushes(self) -> Array | None:
        """What pushes do at the joints now, (nv,), Nm; None where none do."""
        return None

    def _stop_for_motion(self) -> NoReturn:
        raise NotImplementedError  # rows that are unstable wait, see `ManyRows`
