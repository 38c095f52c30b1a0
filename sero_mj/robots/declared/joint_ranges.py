"""Finite ranges of joints, for whatever needs one: sliders, example motions, learning.

Limits of position may be missing, infinite, or placeholders such as the 1e6 m of URDFs that must
declare some. The physics takes them as declared; a slider, a random pose or an action cannot.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...base.frames import Array
from ..importers.robot_tree import NO_LIMIT

REVOLUTE, PRISMATIC = np.pi, 1.0  # rad, m; to either side of zero, where there is no limit


def plausible_limits(position_limits: Array | None, n: int) -> Array:
    """Returns the position limits (n, 2), rad or m, infinite where missing or a placeholder.

    A placeholder is a limit of `NO_LIMIT`, 1000 rad or m, or more.
    """
    if position_limits is None:
        return np.tile([-np.inf, np.inf], (n, 1))
    far = np.abs(position_limits) >= NO_LIMIT
    return np.where(far, [-np.inf, np.inf], position_limits)


def display_ranges(position_limits: Array | None, types: Sequence[str], home: Array) -> Array:
    """Returns a finite range of every joint, (n, 2), lower and upper, rad or m.

    It consists of the plausible limits. A missing limit is replaced by -π or π rad for a revolute
    joint and by -1 or 1 m for a prismatic one, or is this far from the other limit or from the
    home position if these are outside that range.

    Args:
        position_limits: (n, 2), rad or m; may be infinite or None.
        types: `revolute` or `prismatic`, of every joint.
        home: (n,), rad or m.
    """
    low, high = plausible_limits(position_limits, len(types)).T
    wide = np.array([REVOLUTE if kind == "revolute" else PRISMATIC for kind in types])
    no_low, no_high = np.isinf(low), np.isinf(high)
    centre = np.where(np.abs(home) > wide, home, 0.0)
    lower = np.minimum(centre, np.where(no_high, centre, high)) - wide
    upper = np.maximum(centre, np.where(no_low, centre, low)) + wide
    return np.stack([np.where(no_low, lower, low), np.where(no_high, upper, high)], axis=1)
