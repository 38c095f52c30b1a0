"""What a source learns of the robot to which routes lead from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...base.frames import Array, Ints
from ...robots.kinematics.joint_tree import JointTree


class LedJoint(NamedTuple):
    """A joint to which routes lead.

    Attributes:
        name: the robot's name for it.
        angle: as declared, rad or m.
        torque_limit: its largest torque, Nm or N; infinite where it is unknown.
    """

    name: str
    angle: float = 0.0
    torque_limit: float = np.inf


@dataclass(frozen=True, eq=False)
class LedLinks:
    """The links of a robot to which routes lead, for sources of transforms.

    Attributes:
        joints: indices of the independent ones, as in `Source.led_to`, (k,).
        positions: returns the positions of all joints (n,), from those of the independent (k,).
        home: declared positions of the independent ones, (k,), rad or m.
        poses: link of the robot's original file by name: index of the body, 0 for the base, and
            T_body_link (4, 4), m.
        base: T_world_base (4, 4) as declared, m.
    """

    tree: JointTree
    joints: Ints
    positions: Callable[[Array], Array]
    home: Array
    poses: Mapping[str, tuple[int, Array]]
    base: Array


class LeadsRobot:
    """Hooks of sources whose messages name the joints or links of a robot; others ignore them."""

    def led_to(self, joints: Sequence[LedJoint]) -> None:
        """Tells it the joints of the first robot or group that routes from it lead to, in order.

        For sources whose messages name joints; called before its events are asked for.
        """

    def led_to_links(self, links: LedLinks) -> None:
        """Tells it the links of the first robot that routes from it lead to.

        For sources of transforms; called before its events are asked for.
        """

    def needs_joints(self, event: str) -> bool:
        """Whether an event is not there because it is not known which joints are wanted."""
        return False
