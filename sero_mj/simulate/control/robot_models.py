"""`RobotModels`: `RobotModel` for several robots in m rows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from ...base.frames import Array
from .robot_model import RobotModel
from .whole_body import Mounting


class RobotModels:
    """`RobotModel` of several robots in m rows, joint after joint.

    The robots of all rows are side by side in one MuJoCo model, and one call computes their joint
    torques, in a third of the time per robot. Jacobians are computed row by row, and only for rows
    of one robot.

    Args:
        mountings: for every robot in every row, its mounting and T_world_base when the model was
            made; empty if no robot is mounted.

    Attributes:
        rows: shape (m,) of the first axis of all arguments and results.
        n: number of joints of all robots of a row.
        robots: slice of joints of each robot.
        joint_names: `ROBOT/JOINT`.
        motor_inertia: motor inertias at the joints (n,), kg m2 or kg.
        flange_position: positions of the flanges in the world (m, 3), m, from the last
            `write_task_space`.
        flange_rotation: R_world_flange, (m, 3, 3), of the last `write_task_space`.
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
        """Moves the models, (m, n) each; the arrays must not change until the next update."""
        self._angles, self._velocities = angles, velocities
        self._is_moved = False

    def _moved(self) -> RobotModel:
        if not self._is_moved:
            self._all.update(self._angles.reshape(-1), self._velocities.reshape(-1))
            self._is_moved = True
        return self._all

    def gravity(self, out: Array | None = None) -> Array:
        """Returns g(q), (m, n)."""
        result = self._gravity if out is None else out
        result[...] = self._moved().gravity().reshape(result.shape)
        return result

    def write_momentum(self, momentum: Array, slope: Array) -> None:
        """`RobotModel.write_momentum` with arrays (m, n)."""
        self._moved().write_momentum(momentum.reshape(-1), slope.reshape(-1))

    def write_inverse_dynamics(
        self, velocities: Array, accelerations: Array, torques: Array, less: Array
    ) -> None:
        """`RobotModel.write_inverse_dynamics` with arrays (m, n)."""
        self._moved().write_inverse_dynamics(
            velocities.reshape(-1), accelerations.reshape(-1), torques.reshape(-1), less.reshape(-1)
        )

    def mass(self) -> Array:
        """Returns M(q), (m, n, n), zero between two robots, in a new array."""
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
        """Returns J(q), (m, 6, n), in a new array."""
        return np.array([model.jacobian().copy() for model in self._each()])

    def write_task_space(self, *arrays: Array) -> None:
        """`RobotModel.write_task_space` with arrays whose first axis is m."""
        poses = self.flange_position, self.flange_rotation
        for model, position, rotation, *row in zip(self._each(), *poses, *arrays, strict=True):
            model.write_task_space(*row)
            position[...], rotation[...] = model.flange_position, model.flange_rotation

    def _each(self) -> Iterator[RobotModel]:
        for angles, velocities in zip(self._angles, self._velocities, strict=True):
            self._first.update(angles, velocities)
            yield self._first
