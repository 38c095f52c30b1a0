"""`JointTree`: kinematics of a tree of joints in numpy, independent of MuJoCo.

Frame 0 is the base, frame i that of the link moved by joint i. The parent p(i) < i of each joint is
a link or the base: T_0,i = T_0,p(i) T_p(i),i(q_i). A serial robot has p(i) = i - 1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from ...base.errors import Problem
from ...base.frames import (
    MIRROR,
    Array,
    Bools,
    Ints,
    empty_transforms,
    frame,
    inverse,
    rotation_about,
)


class JointTree(ABC):
    """Kinematics of n joints.

    Attributes:
        revolute: False for prismatic joints, (n,).
        sign: -1 for joints that rotate against their z axis, those of a mirrored robot, else 1,
            (n,). None if all are 1.
        parents: index of the parent frame of each joint, (n,): 0 for the base, i for link i. None
            for a serial robot: 0 to n - 1.
        root: T_base_0, (4, 4): frame of the first row of the table; None for the base frame.
    """

    revolute: Bools
    sign: Array | None
    parents: Ints | None
    root: Array | None

    @abstractmethod
    def transforms(self, joint_values: Array) -> Array:
        """Returns T_p(i),i without `root`, (..., n, 4, 4), for values (..., n) times `signs`."""

    @abstractmethod
    def step_lengths(self) -> Array:
        """Returns the lengths from joint to joint along the table's offsets, (n,), m."""

    @abstractmethod
    def distances(self, extensions: ArrayLike = 0.0) -> Array:
        """Returns the distances between each origin and its parent's, (..., n), m."""

    @abstractmethod
    def mirrored(self) -> Self:
        """Returns the mirror image at the xz plane of the base: S T S, S = diag(1, -1, 1, 1)."""

    @property
    def turns_in_carrier(self) -> bool:
        """Whether axes are z of the parent frame (standard DH), not of the link's own frame."""
        return False

    def __len__(self) -> int:
        return len(self.revolute)

    @property
    def signs(self) -> Array:
        return np.ones(len(self)) if self.sign is None else self.sign

    @property
    def carriers(self) -> Ints:
        return np.arange(len(self), dtype=np.intp) if self.parents is None else self.parents

    @cached_property
    def moves(self) -> Bools:
        """Whether each frame is moved by each joint, (n + 1, n)."""
        moves = np.zeros((len(self) + 1, len(self)), bool)
        for i, parent in enumerate(self.carriers):
            moves[i + 1] = moves[parent]
            moves[i + 1, i] = True
        return moves

    def path_lengths(self, steps: Array) -> Array:
        """Returns the sums of steps (n,) from the base to every frame, (n + 1,)."""
        return np.asarray(self.moves @ steps)

    @property
    def depths(self) -> Ints:
        """Number of joints between the base and each link, (n,)."""
        return np.asarray(self.moves[1:].sum(axis=1))

    def link_transforms(self, joint_angles: ArrayLike) -> Array:
        """Returns T_p(i),i, (..., n, 4, 4), including `root`, for joint angles (..., n)."""
        q = np.asarray(joint_angles, dtype=np.float64)
        if q.shape[-1:] != (len(self),):
            raise Problem(
                "joint_angles", f"found {q.shape}", expected=f"{len(self)} in the last axis"
            ).error()
        T = self.transforms(q if self.sign is None else q * self.sign)
        if self.root is not None:
            on_base = self.carriers == 0
            T[..., on_base, :, :] = self.root @ T[..., on_base, :, :]
        return T

    def frames(self, joint_angles: ArrayLike, base_frame: ArrayLike | None = None) -> Array:
        """Returns T_world_i for i = 0 (the base) to n, (..., n + 1, 4, 4), translation in m.

        Args:
            joint_angles: joint values (..., n), rad or m.
            base_frame: T_world_base (..., 4, 4); identity if None.
        """
        links = self.link_transforms(joint_angles)
        base = np.eye(4) if base_frame is None else np.asarray(base_frame)
        many = np.broadcast_shapes(links.shape[:-3], base.shape[:-2])
        T = np.empty((*many, len(self) + 1, 4, 4))
        T[..., 0, :, :] = base
        for i, parent in enumerate(self.carriers.tolist()):
            T[..., i + 1, :, :] = T[..., parent, :, :] @ links[..., i, :, :]
        return T

    def frame(self, link: int, joint_angles: ArrayLike) -> Array:
        """Returns T_base_link of one frame, (..., 4, 4); link 0 is the base, -1 the last link."""
        links = self.link_transforms(joint_angles)
        joints = self.moves[link].nonzero()[0].tolist()
        if not joints:
            return np.tile(np.eye(4), (*links.shape[:-3], 1, 1))
        T: Array = links[..., joints[0], :, :]
        for i in joints[1:]:
            T = T @ links[..., i, :, :]
        return T

    @property
    def axis_frames(self) -> Array:
        """Frames of joint axes in link frames, (n, 4, 4); joint values increase along z."""
        T = np.tile(np.eye(4), (len(self), 1, 1))
        if self.turns_in_carrier:
            T = inverse(self.link_transforms(np.zeros(len(self))))
            if self.root is not None:
                T = np.where((self.carriers == 0)[:, None, None], T @ self.root, T)
        # Joints of a mirrored robot rotate against z of their frames.
        return np.asarray(np.where(self.signs[:, None, None] > 0, T, T @ _TURNED))

    def joint_axes(self, frames: Array) -> tuple[Array, Array]:
        """Returns a direction (..., n, 3) and a point (..., n, 3), m, of every joint axis.

        `frames` is a result of `frames()`, and determines the coordinates. Joint values increase
        about or along the direction.
        """
        own = frames[..., 1:, :, :]
        if self.turns_in_carrier:
            own = frames[..., self.carriers, :, :]
            if self.root is not None:
                own = np.where((self.carriers == 0)[:, None, None], own @ self.root, own)
        return own[..., :3, 2] * self.signs[:, None], own[..., :3, 3]

    def jacobian(
        self,
        joint_angles: ArrayLike,
        base_frame: ArrayLike | None = None,
        flange_frame: ArrayLike | None = None,
        link: int = -1,
    ) -> Array:
        """Returns the geometric Jacobian of the flange's origin in the world, (..., 6, n).

        Rows 0 to 2 are the linear velocity (m per rad or m), rows 3 to 5 the angular velocity.

        Args:
            joint_angles: joint values (..., n), rad or m.
            base_frame: T_world_base (4, 4); identity if None.
            flange_frame: T_link_flange (4, 4); identity if None.
            link: index of the frame that carries the flange.
        """
        T = self.frames(joint_angles, base_frame)
        axis, point = self.joint_axes(T)
        flange = np.eye(4) if flange_frame is None else np.asarray(flange_frame)
        tip = (T[..., link, :, :] @ flange)[..., None, :3, 3]
        turns = self.revolute[:, None]
        linear = np.where(turns, np.cross(axis, tip - point), axis)
        angular = np.where(turns, axis, 0.0)
        both = np.concatenate([linear, angular], axis=-1) * self.moves[link][:, None]
        return np.swapaxes(both, -1, -2)


