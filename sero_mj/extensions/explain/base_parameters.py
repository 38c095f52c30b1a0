"""`BaseParameters`: the parameters of the links that joint torques depend on.

Each link has the ten `PARAMETERS`: mass, first moments and inertia about its DH frame. The torques
are linear in these standard parameters. They depend only on some linear combinations of them, the
base parameters.

Sources: Gautier, Numerical calculation of the base inertial parameters of robots, Journal of
Robotic Systems 8(4), 1991. Khalil, Dombre, Modeling, Identification and Control of Robots, 2002,
chapter 9.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...base.frames import Array, Ints
from ...robots.assemble.robot_dynamics import robot_dynamics
from ...robots.declared.robot import SerialRobot
from .link_torques import PARAMETERS, body_torques, link_motion

_POSES = 120  # random poses, more than enough rows for each robot
_DEPENDENT = 1e-8  # relative length of the part of a column that the other columns do not contain
_MIN_COEFFICIENT = 1e-7  # smaller coefficients are rounding errors
# Order in which the parameters of a link are chosen, so that mass and Iyy are grouped as usual.
_ORDER = [PARAMETERS.index(each) for each in
          ("Izz", "Ixx", "Ixy", "Ixz", "Iyz", "hx", "hy", "hz", "Iyy", "mass")]  # fmt: skip


def standard_torques(robot: SerialRobot, q: Array, v: Array, a: Array) -> Array:
    """Returns link torques per unit of the `PARAMETERS` of each moving link, shape (K, n, 10 n).

    Args:
        q: joint values, shape (K, n), rad or m.
        v: joint velocities, shape (K, n).
        a: joint accelerations, shape (K, n).
    """
    motion = link_motion(robot, q, v, a)
    columns = [body_torques(robot, q, v, a, link + 1, motion) for link in range(robot.n)]
    return np.concatenate(columns, axis=2)


def standard_parameters(robot: SerialRobot) -> Array:
    """Returns the declared or estimated `PARAMETERS` of the moving links, shape (10 n,)."""
    dynamics = robot_dynamics(robot)
    m, c = dynamics.masses[1:], dynamics.centers[1:]
    about = np.einsum("ij,ij->i", c, c)[:, None, None] * np.eye(3) - c[:, :, None] * c[:, None]
    tensors = dynamics.tensors[1:] + m[:, None, None] * about
    entries = tensors[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.concatenate([m[:, None], m[:, None] * c, entries], axis=1).ravel()


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The b independent combinations of the standard parameters of a robot.

    Attributes:
        indices: indices of independent standard parameters, shape (b,).
        combination: matrix that maps standard to base parameters, shape (b, 10 n).
        names: sums of standard parameters such as `A2.hx + 0.31 A3.mass`.
    """

    indices: Ints
    combination: Array
    names: tuple[str, ...]

    @classmethod
    def of(cls, robot: SerialRobot) -> BaseParameters:
        """Finds the base parameters from the torques at random joint values and velocities."""
        rng = np.random.default_rng(0)
        low, high = robot.display_ranges.T
        q = rng.uniform(low, high, (_POSES, robot.n))
        v, a = rng.normal(0.0, 2.0, (2, _POSES, robot.n))
        X = standard_torques(robot, q, v, a).reshape(_POSES * robot.n, -1)
        order = [10 * link + each for link in range(robot.n) for each in _ORDER]
        indices = np.sort(_independent(X, order))
        combination = np.asarray(np.linalg.lstsq(X[:, indices], X, rcond=None)[0], np.float64)
        combination[np.abs(combination) < _MIN_COEFFICIENT] = 0.0
        names = [f"{joint}.{each}" for joint in robot.names for each in PARAMETERS]
        sums = (_named_sum(row, k, names) for row, k in zip(combination, indices, strict=True))
        return cls(indices, combination, tuple(sums))

    def __len__(self) -> int:
        return len(self.indices)

    def columns(self, torques: Array) -> Array:
        """Returns torques per unit of the base parameters, shape (K, n, b).

        Args:
            torques: `standard_torques`, shape (K, n, 10 n).
        """
        return torques[..., self.indices]


def _independent(X: Array, order: Sequence[int]) -> Ints:
    # Columns that do not depend on columns before them: a QR decomposition, column by column.
    Q, found = np.zeros((len(X), 0)), []
    for k in order:
        left = X[:, k]
        for _ in range(2):  # the second pass removes rounding errors of the first one
            left = left - Q @ (Q.T @ left)
        length, whole = float(np.linalg.norm(left)), float(np.linalg.norm(X[:, k]))
        if length > _DEPENDENT * max(whole, 1.0):
            Q = np.column_stack([Q, left / length])
            found.append(k)
    return np.array(found, np.intp)


def _named_sum(row: Array, own: int, names: Sequence[str]) -> str:
    text = names[own]
    for k in np.flatnonzero(row).tolist():
        if k != own:
            size = f"{abs(row[k]):.3g} "
            text += f" {'-' if row[k] < 0 else '+'} {'' if size == '1 ' else size}{names[k]}"
    return text
