"""`JointTree`: kinematics of a tree of joints in NumPy, independent of MuJoCo.

Frame 0 is the base frame, and frame i is the frame of the link that joint i moves. Joint i has the
parent frame p(i) < i, and T_0,i = T_0,p(i) T_p(i),i(q_i). A serial robot has p(i) = i - 1.
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
    """Kinematics of a robot with n joints that form a chain or a tree.

    Attributes:
        revolute: whether each joint is revolute instead of prismatic, shape (n,).
        sign: -1 for joints that rotate in the negative direction about their z axis, as in a
            mirrored robot, and 1 for others, shape (n,). None if all signs are 1.
        parents: index of the parent frame of each joint, shape (n,), 0 for the base and i for link
            i. None for a serial robot, whose indices are 0 to n - 1.
        root: pose of frame 0 of the table in the base frame, shape (4, 4), m; None if equal.
    """

    revolute: Bools
    sign: Array | None
    parents: Ints | None
    root: Array | None

    @abstractmethod
    def transforms(self, joint_values: Array) -> Array:
        """Returns poses of the links in their parent frames, shape (..., n, 4, 4), without `root`.

        `joint_values` contains the joint values multiplied by `signs`, shape (..., n), rad or m.
        """

    @abstractmethod
    def step_lengths(self) -> Array:
        """Returns `abs(a) + abs(d)` of each DH row, or the joint distances, shape (n,), m."""

    @abstractmethod
    def distances(self, extensions: ArrayLike = 0.0) -> Array:
        """Returns distances between the origins of each frame and its parent, shape (..., n), m."""

    @abstractmethod
    def mirrored(self) -> Self:
        """Returns the kinematics mirrored at the xz plane of the base, S T S for each frame T."""

    @property
    def turns_in_carrier(self) -> bool:
        """Whether joint axes are z axes of the parent frames, as in the standard DH convention."""
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
        """Mask of the joints that move each frame, shape (n + 1, n)."""
        moves = np.zeros((len(self) + 1, len(self)), bool)
        for i, parent in enumerate(self.carriers):
            moves[i + 1] = moves[parent]
            moves[i + 1, i] = True
        return moves

    def path_lengths(self, steps: Array) -> Array:
        """Returns, for each frame, the sum of `steps` (n,) of the joints that move it, (n + 1,)."""
        return np.asarray(self.moves @ steps)

    @property
    def depths(self) -> Ints:
        """Number of joints between the base and each link, shape (n,)."""
        return np.asarray(self.moves[1:].sum(axis=1))

    def link_transforms(self, joint_angles: ArrayLike) -> Array:
        """Returns poses of the links in their parent frames, shape (..., n, 4, 4), with `root`."""
        q = np.asarray(joint_angles, dtype=np.float64)
        if q.shape[-1:] != (len(self),):
            raise Problem(
                "joint_angles",
                f"found shape {q.shape}",
                expected=f"a last axis of length {len(self)}",
            ).error()
        T = self.transforms(q if self.sign is None else q * self.sign)
        if self.root is not None:
            on_base = self.carriers == 0
            T[..., on_base, :, :] = self.root @ T[..., on_base, :, :]
        return T

    def frames(self, joint_angles: ArrayLike, base_frame: ArrayLike | None = None) -> Array:
        """Returns the poses of the base and of all links, shape (..., n + 1, 4, 4), in m.

        Args:
            joint_angles: joint values, shape (..., n), rad or m.
            base_frame: pose of the base, shape (..., 4, 4), m (default: identity).
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
        """Returns the pose of a link (0 for the base) in the base frame, shape (..., 4, 4), m."""
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
        """Poses of joint axes in link frames, shape (n, 4, 4). Joint values increase along z."""
        T = np.tile(np.eye(4), (len(self), 1, 1))
        if self.turns_in_carrier:
            T = inverse(self.link_transforms(np.zeros(len(self))))
            if self.root is not None:
                T = np.where((self.carriers == 0)[:, None, None], T @ self.root, T)
        # Joints of a mirrored robot rotate against z of their frames.
        return np.asarray(np.where(self.signs[:, None, None] > 0, T, T @ _TURNED))

    def joint_axes(self, frames: Array) -> tuple[Array, Array]:
        """Returns directions and points (in m) of all joint axes, both with shape (..., n, 3).

        Joint values increase about or along these directions.

        Args:
            frames: poses of the base and the links, which the method `frames` returns.
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
        """Returns the geometric Jacobian of the flange in world coordinates, shape (..., 6, n).

        Rows 0 to 2 refer to the linear velocity of the flange's origin, rows 3 to 5 to the angular
        velocity.

        Args:
            joint_angles: joint values, shape (..., n), rad or m.
            base_frame: pose of the base, shape (4, 4), m (default: identity).
            flange_frame: pose of the flange in the link frame, shape (4, 4), m (default: identity).
            link: index of the link that carries the flange.
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
    """The kinematics of joints with individual frames, as in URDF and MJCF.

    T_p(i),i(q) = F_i Rz(q), or F_i Tz(q) for a prismatic joint.

    Attributes:
        fixed: poses F_i of the links in their parent frames at joint value zero, shape (n, 4, 4),
            m. The joint axes are the z axes.
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
    """The plane in which a robot base moves, with coordinates x and y (m) and yaw (rad).

    Attributes:
        frame: pose of the base at zero coordinates, shape (4, 4), m.
        axes: x and y directions and normal of the plane in the base frame, as rows, shape (3, 3).
    """

    frame: Array
    axes: Array

    def pose(self, at: Array) -> Array:
        """Converts x, y and yaw, shape (3,), to the pose of the base, shape (4, 4)."""
        turned = self.axes.T @ rotation_about(2, at[2]) @ self.axes
        return np.asarray(self.frame @ frame(turned, at[:2] @ self.axes[:2]))

    def place(self, T_world_base: Array) -> Array:
        """Converts a pose of the base, shape (4, 4), to x, y and yaw. This inverts `pose`."""
        T = inverse(self.frame) @ T_world_base
        turned = self.axes @ T[:3, :3] @ self.axes.T
        return np.append(self.axes[:2] @ T[:3, 3], np.arctan2(turned[1, 0], turned[0, 0]))
