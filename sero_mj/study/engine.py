"""What runs the variants of a sweep: `Work` is handed to an `Engine`, which yields their results.

`workers.Processes` runs them on this machine, `cluster.Cluster` on workers of Dask. This file
imports little: every new process reads it.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

Variant = tuple[int, Mapping[str, Any]]  # its number and values
Result = tuple[int, dict[str, Any]]  # its number and outcomes, by column

_ENOUGH = 24  # variants that are run together; what a step costs however many is little of it then
KILLED = "its process was killed, or ran out of memory; expected an answer"


def killed() -> dict[str, Any]:
    """The outcomes of a variant whose process ended."""
    return {"held": False, "error": KILLED, "ended": 0.0}


@dataclass(frozen=True)
class Work:
    """Variants to be run.

    Attributes:
        file: the scenario's.
        fixed: dotted keys that are set in all of them.
        variants: in their order.
        most: how many may be run together: their logs need memory.
    """

    file: Path
    fixed: Mapping[str, Any]
    variants: Sequence[Variant]
    most: int = 1

    def size(self, left: int, workers: int) -> int:
        """How many are run together: few enough for memory, and for results to come meanwhile.

        Args:
            left: how many are still to be run.
            workers: how many take some of them.
        """
        workers = max(workers, 1)
        enough = min(-(-left // workers), _ENOUGH)
        return min(self.most, max(-(-left // (2 * workers)), enough, 1))


class Engine(Protocol):
    """Runs variants; nothing else knows where.

    Attributes:
        workers: how many run variants at the moment.
    """

    workers: int

    def run(self, work: Work) -> Generator[Result]:
        """Yields the results of all variants, in any order, as they are ready.

        A variant that cannot be run, or ends the process that runs it, has an `error`. Closing the
        generator ends what is still running.
        """
