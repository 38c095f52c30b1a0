"""`LinkTransforms`: joint values and the base's pose, solved from the poses of links in `tf`.

What robot_state_publisher publishes determines every joint: the transform between the links that
a joint connects is T_p,i(q) = T_p,i(0) A R(q) A^-1, with z of A along the joint's axis and R a
rotation about z, or a translation along it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable

import numpy as np

from ...base.frames import Array, inverse, rotation_about, rotation_angle
from ..receive.source import LedLinks

_ANGLE, _DISTANCE = 0.02, 0.01  # rad and m by which transforms and robot may differ
_TURN = 2 * np.pi


class LinkTransforms:
    """The newest transforms between frames, of which some are links of a robot.

    Links that are fixed to each other are one node, so static transforms inside a robot may be
    missing. Names may have a prefix that ends with a slash (`left/base_link`).

    Args:
        links: of the robot.
        tell: gets what a user should know, once.
    """

    def __init__(self, links: LedLinks, tell: Callable[[str], None]) -> None:
        self._links, self._tell = links, tell
        self._prefix = ""  # of the first such name
        self._angles = links.home.copy()  # the last ones
        self._above: dict[Hashable, tuple[Hashable, Array]] = {}
        tree = links.tree
        at_zero, axes = tree.link_transforms(np.zeros(len(tree))), tree.axis_frames
        self._before = inverse(at_zero @ axes)
        self._axes = axes
        self._told = False

    def take(self, parent: str, child: str, T_parent_child: Array) -> int | None:
        """Takes a transform (4, 4), m; returns the body that it moves, or None."""
        above, T_above = self._node(parent)
        below, T_below = self._node(child)
        if above == below:
            return None
        known = self._above.get(below)
        if known is not None and self._is_joint(known[0], below) > self._is_joint(above, below):
            return None  # of two fixed links, that which the joint moves
        self._above[below] = above, T_above @ T_parent_child @ inverse(T_below)
        return below if isinstance(below, int) else None

    def _node(self, name: str) -> tuple[Hashable, Array]:
        """The body or frame that a name refers to, and T_node_name."""
        poses = self._links.poses
        before, slash, own = name.rpartition("/")
        if slash and name not in poses and own in poses:
            self._prefix = self._prefix or before
            name = own if before == self._prefix else name
        return poses.get(name, (name, np.eye(4)))

    def _is_joint(self, above: Hashable, below: Hashable) -> bool:
        """Whether a joint connects two nodes."""
        if not isinstance(below, int) or below == 0:
            return False
        return bool(self._links.tree.carriers[below - 1] == above)

    def solve(self) -> Array:
        """Returns the values of the independent joints, (k,), the last ones where unknown."""
        poses: dict[Hashable, tuple[Hashable, Array]] = {}
        for k, joint in enumerate(self._links.joints.tolist()):
            parent = int(self._links.tree.carriers[joint])
            edge = self._above.get(joint + 1)
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
            self._angles[k] = self._value(k, joint, T)
        return self._angles

    def _value(self, k: int, joint: int, T: Array) -> float:
        """The value of a joint by the transform of the link that it moves in its parent."""
        moved = self._before[joint] @ T @ self._axes[joint]
        if not self._links.tree.revolute[joint]:
            value = float(moved[2, 3])
            rest = moved[:3, 3] - [0.0, 0.0, value]
            self._check(joint, rest, moved[:3, :3])
            return value
        value = float(np.arctan2(moved[1, 0] - moved[0, 1], moved[0, 0] + moved[1, 1]))
        self._check(joint, moved[:3, 3], moved[:3, :3] @ rotation_about(2, -value))
        # A transform does not tell whole turns.
        return value + _TURN * round(float(self._angles[k] - value) / _TURN)

    def _check(self, joint: int, rest: Array, rotation: Array) -> None:
        """Tells, once, of transforms that the robot's links cannot have."""
        far, angle = float(np.linalg.norm(rest)), rotation_angle(rotation)
        if not self._told and (far > _DISTANCE or angle > _ANGLE):
            self._told = True
            link = next(name for name, (i, _) in self._links.poses.items() if i == joint + 1)
            self._tell(
                f"the transform of {link} is {far:.3g} m and {np.rad2deg(angle):.3g} deg off what "
                "its joint allows; is it another robot?"
            )

    def base(self, root: str) -> Array | None:
        """Returns T_root_base (4, 4), m; None while it is unknown.

        If transforms do not have the base itself, as of a robot whose base is the world and whose
        first joints move a platform, another link tells it, at the last joint values.

        Args:
            root: the frame in which it is wanted; the topmost one when empty.
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
        """The topmost node above another one, and the pose of this one in it."""
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
        """Returns T_base_link (4, 4), m; identity for an unknown link.

        Args:
            link: its name.
            angles: of the independent joints, (k,), rad or m; the last ones when None.
        """
        node, T = self._node(link)
        if not isinstance(node, int):
            return np.eye(4)
        return np.asarray(self._body_in_base(node, self._angles if angles is None else angles) @ T)

    def _body_in_base(self, body: int, angles: Array) -> Array:
        return self._links.tree.frame(body, self._links.positions(angles))
