"""Finite ranges of joints for sliders, example motions and learning.

Position limits may be missing, infinite, or placeholders, such as 1e6 m in a URDF file, because
URDF requires limits. The simulation uses the declared limits. Sliders, random poses and actions of
agents need finite ranges.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.frames import Array
from ..importers.robot_tree import NO_LIMIT
from .couplings import CoupledJoints

REVOLUTE, PRISMATIC = np.pi, 1.0  # half ranges of joints without limits, rad and m
_MIN_SHARE = 0.01  # fraction of the range of a driving joint that its coupled joints must allow


def plausible_limits(position_limits: Array | None, n: int) -> Array:
    """Replaces missing position limits and placeholders by infinity.

    A limit of 1000 rad or m (`NO_LIMIT`) or more is a placeholder. Returns limits, shape (n, 2).
    """
    if position_limits is None:
        return np.tile([-np.inf, np.inf], (n, 1))
    far = np.abs(position_limits) >= NO_LIMIT
    return np.where(far, [-np.inf, np.inf], position_limits)


def independent_limits(limits: Array, coupled: CoupledJoints) -> Array:
    """Returns limits within which independent and coupled joints are in range, shape (k, 2).

    The limits of coupled joints are ignored if they allow less than 1 % of the driving joint's
    range.
    """
    own = limits[coupled.independent]
    found = own.copy()
    for joint, source in enumerate(coupled.source.tolist()):
        low, high = np.sort((limits[joint] - coupled.offset[joint]) / coupled.ratio[joint])
        found[source] = max(found[source, 0], low), min(found[source, 1], high)
    width = np.ptp(own, axis=1)
    least = np.where(np.isfinite(width), _MIN_SHARE * width, 0.0)
    is_wrong = found[:, 1] - found[:, 0] <= least
    return np.where(is_wrong[:, None], own, found)


def display_ranges(
    position_limits: Array | None, types: Sequence[str], home: Array, coupled: CoupledJoints
) -> Array:
    """Returns finite lower and upper limits of all joints, shape (n, 2), rad or m.

    A missing limit is replaced by ±π rad for a revolute joint and by ±1 m for a prismatic joint. If
    the other limit or the home position is outside this range, the replacement is π rad or 1 m away
    from it. The range of a driving joint respects the limits of its coupled joints.
    """
    limits = plausible_limits(position_limits, len(types))
    if not coupled.is_coupled:
        return _finite(limits, types, home)
    free = coupled.independent
    ranges = _finite(independent_limits(limits, coupled), [types[i] for i in free], home[free])
    return np.sort(coupled.positions(ranges.T).T, axis=1)


def _finite(limits: Array, types: Sequence[str], home: Array) -> Array:
    low, high = limits.T
    wide = np.array([REVOLUTE if kind == "revolute" else PRISMATIC for kind in types])
    no_low, no_high = np.isinf(low), np.isinf(high)
    centre = np.where(np.abs(home) > wide, home, 0.0)
    lower = np.minimum(centre, np.where(no_high, centre, high)) - wide
    upper = np.maximum(centre, np.where(no_low, centre, low)) + wide
    return np.stack([np.where(no_low, lower, low), np.where(no_high, upper, high)], axis=1)