_TURNED = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, eq=False)
class JointFrames(JointTree):
    """A tree of joints with individual frames, as in URDF and MJCF.

    T_p(i),i(q) = F_i Rz(q), or F_i Tz(q) for a prismatic joint.

    Attributes:
        fixed: F, frame of every link in its parent at joint value zero, (n, 4, 4), m; z is the
            joint axis.
    """

    fixed: Array
    revolute: Bools
    sign: Array | None = None
    parents: Ints | None = None
    root: Array | None = None

    def transforms(self, joint_values: Array) -> Array:
        angles = np.where(self.revolute, joint_values, 0.0)
        moved = np.where(self.revolute, 0.0, joint_values)
        c, s = np.cos(angles), np.sin(angles)
        T = empty_transforms(joint_values.shape)
        for i, (x, y, z, origin) in enumerate(self.fixed[:, :3].transpose(1, 2, 0)):
            T[..., i, 0], T[..., i, 1] = c * x + s * y, c * y - s * x
            T[..., i, 2], T[..., i, 3] = z, origin + moved * z
        return T

    def step_lengths(self) -> Array:
        return self.distances()

    def distances(self, extensions: ArrayLike = 0.0) -> Array:
        extended = np.where(self.revolute, 0.0, extensions)[..., None] * self.fixed[:, :3, 2]
        return np.asarray(np.linalg.norm(self.fixed[:, :3, 3] + extended, axis=-1))

    def mirrored(self) -> JointFrames:
        return replace(
            self,
            fixed=MIRROR @ self.fixed @ MIRROR,
            sign=np.where(self.revolute, -1.0, 1.0) * self.signs,
            root=None if self.root is None else MIRROR @ self.root @ MIRROR,
        )


@dataclass(frozen=True, eq=False)
class PlanarBase:
    """A base that moves in a plane, at x, y (m) and yaw (rad).

    Attributes:
        frame: T_world_base (4, 4) at zero, m.
        axes: two directions of motion and the normal of the plane, right-handed, in the base
            frame, (3, 3).
    """

    frame: Array
    axes: Array

    def pose(self, at: Array) -> Array:
        """Returns T_world_base (4, 4) at x, y and yaw, (3,)."""
        turned = self.axes.T @ rotation_about(2, at[2]) @ self.axes
        return np.asarray(self.frame @ frame(turned, at[:2] @ self.axes[:2]))

    def place(self, T_world_base: Array) -> Array:
        """Returns x, y and yaw (3,) of a pose (4, 4) in the plane, the inverse of `pose`."""
        T = inverse(self.frame) @ T_world_base
        turned = self.axes @ T[:3, :3] @ self.axes.T
        return np.append(self.axes[:2] @ T[:3, 3], np.arctan2(turned[1, 0], turned[0, 0]))
