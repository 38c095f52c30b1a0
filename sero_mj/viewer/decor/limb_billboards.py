"""Limb billboards: one billboard for a whole arm or hand if there is no room for each joint."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from ...base.frames import Bools, Ints
from ...robots.assemble.parts import DoublePart
from ...robots.assemble.world_view import WorldView
from ...robots.declared.limbs import limb_name
from .billboard_layout import SMALL, owner_groups
from .joint_titles import without_common_start


@dataclass(frozen=True, eq=False)
class BillboardLimbs:
    """The limbs of a world, each of which may have one billboard instead of one for each joint.

    Attributes:
        groups: index of the robot beside which the billboards of each robot or double are placed,
            shape (len(owners),). Each double has its own index.
        beside: number of the limb beside which the billboard of each joint is placed, shape (N,).
            Billboards of fingers are placed beside their arm.
        of_joint: index in `names` of the limb that each joint belongs to, shape (N,).
        names: names of the limbs.
    """

    groups: Ints
    beside: Ints
    of_joint: Ints
    names: list[str]

    def joints_of(self, joint: int) -> Ints:
        return np.flatnonzero(self.of_joint == self.of_joint[joint])

    def collapsed(self, shown: Ints, is_clicked: Bools, room: int) -> Bools:
        """Returns a mask of the joints whose billboards the billboard of their limb replaces.

        Limbs with more joints are collapsed first, until the remaining billboards fit. Limbs with
        the same number of joints, such as two legs, are collapsed together.

        Args:
            shown: indices of joints with a billboard, shape (k,).
            is_clicked: mask of joints that always have their own billboard, shape (k,).
            room: number of billboards that fit into the image.
        """
        limb = self.of_joint[shown]
        collapsed = np.zeros(len(shown), bool)
        # One billboard for the only limb would be less informative than those of loaded joints.
        if len(shown) <= room or len(np.unique(limb)) == 1:
            return collapsed
        numbers, counts = np.unique(limb[~is_clicked], return_counts=True)
        total = len(shown)
        for count in np.unique(counts[counts > 1])[::-1]:
            if total > room:
                of_count = numbers[counts == count]
                collapsed |= np.isin(limb, of_count) & ~is_clicked
                total -= int(count - 1) * len(of_count)
        return collapsed


def billboard_limbs(world: WorldView) -> BillboardLimbs:
    """Returns the limbs of a world, with small limbs such as fingers combined into one limb.

    Limbs that are small compared to the limb that carries them are combined. Their billboards are
    placed beside those of the carrier. The same holds for a robot that another robot carries, such
    as a hand with fingers.
    """
    joints, parts = world.joints, list(world.owners.values())
    is_double = np.array([isinstance(part, DoublePart) for part in parts], bool)
    groups = np.where(is_double, np.arange(len(parts)), owner_groups(world))
    centres = world.state(world.make_data()).site_xpos[joints.centre_site]
    beside, limb = joints.limb.copy(), joints.limb.copy()
    carried: dict[int, int] = {}  # maps a carrying limb to the combined limb that it carries
    for part in parts:
        first = part.joints.start
        n = part.joints.stop - first
        carriers = part.robot.carriers
        below = first + (np.arange(n) if carriers is None else carriers[:n]) - 1
        on_base = below < first
        below[on_base] = (first + np.arange(n))[on_base]
        own = joints.limb[part.joints]
        steps = np.linalg.norm(centres[part.joints] - centres[below], axis=1)
        lengths = np.bincount(own, np.where(joints.limb[below] == own, steps, 0.0))
        for k in np.flatnonzero(joints.limb[below] != own):  # first joints of limbs
            if lengths[own[k]] < SMALL * lengths[joints.limb[below[k]]]:
                by = int(beside[below[k]])
                beside[part.joints][own == own[k]] = by
                limb[part.joints][own == own[k]] = carried.setdefault(by, limb.max() + 1)
    is_carried = groups != np.arange(len(groups))
    for group in sorted(set(groups[is_carried].tolist())):
        mine = (is_carried & (groups == group))[joints.owner]
        beside[mine], limb[mine] = beside.max() + 1, limb.max() + 1
    of_joint = np.unique(limb, return_inverse=True)[1].reshape(-1)
    names = [
        _name(world, (of_joint == k).nonzero()[0]) for k in range(of_joint.max(initial=-1) + 1)
    ]
    return BillboardLimbs(groups, beside, of_joint, names)


def _name(world: WorldView, mine: Ints) -> str:
    parts = list(world.owners.values())
    titles = without_common_start([part.declared.name for part in parts])
    owners = np.unique(world.joints.owner[mine]).tolist()
    part = parts[owners[0]]
    if len(owners) > 1 or len(mine) == part.robot.n:
        return _common_start([titles[owner] for owner in owners])
    within = [int(joint) - part.joints.start for joint in mine]
    limbs = [name for name, rows in part.robot.limb_joints.items() if {*rows} & {*within}]
    name = limbs[0]
    if len(limbs) > 1:
        name = limb_name([part.robot.names[i] for i in within]) or f"{limbs[0]} to {limbs[-1]}"
    return f"{titles[owners[0]]} {name}" if len(parts) > 1 else name


def _common_start(names: list[str]) -> str:
    if len(names) == 1:
        return names[0]
    words = zip(*(name.split("_") for name in names), strict=False)
    same = [column[0] for column in takewhile(lambda column: len({*column}) == 1, words)]
    return "_".join(same) or f"{names[0]} to {names[-1]}"
