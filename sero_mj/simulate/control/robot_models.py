"""`RobotModels`: `RobotModel` for several robots in m rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from ...base.frames import Array
from .robot_model import RobotModel
from .whole_body import Mounting


class RobotModels:
    """Counterpart of `RobotModel` for several robots in m rows, joint after joint.

    The robots of all rows are side by side in one MuJoCo model, and one call computes their joint
    torques, in a third of the time per robot. Jacobians are computed row by row, and are available
    only if each row has one robot.

    Args:
        mountings: for each robot in each row, its mounting and its pose T_world_base when the model
            was made; empty if no robot is mounted.

    Attributes:
        rows: leading shape (m,) of all arguments and results.
        n: number of joints of all robots in a row.
        robots: slice of joints of each robot.
        joint_names: names of the joints as `ROBOT/JOINT`.
        motor_inertia: motor inertias at the joints, shape (n,), kg m2 or kg.
        flange_position: positions of the flanges in the world at the last `write_task_space`, shape
            (m, 3), m.
        flange_rotation: rotation matrices R_world_flange at that time, shape (m, 3, 3).
    """

    def __init__(
        self,
        models: Sequence[RobotModel],
        m: int = 1,
        mountings: Sequence[tuple[Mounting, Array]] = (),
    ) -> None:
        self._first, self.rows = models[0], (m,)
        ends = np.cumsum([0, *(model.n for model in models)]).tolist()
        self.n = ends[-1]
        self.robots = [slice(a, b) for a, b in pairwise(ends)]
        self.joint_names = [
            f"{model.name}/{joint}" for model in models for joint in model.joint_names
        ]
        self.motor_inertia: Array = np.concatenate([model.motor_inertia for model in models])
        self._all = models[0]
        if m * len(models) > 1:
            self._all = RobotModel.side_by_side(models, m)
        if mountings:
            numbers = [model.n for model in models] * m
            self._all.follow(*((*each, n) for each, n in zip(mountings, numbers, strict=True)))
        self._angles, self._velocities, self._gravity = np.zeros((3, m, self.n))
        self._is_moved = False  # whether `_all` is at `_angles`
        self.flange_position, self.flange_rotation = np.zeros((m, 3)), np.zeros((m, 3, 3))
        self._entries: tuple[Array, ...] | None = None

    def update(self, angles: Array, velocities: Array) -> None:
        """Moves the models. The arrays, (m, n) each, must not change until the next update."""
        self._angles, self._velocities = angles, velocities
        self._is_moved = False

    def _moved(self) -> RobotModel:
        if not self._is_moved:
            self._all.update(self._angles.reshape(-1), self._velocities.reshape(-1))
            self._is_moved = True
        return self._all

    def gravity(self, out: Array | None = None) -> Array:
        """Returns the gravity torques g(q), shape (m, n)."""
        result = self._gravity if out is None else out
        result[...] = self._moved().gravity().reshape(result.shape)
        return result

    def write_momentum(self, momentum: Array, slope: Array) -> None:
        """Like `RobotModel.write_momentum`, with arrays of shape (m, n)."""
        self._moved().write_momentum(momentum.reshape(-1), slope.reshape(-1))

    def write_inverse_dynamics(
        self, velocities: Array, accelerations: Array, torques: Array, less: Array
    ) -> None:
        """Like `RobotModel.write_inverse_dynamics`, with arrays of shape (m, n)."""
        self._moved().write_inverse_dynamics(
            velocities.reshape(-1), accelerations.reshape(-1), torques.reshape(-1), less.reshape(-1)
        )

    def mass(self) -> Array:
        """Returns the mass matrices M(q), zero between two robots, in a new array (m, n, n)."""
        model, data = self._moved().sparse_mass()
        if self._entries is None:
            rows = np.repeat(np.arange(model.nv), model.M_rownnz)
            columns = model.M_colind
            self._entries = rows // self.n, rows % self.n, columns % self.n
        row, i, j = self._entries
        mass: Array = np.zeros((*self.rows, self.n, self.n))
        mass[row, i, j] = mass[row, j, i] = data.M
        return mass

    def jacobian(self) -> Array:
        """Returns the Jacobians J(q) of the flanges in a new array, shape (m, 6, n)."""
        return np.array([model.jacobian().copy() for model in self._each()])

    def write_task_space(self, *arrays: Array) -> None:
        """Like `RobotModel.write_task_space`, with a first axis of m rows in all arrays."""
        poses = self.flange_position, self.flange_rotation
        for model, position, rotation, *row in zip(self._each(), *poses, *arrays, strict=True):
            model.write_task_space(*row)
            position[...], rotation[...] = model.flange_position, model.flange_rotation

    def _each(self) -> Iterator[RobotModel]:
        for angles, velocities in zip(self._angles, self._velocities, strict=True):
            self._first.update(angles, velocities)
            yield self._first
