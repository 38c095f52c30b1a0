"""Computes joint values and the base pose of a robot from the poses of its links in `tf`.

The transforms that robot_state_publisher publishes determine every joint value. The transform
between the two links of a joint is T_p,i(q) = T_p,i(0) A R(q) A^-1. The z axis of A is the joint
axis, and R is a rotation about z or a translation along z.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable

import numpy as np

from ...base.frames import Array, Ints, inverse, rotation_about, rotation_angles
from ...data.receive.source import RoutedLinks

_ANGLE, _DISTANCE = 0.02, 0.01  # rad, m: allowed difference between transforms and robot
_TURN = 2 * np.pi


class LinkTransforms:
    """Stores the newest transforms between frames, including the links of one robot.

    Links that are fixed to each other form one node, so the static transforms between them may be
    missing. Frame names may have a prefix that ends with a slash (`left/base_link`).
    """

    def __init__(self, links: RoutedLinks, report: Callable[[str], None]) -> None:
        self._links, self._report = links, report
        self._prefix = ""  # prefix of the first link name that has one
        self._angles = links.home.copy()  # last joint values
        self._above: dict[Hashable, tuple[Hashable, Array]] = {}
        tree = links.tree
        at_zero, axes = tree.link_transforms(np.zeros(len(tree))), tree.axis_frames
        self._before = inverse(at_zero @ axes)
        self._axes = axes
        self._parents, self._joints = tree.carriers.tolist(), links.joints.tolist()
        self._nodes: dict[str, tuple[Hashable, Array, Array]] = {}
        self._is_reported = False

    def take(self, parent: str, child: str, T_parent_child: Array) -> int | None:
        """Stores a transform (4, 4) in m. Returns the index of the body that it moves, or None."""
        above, T_above, _ = self._node(parent)
        below, _, T_back = self._node(child)
        if above == below:
            return None
        known = self._above.get(below)
        if known is not None and self._is_joint(known[0], below) > self._is_joint(above, below):
            return None  # the stored transform is the one across the body's own joint
        self._above[below] = above, T_above @ T_parent_child @ T_back
        return below if isinstance(below, int) else None

    def _node(self, name: str) -> tuple[Hashable, Array, Array]:
        if name in self._nodes:
            return self._nodes[name]
        poses, known = self._links.poses, name
        before, slash, own = name.rpartition("/")
        if slash and name not in poses and own in poses:
            self._prefix = self._prefix or before
            known = own if before == self._prefix else name
        node, T = poses.get(known, (name, np.eye(4)))
        self._nodes[name] = node, T, inverse(T)
        return self._nodes[name]

    def _is_joint(self, above: Hashable, below: Hashable) -> bool:
        if not isinstance(below, int) or below == 0:
            return False
        return bool(self._parents[below - 1] == above)

    def solve(self) -> Array:
        """Returns the values of the independent joints in rad or m, shape (k,).

        A joint without transforms has its last value.
        """
        poses: dict[Hashable, tuple[Hashable, Array]] = {}
        known: list[int] = []
        transforms: list[Array] = []
        for k, joint in enumerate(self._joints):
            parent, edge = self._parents[joint], self._above.get(joint + 1)
            if edge is None:
                continue
            T = edge[1]
            if edge[0] != parent:
                (one, T_one), (other, T_other) = (
                    self._in_root(node, poses) for node in (parent, joint + 1)
                )
                if one != other:
                    continue
                T = inverse(T_one) @ T_other
            known.append(k)
            transforms.append(T)
        if known:
            self._angles[known] = self._values(np.array(known), np.array(transforms))
        return self._angles

    def _values(self, known: Ints, transforms: Array) -> Array:
        joints = self._links.joints[known]
        moved = self._before[joints] @ transforms @ self._axes[joints]
        turns = self._links.tree.revolute[joints]
        sine, cosine = moved[:, 1, 0] - moved[:, 0, 1], moved[:, 0, 0] + moved[:, 1, 1]
        angles = np.where(turns, np.arctan2(sine, cosine), 0.0)
        rest = moved[:, :3, 3].copy()
        rest[~turns, 2] = 0.0
        self._check(joints, rest, moved[:, :3, :3] @ rotation_about(2, -angles))
        # A transform determines an angle only up to full revolutions.
        angles += _TURN * np.round((self._angles[known] - angles) / _TURN)
        return np.where(turns, angles, moved[:, 2, 3])

    def _check(self, joints: Ints, rest: Array, rotations: Array) -> None:
        if self._is_reported:
            return
        far, angles = np.linalg.norm(rest, axis=1), rotation_angles(rotations)
        wrong = (far > _DISTANCE) | (angles > _ANGLE)
        if wrong.any():
            self._is_reported, k = True, int(np.argmax(wrong))
            joint = int(joints[k])
            link = next(name for name, (i, _) in self._links.poses.items() if i == joint + 1)
            self._report(
                f"the transform of {link} differs by {far[k]:.3g} m and "
                f"{np.rad2deg(angles[k]):.3g} deg from any pose that the joint of the link can "
                "reach. It may belong to a different robot"
            )

    def base(self, root: str) -> Array | None:
        """Returns T_root_base (4, 4) in m, or None while it is unknown.

        If no transform contains the base, its pose is computed from another link and the last joint
        values. An example is a robot whose base is the world and whose first joints move a
        platform.

        Args:
            root: name of the reference frame; empty for the root of the transform tree.
        """
        bodies = sorted(node for node in self._above if isinstance(node, int))
        body = next((each for each in bodies if not isinstance(self._above[each][0], int)), 0)
        node, T = self._in_root(body, {}, root)
        if isinstance(node, int) or (root and node != root):
            return None
        return np.asarray(T @ inverse(self._body_in_base(body, self._angles)))

    def _in_root(
        self, node: Hashable, known: dict[Hashable, tuple[Hashable, Array]], root: str = ""
    ) -> tuple[Hashable, Array]:
        if node in known:
            return known[node]
        at, T, passed = node, np.eye(4), set[Hashable]()
        while at in self._above and at not in passed and not (root and at == root):
            passed.add(at)
            at, step = self._above[at]
            T = step @ T
        known[node] = at, T
        return at, T

    def in_base(self, link: str, angles: Array | None) -> Array:
        """Returns T_base_link (4, 4) in m, or the identity for an unknown link.

        Args:
            angles: values of the independent joints in rad or m, shape (k,) (default: the last
                values).
        """
        node, T, _ = self._node(link)
        if not isinstance(node, int):
            return np.eye(4)
        return np.asarray(self._body_in_base(node, self._angles if angles is None else angles) @ T)

    def _body_in_base(self, body: int, angles: Array) -> Array:
        return self._links.tree.frame(body, self._links.positions(angles))
