"""`Explainer`: explains the differences that `compare` finds.

A package adds one by an entry point in the group `sero_mj.explainers`. The first one is used.
Without any, `compare` reports differences without explanations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..base.plugins import EXPLAINERS, load_first

if TYPE_CHECKING:
    from ..simulate.runs.run_log import RunLog
    from .align import Pair
    from .explanation import Explanation


class Explainer(ABC):
    """Explains differences of torques. It is created without arguments."""

    @abstractmethod
    def of_two(
        self, a: RunLog, b: RunLog, robots: tuple[str, str], offset: float
    ) -> list[Explanation]:
        """Explains the torques of A minus those of B.

        Raises:
            UsageError: the runs cannot be analyzed.
        """

    @abstractmethod
    def of_one(self, run: RunLog, robot: str) -> tuple[list[Explanation], list[str]]:
        """Explains commanded minus measured torques; also returns lines about the method."""

    @abstractmethod
    def with_model(self, run: RunLog, robot: str) -> tuple[Pair, list[Explanation], list[str]]:
        """Compares a run with the robot's model in the same motion.

        Returns the pair, the explanations of its torque difference, and lines about the method.

        Raises:
            UsageError: the robot has no model, or the run has no torques.
        """


def find_explainer() -> Explainer | None:
    """Returns the installed explainer, or None."""
    found: Explainer | None = load_first(EXPLAINERS, Explainer)
    return found


def differing(pair: Pair, found: Sequence[Explanation]) -> list[Explanation]:
    """Returns the explanations for joints whose torques differ at all."""
    differs = (pair.difference("torques") != 0).any(axis=0)
    joints = {joint for joint, is_one in zip(pair.robot.names, differs, strict=True) if is_one}
    return [each for each in found if joints & {*each.joints}]
