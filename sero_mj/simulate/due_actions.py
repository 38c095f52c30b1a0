"""`DueActions`: actions scheduled at steps of a run."""

from __future__ import annotations

import math
from collections.abc import Callable


class DueActions:
    """Actions by the step at which they are due, in the order in which they were added.

    Args:
        timestep: s.
    """

    def __init__(self, timestep: float) -> None:
        self._timestep = timestep
        self._due: list[tuple[int, Callable[[], None]]] = []
        self._next = 0

    def add(self, time: float, action: Callable[[], None]) -> None:
        """Plans an action for a time, s."""
        self._due.append((max(round(time / self._timestep), 0), action))
        self._due.sort(key=lambda entry: entry[0])

    @property
    def next(self) -> float:
        """The row at which the next action is due; infinite if none is left."""
        return self._due[self._next][0] if self._next < len(self._due) else math.inf

    def act(self, k: int) -> None:
        """Runs the actions that are due at row k, before the step after it."""
        while self._next < len(self._due) and self._due[self._next][0] <= k:
            self._due[self._next][1]()
            self._next += 1
