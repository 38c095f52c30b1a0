"""`RobotModels`: what controllers and observers know of several robots in m equal worlds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from ...base.frames import Array
from .robot_model import RobotModel
from .whole_body import Mounting


class RobotModels:
    """`RobotModel` of several robots in m rows, joint after joint.

    For joint torques MuJoCo is called once for all robots of all rows, which stand side by side in
    one world: each robot takes a third of the time that it takes alone. For the flange's Jacobian
    it is called row by row; then there has to be one robot.

    Args:
        mountings: of every robot in every row, if there are mounted ones: the mounting and
            T_world_base when the model was made.

    Attributes:
        rows: (m,), the first axis of all arguments and results.
        n: number of joints of all robots of a row together.
        robots: the joints of each robot.
        joint_names: of every joint, `ROBOT/JOINT`.
        motor_inertia: (n,), kg m2 or kg.
        flange_position: (m, 3), m, in the world; those of the last `write_task_space`.
        flange_rotation: (m, 3, 3), R_world_flange, from the same call.
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
        self._is_moved = False  # whether `_all` is where the robots are
        self.flange_position, self.flange_rotation = np.zeros((m, 3)), np.zeros((m, 3, 3))
        self._entries: tuple[Array, ...] | None = None

    def update(self, angles: Array, velocities: Array) -> None:
        """Moves the models, (m, n) each; both are kept, not copied, until the next update."""
        self._angles, self._velocities = angles, velocities
        self._is_moved = False

    def _moved(self) -> RobotModel:
        if not self._is_moved:
            if self.rows[0] == 1:  # `reshape` takes longer
                self._all.update(self._angles[0], self._velocities[0])
            else:
                self._all.update(self._angles.reshape(-1), self._velocities.reshape(-1))
            self._is_moved = True
        return self._all

    def gravity(self, out: Array | None = None) -> Array:
        """g(q), (m, n)."""
        result = self._gravity if out is None else out
        if self.rows[0] == 1:
            self._moved().gravity(result[0])
        else:
            result[...] = self._moved().gravity().reshape(result.shape)
        return result

    def write_momentum(self, momentum: Array, slope: Array) -> None:
        """See `RobotModel`; (m, n) each."""
        self._moved().write_momentum(momentum.reshape(-1), slope.reshape(-1))

    def write_inverse_dynamics(
        self, velocities: Array, accelerations: Array, torques: Array, less: Array
    ) -> None:
        """See `RobotModel`; (m, n) each."""
        self._moved().write_inverse_dynamics(
            velocities.reshape(-1), accelerations.reshape(-1), torques.reshape(-1), less.reshape(-1)
        )

    def mass(self) -> Array:
        """M(q), (m, n, n), zero between two robots; in an array of its own."""
        model, data = self._moved().made_mass()
        if self._entries is None:
            rows = np.repeat(np.arange(model.nv), model.M_rownnz)
            columns = model.M_colind
            self._entries = rows // self.n, rows % self.n, columns % self.n
        row, i, j = self._entries
        mass: Array = np.zeros((*self.rows, self.n, self.n))
        mass[row, i, j] = mass[row, j, i] = data.M
        return mass

    def jacobian(self) -> Array:
        """J(q), (m, 6, n), in an array of its own."""
        return np.array([model.jacobian().copy() for model in self._each()])

    def write_task_space(self, *arrays: Array) -> None:
        """See `RobotModel`; with m as first axis each."""
        poses = self.flange_position, self.flange_rotation
        for model, position, rotation, *row in zip(self._each(), *poses, *arrays, strict=True):
            model.write_task_space(*row)
            position[...], rotation[...] = model.flange_position, model.flange_rotation

    def _each(self) -> Iterator[RobotModel]:
        for angles, velocities in zip(self._angles, self._velocities, strict=True):
            self._first.update(angles, velocities)
            yield self._first
