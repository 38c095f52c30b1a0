"""The joints and links of the robot that a source moves, for messages that name them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...base.frames import Array, Ints
from ...robots.kinematics.joint_tree import JointTree


class RoutedJoint(NamedTuple):
    """A joint that a source moves.

    Attributes:
        angle: declared position, rad or m.
        torque_limit: maximum torque, Nm or N; infinite if unknown.
    """

    name: str
    angle: float = 0.0
    torque_limit: float = np.inf


@dataclass(frozen=True, eq=False)
class RoutedLinks:
    """The links of a robot that a source of transforms moves.

    Attributes:
        joints: indices of the independent joints, in the order of `Source.set_joints`, (k,).
        positions: function from the positions of the independent joints, (k,), to those of all
            joints, (n,).
        home: declared positions of the independent joints, (k,), rad or m.
        poses: name of each link in the robot's original file to the index of its body (0 for the
            base) and T_body_link (4, 4), m.
        base: declared T_world_base (4, 4), m.
    """

    tree: JointTree
    joints: Ints
    positions: Callable[[Array], Array]
    home: Array
    poses: Mapping[str, tuple[int, Array]]
    base: Array
