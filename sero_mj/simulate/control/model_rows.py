"""`ModelRows`: what the controllers of many equal robots know of them, in rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ...base.frames import Array
from .robot_model import RobotModel


class ModelRows:
    """`RobotModel` of m robots: the same questions and answers, with the rows as first axis.

    For joint torques MuJoCo is asked once for all, as for one world in which they stand: each robot
    takes a third of the time that it takes by itself. For matrices it is asked row by row.

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
        self._side_by_side: RobotModel | None = None
        self._is_moved = False  # whether those that stand side by side are where they should be
        self.flange_position, self.flange_rotation = np.zeros((m, 3)), np.zeros((m, 3, 3))

    def update(self, angles: Array, velocities: Array) -> None:
        """Moves the models, (m, n) each; both are kept, not copied, until the next update."""
        self._angles, self._velocities = angles, velocities
        self._is_moved = False

    def _all(self) -> RobotModel:
        """The robots side by side, moved to where they are."""
        if self._side_by_side is None:
            self._side_by_side = self._model.side_by_side(*self.rows)
        if not self._is_moved:
            self._side_by_side.update(self._angles.reshape(-1), self._velocities.reshape(-1))
            self._is_moved = True
        return self._side_by_side

    def gravity(self, out: Array | None = None) -> Array:
        """g(q), (m, n)."""
        result = self._gravity if out is None else out
        result[...] = self._all().gravity().reshape(result.shape)
        return result

    def write_momentum(self, momentum: Array, slope: Array) -> None:
        """See `RobotModel`; (m, n) each."""
        found = np.empty((2, momentum.size))
        self._all().write_momentum(*found)
        momentum[...], slope[...] = found.reshape(2, *momentum.shape)

    def write_inverse_dynamics(
        self, velocities: Array, accelerations: Array, torques: Array, less: Array
    ) -> None:
        """See `RobotModel`; (m, n) each."""
        found = np.empty((2, torques.size))
        given = velocities.reshape(-1), accelerations.reshape(-1)
        self._all().write_inverse_dynamics(*given, *found)
        torques[...], less[...] = found.reshape(2, *torques.shape)

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

    def _each(self, which: Iterable[int] | None = None) -> Iterator[RobotModel]:
        """The model, moved to where each of some of the robots, or of all, is."""
        for row in range(self.rows[0]) if which is None else which:
            self._model.update(self._angles[row], self._velocities[row])
            yield self._model
