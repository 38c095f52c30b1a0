"""Coupled joints: joints driven by another one through a gear or a tendon.

A coupled joint is at offset + ratio * (the joint it is coupled to). Of n joints k are independent;
packets, routes and declared poses may have k values or all n.
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
        to: name of the driving joint, which may be coupled itself.
        ratio: its angle over that joint's; 1 for equal angles, -1 for opposite ones.
        offset: its value at zero of that joint, rad or m.
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
    """The couplings of n joints to k independent ones.

    Attributes:
        independent: indices of the independent joints, (k,).
        source: for every joint, its independent joint as an index into `independent`, (n,).
        ratio: of its value to that joint's, (n,); 1 for an independent one.
        offset: its value at zero of that joint, (n,), rad or m.
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
        """Returns the positions of all joints (..., n), from those of the independent (..., k)."""
        return np.asarray(independent[..., self.source] * self.ratio + self.offset)

    def rates(self, independent: Array) -> Array:
        return np.asarray(independent[..., self.source] * self.ratio)

    def full(self, key: str, values: Array) -> Array:
        """Returns a per-joint input (..., n), given it or that of the independent joints (..., k).

        Coupled joints get computed positions and accelerations, and NaN, no data, for anything
        else.
        """
        if values.shape[-1] != self.k or not self.is_coupled:
            return values
        return np.asarray(values[..., self.source] * self.factors(key) + self.constants(key))

    def factors(self, key: str) -> Array:
        """Returns the factors, (n,), from the values of the sources to those of all joints."""
        return self.ratio if key in ("joint_angles", "joint_accelerations") else np.ones(self.n)

    def constants(self, key: str) -> Array:
        """Returns the constants that are then added, (n,); NaN for unknown values."""
        if key == "joint_angles":
            return self.offset
        known = np.isin(np.arange(self.n), self.independent)
        return np.where(known | (key == "joint_accelerations"), 0.0, np.nan)


def coupling_problems(names: Sequence[str], couplings: Mapping[str, Coupling]) -> list[Problem]:
    """Returns couplings of and to joints that do not exist, and cycles."""
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
    """Resolves couplings without problems down to the independent joints."""
    independent = [i for i, name in enumerate(names) if name not in couplings]
    source, ratio, offset = np.zeros(len(names), np.intp), np.ones(len(names)), np.zeros(len(names))
    for i, name in enumerate(names):
        at = name
        while at in couplings:
            # offset and ratio were relative to `at`; now relative to the source of `at`
            offset[i] += ratio[i] * couplings[at].offset
            ratio[i] *= couplings[at].ratio
            at = couplings[at].to
        source[i] = independent.index(list(names).index(at))
    return CoupledJoints(np.array(independent, np.intp), source, ratio, offset)
