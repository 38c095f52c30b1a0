"""Coupled joints, which are driven by another joint through a gear or a tendon.

The position of a coupled joint is offset + ratio * (position of the driving joint). k of the n
joints are independent. Packets, routes and declared poses contain k or n values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import field_validator

from ...base.declaration import Declaration
from ...base.errors import Problem, mismatch
from ...base.frames import Array, Ints


class Coupling(Declaration):
    """The coupling of a joint to another one.

    Attributes:
        to: name of the driving joint, which may itself be coupled.
        ratio: ratio of the angle to that of the driving joint.
        offset: joint value at zero of the driving joint, rad or m.
    """

    to: str
    ratio: float = 1.0
    offset: float = 0.0

    @field_validator("ratio")
    @classmethod
    def _moves(cls, ratio: float) -> float:
        if ratio == 0.0:
            raise mismatch(0, "another number: with 0 the joint would be fixed")
        return ratio


@dataclass(frozen=True, eq=False)
class CoupledJoints:
    """The couplings of n joints to k independent joints.

    Attributes:
        independent: indices (k,) of the independent joints.
        source: index into `independent` for each joint, (n,).
        ratio: ratio of each joint value to that of its independent joint, (n,).
        offset: value of each joint at zero of its independent joint, (n,), rad or m.
    """

    independent: Ints
    source: Ints
    ratio: Array
    offset: Array

    @property
    def n(self) -> int:
        return len(self.source)

    @property
    def k(self) -> int:
        return len(self.independent)

    @property
    def is_coupled(self) -> bool:
        return self.k < self.n

    def positions(self, independent: Array) -> Array:
        """Returns the positions (..., n) of all joints from those (..., k) of independent ones."""
        return np.asarray(independent[..., self.source] * self.ratio + self.offset)

    def rates(self, independent: Array) -> Array:
        return np.asarray(independent[..., self.source] * self.ratio)

    def full(self, key: str, values: Array) -> Array:
        """Returns the values (..., n) of a per-joint input from n or k values.

        Positions and accelerations of coupled joints are computed. Other quantities are NaN.
        """
        if values.shape[-1] != self.k or not self.is_coupled:
            return values
        return np.asarray(values[..., self.source] * self.factors(key) + self.constants(key))

    def factors(self, key: str) -> Array:
        """Returns the factors (n,) from values of independent joints to values of all joints."""
        return self.ratio if key in ("joint_angles", "joint_accelerations") else np.ones(self.n)

    def constants(self, key: str) -> Array:
        """Returns the constants (n,) to be added after multiplication; NaN for unknown values."""
        if key == "joint_angles":
            return self.offset
        known = np.isin(np.arange(self.n), self.independent)
        return np.where(known | (key == "joint_accelerations"), 0.0, np.nan)


def coupling_problems(names: Sequence[str], couplings: Mapping[str, Coupling]) -> list[Problem]:
    """Returns couplings with unknown joints, and cycles."""
    problems = []
    for name, coupling in couplings.items():
        if name not in names:
            problems.append(Problem(name, "no joint", found=name, available=names))
        if coupling.to not in names:
            problems.append(
                Problem(
                    f"{name}.to",
                    "no joint",
                    found=coupling.to,
                    available=[each for each in names if each != name],
                )
            )
    for name in couplings:
        way = [name]
        while way[-1] in couplings and couplings[way[-1]].to not in way:
            way.append(couplings[way[-1]].to)
        if way[-1] in couplings and couplings[way[-1]].to == name == min(way):  # reported once
            circle = " to ".join([*way, name])
            problems.append(Problem(name, f"joints are coupled in a circle: {circle}"))
    return problems


def coupled_joints(names: Sequence[str], couplings: Mapping[str, Coupling]) -> CoupledJoints:
    """Returns the couplings to independent joints. The arguments must be valid."""
    independent = [i for i, name in enumerate(names) if name not in couplings]
    source, ratio, offset = np.zeros(len(names), np.intp), np.ones(len(names)), np.zeros(len(names))
    for i, name in enumerate(names):
        at = name
        while at in couplings:
            # Makes offset and ratio relative to the joint that drives `at`.
            offset[i] += ratio[i] * couplings[at].offset
            ratio[i] *= couplings[at].ratio
            at = couplings[at].to
        source[i] = independent.index(list(names).index(at))
    return CoupledJoints(np.array(independent, np.intp), source, ratio, offset)
