"""Coupled joints, which another joint drives through a gear or a tendon.

The position of a coupled joint is offset + ratio * (position of the driving joint). Of n joints, k
are independent. Packets, routes and declared poses contain either k or n values.
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
    """The linear relation between the positions of a coupled joint and its driving joint.

    Attributes:
        to: name of the driving joint, which may itself be coupled.
        ratio: motion of the coupled joint per motion of the driving joint.
        offset: position of the coupled joint if the driving joint is at zero, rad or m.
    """

    to: str
    ratio: float = 1.0
    offset: float = 0.0

    @field_validator("ratio")
    @classmethod
    def _moves(cls, ratio: float) -> float:
        if ratio == 0.0:
            raise mismatch(0, "a nonzero ratio, because 0 would fix the joint")
        return ratio


@dataclass(frozen=True, eq=False)
class CoupledJoints:
    """The couplings of the n joints of a robot to its k independent joints, as arrays.

    Attributes:
        independent: indices of the independent joints, shape (k,).
        source: index into `independent` for each joint, shape (n,).
        ratio: motion of each joint per motion of its independent joint, shape (n,).
        offset: position of each joint if its independent joint is at zero, shape (n,), rad or m.
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
        """Converts positions of independent joints (..., k) to positions of all joints (..., n)."""
        return np.asarray(independent[..., self.source] * self.ratio + self.offset)

    def rates(self, independent: Array) -> Array:
        return np.asarray(independent[..., self.source] * self.ratio)

    def full(self, key: str, values: Array) -> Array:
        """Returns the values of all joints, shape (..., n), for an input with n or k values.

        Positions and accelerations of coupled joints are computed. Other quantities become NaN.
        """
        if values.shape[-1] != self.k or not self.is_coupled:
            return values
        return np.asarray(values[..., self.source] * self.factors(key) + self.constants(key))

    def factors(self, key: str) -> Array:
        """Returns the factors that `full` applies to values of independent joints, shape (n,)."""
        return self.ratio if key in ("joint_angles", "joint_accelerations") else np.ones(self.n)

    def constants(self, key: str) -> Array:
        """Returns the constants that `full` adds to the products, shape (n,), NaN if unknown."""
        if key == "joint_angles":
            return self.offset
        known = np.isin(np.arange(self.n), self.independent)
        return np.where(known | (key == "joint_accelerations"), 0.0, np.nan)


def coupling_problems(names: Sequence[str], couplings: Mapping[str, Coupling]) -> list[Problem]:
    """Returns a problem for each unknown joint name, and for each cycle of couplings."""
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
        if way[-1] in couplings and couplings[way[-1]].to == name == min(way):  # once per cycle
            circle = " to ".join([*way, name])
            problems.append(Problem(name, f"joints are coupled in a cycle: {circle}"))
    return problems


def coupled_joints(names: Sequence[str], couplings: Mapping[str, Coupling]) -> CoupledJoints:
    """Resolves chains of couplings to independent joints. `couplings` must be valid."""
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
