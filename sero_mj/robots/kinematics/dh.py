"""Denavit-Hartenberg kinematics in NumPy, independent of MuJoCo, whose results it can check.

Craig (modified):   T_{i-1,i} = Rx(alpha) Tx(a) Rz(theta) Tz(d), joint axis i is z of frame i.
Standard (classic): T_{i-1,i} = Rz(theta) Tz(d) Tx(a) Rx(alpha), joint axis i is z of frame i-1.

Sources: Craig, Introduction to Robotics, eq. 3.6 (modified); Denavit and Hartenberg 1955 as in
Spong et al., Robot Modeling and Control, eq. 3.10 (standard). Frame 0 is the base. The joint
value q_i is added to theta_i (revolute) or to d_i (prismatic). In branching robots, i - 1 is
the parent of joint i.

Mirrored at the xz plane, a frame T becomes S T S with S = diag(1, -1, 1, 1). S inverts the signs of
alpha and theta (S Rx(alpha) S = Rx(-alpha), S Rz(theta) S = Rz(-theta)), and leaves Tx and Tz
unchanged. The mirror image of a table therefore has negative alpha and theta, and its revolute
joints rotate in the opposite direction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ...base.frames import MIRROR, Array, Bools, Ints, empty_transforms
from .joint_tree import JointTree

Convention = Literal["craig", "standard"]
Column = Literal["alpha", "a", "theta", "d"]
COLUMNS: tuple[Column, ...] = ("alpha", "a", "theta", "d")


@dataclass(frozen=True, eq=False)
class DhTable(JointTree):
    """A Denavit-Hartenberg table of n joints.

    Attributes:
        convention: convention of the table, `craig` (modified) or `standard`.
        alpha: link twists, shape (n,), rad.
        a: link lengths, shape (n,), m.
        theta: joint angles at joint value zero, shape (n,), rad.
        d: link offsets at joint value zero, shape (n,), m.
    """

    convention: Convention
    alpha: Array
    a: Array
    theta: Array
    d: Array
    revolute: Bools
    sign: Array | None = None
    parents: Ints | None = None
    root: Array | None = None

    @classmethod
    def from_rows(
        cls,
        rows: ArrayLike,
        convention: Convention,
        columns: tuple[str, ...] = COLUMNS,
        revolute: ArrayLike | None = None,
    ) -> DhTable:
        """Builds a table from rows, shape (n, 4), rad and m. The default is revolute joints.

        Fig. 7 of the paper shows alpha first and d last, but not the order of the other two
        columns. The default order of `columns` is our interpretation.
        """
        table = np.asarray(rows, dtype=np.float64).reshape(-1, 4)
        alpha, a, theta, d = (table[:, columns.index(name)].copy() for name in COLUMNS)
        turns = np.ones(len(table), bool) if revolute is None else np.asarray(revolute, bool)
        return cls(convention, alpha, a, theta, d, turns)

    @property
    def turns_in_carrier(self) -> bool:
        return self.convention == "standard"

    def mirrored(self) -> DhTable:
        sign = np.where(self.revolute, -1.0, 1.0) * self.signs
        root = None if self.root is None else MIRROR @ self.root @ MIRROR
        return replace(self, alpha=-self.alpha, theta=-self.theta, sign=sign, root=root)

    def step_lengths(self) -> Array:
        return np.asarray(np.abs(self.a) + np.abs(self.d))

    def distances(self, extensions: ArrayLike = 0.0) -> Array:
        return np.hypot(self.a, self.d + np.where(self.revolute, 0.0, extensions))

    @cached_property
    def _has_prismatic(self) -> bool:
        return not self.revolute.all()

    @cached_property
    def _twists(self) -> tuple[Array, Array]:
        return np.cos(self.alpha), np.sin(self.alpha)

    def transforms(self, joint_values: Array) -> Array:
        q = joint_values
        theta, d = self.theta + q, self.d
        if self._has_prismatic:
            theta, d = np.where(self.revolute, theta, self.theta), np.where(self.revolute, d, d + q)
        ca, sa = self._twists
        c, s = np.cos(theta), np.sin(theta)
        T = empty_transforms(q.shape)
        if self.convention == "craig":
            T[..., 0, 0], T[..., 0, 1] = c, -s
            T[..., 1, 0], T[..., 1, 1], T[..., 1, 2] = ca * s, ca * c, -sa
            T[..., 2, 0], T[..., 2, 1], T[..., 2, 2] = sa * s, sa * c, ca
            T[..., 0, 3], T[..., 1, 3], T[..., 2, 3] = self.a, -sa * d, ca * d
        else:
            T[..., 0, 0], T[..., 0, 1], T[..., 0, 2] = c, -s * ca, s * sa
            T[..., 1, 0], T[..., 1, 1], T[..., 1, 2] = s, c * ca, -c * sa
            T[..., 2, 1], T[..., 2, 2] = sa, ca
            T[..., 0, 3], T[..., 1, 3], T[..., 2, 3] = self.a * c, self.a * s, d
        return T
