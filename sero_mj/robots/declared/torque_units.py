"""Display units of torques and forces.

All revolute joints of a robot have the same unit, and so have all prismatic joints. If the largest
torque or force is between 0.1 and 10,000, the unit is Nm or N. Otherwise, it has the prefix u, m or
k, so that the largest value is between 1 and 999. Files, packets and messages about single values
always use Nm and N.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...base.frames import Array, Bools

_PLAIN = 0.1, 1e4  # range without a prefix, Nm or N
_PREFIXES = (1e3, "k"), (1e-3, "m"), (1e-6, "u")  # u instead of µ, because billboards use ASCII


class TorqueUnit(NamedTuple):
    """A display unit of torques or forces.

    Attributes:
        factor: conversion factor from Nm or N to this unit.
        name: name of the unit, for example `mNm`.
    """

    factor: float
    name: str


NM, N = TorqueUnit(1.0, "Nm"), TorqueUnit(1.0, "N")


def torque_units(largest: Array, revolute: Bools | Sequence[bool]) -> list[TorqueUnit]:
    """Returns the display units of n joints, given their largest torques (n,), in Nm or N."""
    turns = np.asarray(revolute, bool)
    known = np.where(np.isfinite(largest), largest, 0.0)
    of_turning = _prefixed(NM.name, float(known[turns].max(initial=0.0)))
    of_sliding = _prefixed(N.name, float(known[~turns].max(initial=0.0)))
    return [of_turning if each else of_sliding for each in turns.tolist()]


def _prefixed(unit: str, largest: float) -> TorqueUnit:
    low, high = _PLAIN
    if largest <= 0.0 or low <= largest < high:
        return TorqueUnit(1.0, unit)
    fitting = [(size, prefix) for size, prefix in _PREFIXES if largest >= size]
    size, prefix = (fitting or _PREFIXES[-1:])[0]
    return TorqueUnit(1.0 / size, prefix + unit)
