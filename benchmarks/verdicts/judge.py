"""Decides which verdicts are right."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any, Protocol

Named = tuple[str, str, str]  # place, kind, part: ("A2", "gain", "torque sensor")
UNEXPLAINED = "unexplained"


class Verdict(Protocol):
    """What a verdict of the product must have."""

    @property
    def joint(self) -> str: ...
    @property
    def kind(self) -> Any: ...
    @property
    def part(self) -> Any: ...


@dataclass(frozen=True)
class Truth:
    """What is right about a run.

    Attributes:
        right: verdicts that are true statements about the robot or its log.
        visible: joints at which the fault changes residuals.
        drives: joints at which the motor side does not match the declared parameters, because
            motor inertia and friction are estimated.
    """

    right: frozenset[Named] = frozenset()
    visible: frozenset[str] = frozenset()
    drives: frozenset[str] = frozenset()

    def of_undeclared(self, joints: tuple[str, ...]) -> Truth:
        """Returns the truth for a robot whose motor inertia and friction are not declared.

        Its true friction differs from the estimate, so `friction` is right at every joint.
        """
        friction = {(joint, "friction", "joint") for joint in joints}
        return Truth(self.right | friction, self.visible, self.drives | frozenset(joints))


def is_right(verdict: Verdict, truth: Truth) -> bool:
    """Whether a verdict is right; this is the only judgment of the benchmark.

    - A verdict with a name is right if its place, kind and part are one of `truth.right`. Sizes and
      times are not judged.
    - `unexplained` is right at a joint where the fault changes residuals, also for faults that have
      a name. At a joint with estimated drive parameters, it is right on the drive side.
    - In a run without fault, every verdict is wrong.
    """
    if verdict.kind == UNEXPLAINED:
        is_drive = verdict.part == "drive" and verdict.joint in truth.drives
        return verdict.joint in truth.visible or is_drive
    return (verdict.joint, verdict.kind, verdict.part) in truth.right


def wilson(right: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Returns the Wilson interval of a share, by default at 95 %."""
    if count == 0:
        return 0.0, 1.0
    share, square = right / count, z * z
    middle = (share + square / (2 * count)) / (1 + square / count)
    half = z * sqrt(share * (1 - share) / count + square / (4 * count**2)) / (1 + square / count)
    return max(middle - half, 0.0), min(middle + half, 1.0)
