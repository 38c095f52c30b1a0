"""Warnings about runs that fall behind real time, and the delays in their logs."""

from __future__ import annotations

import logging
import time as clock
from dataclasses import dataclass

from .runs.measures import MEASURES, STEP_LATENESS
from .runs.run_log import RunLog, event_of

log = logging.getLogger(__name__)

_LATE = 0.1  # minimum delay that causes a warning, s
_EVERY = 5.0  # minimum time between two warnings, s


@dataclass(frozen=True)
class RealTime:
    """Real-time performance of a robot's controller in a run.

    Attributes:
        factor: simulated time divided by elapsed time.
        max_lateness: maximum delay behind real time at the beginning of a step, s.
    """

    factor: float
    max_lateness: float


def real_time_of(log: RunLog) -> dict[str, RealTime]:
    """Returns the real-time performance of each robot that was controlled in real time."""
    found = {}
    for robot in log.robots:
        late = log.signals.get(event_of(robot, STEP_LATENESS))
        if late is not None and late.any():  # zero in lockstep
            factor = MEASURES["real_time_factor"][1](log, robot)
            found[robot] = RealTime(float(factor[-1, 0]), float(late.max()))
    return found


class RealTimeWatch:
    """Warns about a run that falls behind real time, at most every 5 s."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._known = 0.0  # last reported delay, s
        self._warned = -_EVERY

    def update(self, time: float, late: float) -> None:
        """Warns if the delay has increased by more than 0.1 s since the last warning.

        Args:
            time: simulated time, s.
            late: delay behind real time, s.
        """
        self._known = min(self._known, late)
        now = clock.monotonic()
        if late - self._known > _LATE and now - self._warned >= _EVERY:
            log.warning("%s is late: %s", self._name, _took(time, late))
            self._known, self._warned = late, now

    def finish(self, time: float, late: float) -> None:
        """Warns if the run has ended behind real time. The arguments are those of `update`."""
        if late > _LATE:
            log.warning("%s was late: %s", self._name, _took(time, late))


def _took(time: float, late: float) -> str:
    total = time + late
    return f"{time:.4g} s took {total:.4g} s: {time / total:.2g} times real time"
