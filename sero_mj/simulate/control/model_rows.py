"""`ModelRows`: what the controllers of many equal robots know of them, row by row."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ...base.frames import Array
from .robot_model import RobotModel


class ModelRows:
    """`RobotModel` of m robots: the same questions and answers, with the rows as first axis.

    MuJoCo is asked row by row: for a skeleton that takes less time than a batch of it, and rows
    that are not asked about cost nothing.

    Args:
        model: of one of them; for itself.
        m: how many.

    Attributes:
        rows: (m,), the first axis of all that is asked and answered.
        n: number of joints of a robot.
        name: of it, for messages.
        joint_names: of every joint, without the robot's name before it.
        motor_inertia: (n,), kg m2 or kg, of all of them.
        flange_position: (m, 3), m, in the world; those of the last `write_task_space`.
        flange_rotation: (m, 3, 3), R_world_flange, likewise.
    """

    def __init__(self, model: RobotModel, m: int) -> None:
        self._model, self.rows, self.n = model, (m,), model.n
        self.name = model.name
        self.joint_names, self.motor_inertia = model.joint_names, model.motor_inertia
        self._angles, self._velocities, self._gravity = np.zeros((3, m, model.n))
        self.flange_position, self.flange_rotation = np.zeros((m, 3)), np.zeros((m, 3, 3))

    def update(self, angles: Array, velocities: Array) -> None:
        """Moves the models, (m, n) each; both are kept, not copied, until the next update."""
        self._angles, self._velocities = angles, velocities

    def gravity(self, out: Array | None = None) -> Array:
        """g(q), (m, n)."""
        result = self._gravity if out is None else out
        self._model.write_gravity(self._angles, result)
        return result

    def mass(self, which: Iterable[int] | None = None) -> Array:
        """M(q) of k of the robots, or of all, (k, n, n), in an array of its own."""
        return np.array([model.mass().copy() for model in self._each(which)])

    def jacobian(self) -> Array:
        """J(q), (m, 6, n), in an array of its own."""
        return np.array([model.jacobian().copy() for model in self._each()])

    def write_task_space(self, *arrays: Array) -> None:
        """See `RobotModel`; with m as first axis each."""
        model, poses = self._model, (self.flange_position, self.flange_rotation)
        for _, position, rotation, *row in zip(self._each(), *poses, *arrays, strict=True):
            model.write_task_space(*row)
            position[...], rotation[...] = model.flange_position, model.flange_rotation

    def write_momentum(self, momentum: Array, slope: Array) -> None:
        """See `RobotModel`; (m, n) each."""
        for model, *row in zip(self._each(), momentum, slope, strict=True):
            model.write_momentum(*row)

    def _each(self, which: Iterable[int] | None = None) -> Iterator[RobotModel]:
        """The model, moved to where each of some of the robots, or of all, is."""
        for row in range(self.rows[0]) if which is None else which:
            self._model.update(self._angles[row], self._velocities[row])
            yield self._model

    def write_inverse_dynamics(
        self, velocities: Array, accelerations: Array, torques: Array, less: Array
    ) -> None:
        """See `RobotModel`; (m, n) each."""
        rows = (velocities, accelerations, torques, less)
        for model, *row in zip(self._each(), *rows, strict=True):
            model.write_inverse_dynamics(*row)
