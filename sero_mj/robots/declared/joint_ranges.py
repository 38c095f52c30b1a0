"""Finite ranges of joints, for whatever needs one: sliders, example motions, learning.

Limits of position may be missing, infinite, or placeholders such as the 1e6 m of URDFs that must
declare some. The physics takes them as declared; a slider, a random pose or an action cannot.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.frames import Array
from ..importers.robot_tree import NO_LIMIT
from .couplings import CoupledJoints

REVOLUTE, PRISMATIC = np.pi, 1.0  # rad, m; to either side of zero, where there is no limit
_LEAST = 0.01  # of a driving joint's own range, that its coupled joints leave


def plausible_limits(position_limits: Array | None, n: int) -> Array:
    """Returns the position limits (n, 2), rad or m, infinite where missing or a placeholder.

    A placeholder is a limit of `NO_LIMIT`, 1000 rad or m, or more.
    """
    if position_limits is None:
        return np.tile([-np.inf, np.inf], (n, 1))
    far = np.abs(position_limits) >= NO_LIMIT
    return np.where(far, [-np.inf, np.inf], position_limits)


def independent_limits(limits: Array, coupled: CoupledJoints) -> Array:
    """Returns limits of the independent joints, (k, 2), that satisfy those of coupled ones as well.

    If these leave a joint less than a hundredth of its own range, they are wrong, and ignored.
    """
    own = limits[coupled.independent]
    found = own.copy()
    for joint, source in enumerate(coupled.source.tolist()):
        low, high = np.sort((limits[joint] - coupled.offset[joint]) / coupled.ratio[joint])
        found[source] = max(found[source, 0], low), min(found[source, 1], high)
    width = np.ptp(own, axis=1)
    least = np.where(np.isfinite(width), _LEAST * width, 0.0)
    is_wrong = found[:, 1] - found[:, 0] <= least
    return np.where(is_wrong[:, None], own, found)


def display_ranges(
    position_limits: Array | None, types: Sequence[str], home: Array, coupled: CoupledJoints
) -> Array:
    """Returns a finite range of every joint, (n, 2), lower and upper, rad or m.

    It consists of the plausible limits. A missing limit is replaced by -π or π rad for a revolute
    joint and by -1 or 1 m for a prismatic one, or is this far from the other limit or from the home
    position if these are outside that range. The range of a driving joint satisfies the limits of
    its coupled joints, whose ranges follow from it.
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
