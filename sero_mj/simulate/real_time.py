"""Real time that a run misses: warnings while it happens and at the end, and numbers of its log."""

from __future__ import annotations

import logging
import time as clock
from dataclasses import dataclass

from .runs.measures import MEASURES, STEP_LATENESS
from .runs.run_log import RunLog, event_of

log = logging.getLogger(__name__)

_LATE = 0.1  # s behind real time that are reported
_EVERY = 5.0  # s between two warnings


@dataclass(frozen=True)
class RealTime:
    """The real time of a robot in a run.

    Attributes:
        factor: simulated time divided by the time that it took.
        max_lateness: how late a step began, at most, s.
    """

    factor: float
    max_lateness: float


def real_time_of(log: RunLog) -> dict[str, RealTime]:
    """Returns the real time of the robots that were controlled in real time, by name."""
    found = {}
    for robot in log.robots:
        late = log.signals.get(event_of(robot, STEP_LATENESS))
        if late is not None and late.any():  # in lockstep it is zero
            factor = MEASURES["real_time_factor"][1](log, robot)
            found[robot] = RealTime(float(factor[-1, 0]), float(late.max()))
    return found


class RealTimeWatch:
    """Warns of a run that falls behind real time, at most every 5 s."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._known = 0.0  # s behind real time that was warned of
        self._warned = -_EVERY

    def update(self, time: float, late: float) -> None:
        """Warns if the run has fallen further behind.

        Args:
            time: simulated, s.
            late: how far behind real time it is, s.
        """
        self._known = min(self._known, late)
        now = clock.monotonic()
        if late - self._known > _LATE and now - self._warned >= _EVERY:
            log.warning("%s is late: %s", self._name, _took(time, late))
            self._known, self._warned = late, now

    def finish(self, time: float, late: float) -> None:
        """Warns if the run has ended behind real time; arguments as of `update`."""
        if late > _LATE:
            log.warning("%s was late: %s", self._name, _took(time, late))


def _took(time: float, late: float) -> str:
    total = time + late
    return f"{time:.4g} s took {total:.4g} s: {time / total:.2g} times real time"
