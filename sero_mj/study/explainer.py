"""`Explainer`: says what explains the differences that `compare` finds.

A package adds one by an entry point in the group `sero_mj.explainers`. The first one is asked;
without any, differences are compared and not explained.
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
    """Explains differences of torques. Objects are made without arguments."""

    @abstractmethod
    def of_two(
        self, a: RunLog, b: RunLog, robots: tuple[str, str], offset: float
    ) -> list[Explanation]:
        """Returns what explains the torques of A less those of B.

        Raises:
            UsageError: nothing can be said of them.
        """

    @abstractmethod
    def of_one(self, run: RunLog, robot: str) -> tuple[list[Explanation], list[str]]:
        """Returns what explains commanded less measured torques, and lines about how."""

    @abstractmethod
    def with_model(self, run: RunLog, robot: str) -> tuple[Pair, list[Explanation], list[str]]:
        """Compares a run with the robot's model in the same motion.

        Returns:
            both; what explains the difference of their torques; lines about how.

        Raises:
            UsageError: the robot has no model, or the run no torques.
        """


def find_explainer() -> Explainer | None:
    """Returns the installed explainer; None without."""
    found: Explainer | None = load_first(EXPLAINERS, Explainer)
    return found


def differing(pair: Pair, found: Sequence[Explanation]) -> list[Explanation]:
    """Returns the explanations of joints whose torques differ at all.

    Where measured torques are the commanded ones, there is nothing to explain.
    """
    differs = (pair.difference("torques") != 0).any(axis=0)
    joints = {joint for joint, is_one in zip(pair.robot.names, differs, strict=True) if is_one}
    return [each for each in found if joints & {*each.joints}]
