"""Denavit-Hartenberg kinematics in numpy, independent of MuJoCo; used to check its results.

Craig (modified):   T_{i-1,i} = Rx(alpha) Tx(a) Rz(theta) Tz(d), joint i turns about z of frame i.
Standard (classic): T_{i-1,i} = Rz(theta) Tz(d) Tx(a) Rx(alpha), joint i turns about z of frame i-1.

Sources: Craig, Introduction to Robotics, eq. 3.6 (modified); Denavit and Hartenberg 1955 as in
Spong et al., Robot Modeling and Control, eq. 3.10 (standard). Frame 0 is the base; the joint
joint angle q_i is added to theta_i (revolute) or to d_i (prismatic).

Mirrored at the xz plane, a frame T becomes S T S with S = diag(1, -1, 1, 1). S turns the signs of
alpha and theta (S Rx(alpha) S = Rx(-alpha), S Rz(theta) S = Rz(-theta)), and leaves Tx and Tz as
they are: the mirror image of a table is one with these two negated, whose revolute joints turn the
other way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..frames import Array, Bools, rotation_about

Convention = Literal["craig", "standard"]
Column = Literal["alpha", "a", "theta", "d"]
COLUMNS: tuple[Column, ...] = ("alpha", "a", "theta", "d")


@dataclass(frozen=True, eq=False)
class DhTable:
    """A Denavit-Hartenberg table of n joints.

    Attributes:
        convention: `craig` or `standard`.
        alpha: link twists, (n,), rad.
        a: link lengths, (n,), m.
        theta: joint offsets, (n,), rad.
        d: link offsets, (n,), m.
        revolute: True for revolute joints, False for prismatic ones, (n,) bool.
        sign: -1 for joints that turn against their z axis, those of a mirrored robot, else 1, (n,);
            None for 1 throughout.
    """

    convention: Convention
    alpha: Array
    a: Array
    theta: Array
    d: Array
    revolute: Bools
    sign: Array | None = None

    @classmethod
    def from_rows(
        cls,
        rows: ArrayLike,
        convention: Convention,
        columns: tuple[str, ...] = COLUMNS,
        revolute: ArrayLike | None = None,
    ) -> DhTable:
        """Builds a table from rows with the given column order.

        Args:
            rows: (n, 4).
            convention: `craig` or `standard`.
            columns: a permutation of alpha, a, theta, d. The paper's Fig. 7 shows alpha first
                and d last and leaves the two between open; alpha, a, theta, d is our reading.
            revolute: (n,) bool; all revolute when None.
        """
        table = np.asarray(rows, dtype=np.float64).reshape(-1, 4)
        column = {name: table[:, columns.index(name)].copy() for name in COLUMNS}
        turns = np.ones(len(table), bool) if revolute is None else np.asarray(revolute, bool)
        return cls(convention, **column, revolute=turns)

    def __len__(self) -> int:
        return len(self.alpha)

    def mirrored(self) -> DhTable:
        """Returns the table of the mirror image at the base's xz plane.

        At equal joint values its frames are S T S of those of this one, S = diag(1, -1, 1, 1).
        """
        sign = np.where(self.revolute, -1.0, 1.0) * self.signs
        return replace(self, alpha=-self.alpha, theta=-self.theta, sign=sign)

    @property
    def signs(self) -> Array:
        """`sign`, (n,)."""
        return np.ones(len(self)) if self.sign is None else self.sign

    def link_transforms(self, joint_angles: ArrayLike) -> Array:
        """Returns the transform of every row at the given joint angles.

        Args:
            joint_angles: (..., n), rad for revolute and m for prismatic joints.

        Returns:
            T_{i-1,i}, (..., n, 4, 4).

        Raises:
            ValueError: the last axis is not n long.
        """
        q = np.asarray(joint_angles, dtype=np.float64)
        if q.shape[-1:] != (len(self),):
            raise ValueError(
                f"joint_angles: found {q.shape}; expected {len(self)} in the last axis"
            )
        q = q if self.sign is None else q * self.sign
        theta = self.theta + np.where(self.revolute, q, 0.0)
        d = self.d + np.where(self.revolute, 0.0, q)
        ca, sa = np.cos(self.alpha), np.sin(self.alpha)
        rot_x, rot_z = rotation_about(0, self.alpha), rotation_about(2, theta)
        T = np.zeros((*q.shape, 4, 4))
        T[..., 3, 3] = 1.0
        if self.convention == "craig":
            T[..., :3, :3] = rot_x @ rot_z
            T[..., 0, 3], T[..., 1, 3], T[..., 2, 3] = self.a, -sa * d, ca * d
        else:
            T[..., :3, :3] = rot_z @ rot_x
            T[..., 0, 3] = self.a * np.cos(theta)
            T[..., 1, 3] = self.a * np.sin(theta)
            T[..., 2, 3] = d
        return T

    def frames(self, joint_angles: ArrayLike, base_frame: ArrayLike | None = None) -> Array:
        """Returns the forward kinematics of every frame.

        Args:
            joint_angles: (..., n), rad or m.
            base_frame: T_world_base (..., 4, 4); identity when None.

        Returns:
            T_world_i for i = 0 (the base) to n, (..., n + 1, 4, 4), translation in m.
        """
        links = self.link_transforms(joint_angles)
        base = np.eye(4) if base_frame is None else np.asarray(base_frame)
        many = np.broadcast_shapes(links.shape[:-3], base.shape[:-2])
        T = np.empty((*many, len(self) + 1, 4, 4))
        T[..., 0, :, :] = base
        for i in range(len(self)):
            T[..., i + 1, :, :] = T[..., i, :, :] @ links[..., i, :, :]
        return T

    def joint_axes(self, frames: Array) -> tuple[Array, Array]:
        """Returns every joint axis as a direction and a point, in the coordinates of `frames`.

        Joint values grow about, or along, the direction.

        Args:
            frames: what `frames()` returned, (..., n + 1, 4, 4).

        Returns:
            directions (..., n, 3) of unit length and points (..., n, 3) in m.
        """
        carrying = frames[..., 1:, :, :] if self.convention == "craig" else frames[..., :-1, :, :]
        return carrying[..., :3, 2] * self.signs[:, None], carrying[..., :3, 3]

    def jacobian(
        self,
        joint_angles: ArrayLike,
        base_frame: ArrayLike | None = None,
        flange_frame: ArrayLike | None = None,
    ) -> Array:
        """Returns the geometric Jacobian of the flange.

        Args:
            joint_angles: (..., n), rad or m.
            base_frame: T_world_base (4, 4); identity when None.
            flange_frame: T_n_flange (4, 4); identity when None.

        Returns:
            (..., 6, n): rows 0-2 linear velocity (m per rad or m), rows 3-5 angular velocity,
            of the flange origin, in world coordinates.
        """
        T = self.frames(joint_angles, base_frame)
        axis, point = self.joint_axes(T)
        flange = np.eye(4) if flange_frame is None else np.asarray(flange_frame)
        tip = (T[..., -1, :, :] @ flange)[..., None, :3, 3]
        turns = self.revolute[:, None]
        linear = np.where(turns, np.cross(axis, tip - point), axis)
        angular = np.where(turns, axis, 0.0)
        return np.swapaxes(np.concatenate([linear, angular], axis=-1), -1, -2)
