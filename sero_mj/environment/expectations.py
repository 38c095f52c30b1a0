"""`Expectations`: reward for keeping what a scenario expects."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from ..runs.measures import MEASURES
from ..runs.run_log import RunLog
from ..simulate.expect import Expect
from .agent_robot import AgentRobot
from .task import Episode, Task

Array = NDArray[np.float64]


class Expectations(Task):
    """Keeps the measures of a scenario within the bounds that it expects.

    The reward is the mean over what is expected of a measure at this time: 1 while it is within
    its bounds, `below / value` or `value / above` beyond them, and 1 where nothing is expected.
    Expectations of findings, of `rms` and of `mean` are judged at the end alone, by the
    simulation's `outcomes`.
    """

    observed: ClassVar[tuple[str, ...]] = (
        "joint_angles", "joint_velocities", "torques", "external_torques", "target_angles",
        "target_velocities",
    )  # fmt: skip

    def make(self, robot: AgentRobot) -> Episode:
        """The task for a robot, to be begun."""
        return ExpectationsEpisode(robot)


class ExpectationsEpisode:
    """`Expectations` from episode to episode."""

    def __init__(self, robot: AgentRobot) -> None:
        self._robot = robot
        self._expected = [
            each
            for each in robot.simulation.scenario.expect.values()
            if each.measure is not None and each.of in ("max", "min", "final")
        ]

    def begin(self, rng: np.random.Generator) -> None:
        """Nothing is chosen."""

    def advance(self) -> None:
        """The scenario has its own events."""

    def reward(self) -> float:
        """0 to 1, for the state now."""
        simulation = self._robot.simulation
        now = simulation.time
        active = [
            each
            for each in self._expected
            if each.after - 1e-9 <= now <= (np.inf if each.before is None else each.before) + 1e-9
        ]
        if not active:
            return 1.0
        log = RunLog.from_rows(  # the first row is what drift counts from
            simulation.layout, simulation.rows[[0, simulation.step]], simulation.robots
        )
        return float(np.mean([_share(each, log) for each in active]))

    def observation(self) -> dict[str, Array]:
        """Nothing but the signals."""
        return {}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Nothing but the signals."""
        return {}

    def inputs(self) -> dict[str, Array]:
        """Nothing but what the scene shows."""
        return {}


def _share(expect: Expect, log: RunLog) -> float:
    """How far a measure is from what is expected, 1 to 0, in the last row of a log."""
    assert expect.measure is not None
    measure = MEASURES[expect.measure][1]
    found = [1.0]
    for robot in log.robots if expect.robot is None else [expect.robot]:
        values = np.abs(measure(log, robot)[-1])
        if expect.joints and len(values) > 1:
            names = log.robots[robot].names
            values = values[[k for k, name in enumerate(names) if name in expect.joints]]
        if not len(values):
            continue
        if expect.below is not None:
            value = float(values.max())
            found.append(1.0 if value < expect.below else max(expect.below, 0.0) / value)
        if expect.above is not None:
            value = float(values.min() if expect.of == "min" else values.max())
            found.append(1.0 if value > expect.above else value / expect.above)
    return min(found)
