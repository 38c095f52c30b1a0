"""`Simulation`: runs a scenario step by step and logs every step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ..base.errors import DeclarationError, Problem
from ..base.frames import Array
from ..data.receive.structure import Structure
from .control.compiler import Compiler
from .expect import Outcome
from .real_time import RealTimeWatch
from .run import BatchRun
from .run_batch import RunBatch
from .runs.measures import STEP_LATENESS
from .runs.monitor import Finding
from .runs.run_log import ACTUAL, DRIVEN, ESTIMATED, MEASURED, TARGETS, RunLog, event_of
from .scenario import Scenario

MAX_BYTES = 2 * 2**30  # of a log


class Simulation(BatchRun):
    """Simulates a scenario.

    Args:
        seed: seed of the sensor noise; None uses the scenario's seed.
        compiler: cache of compiled models, to share between simulations; None makes a new one.
        by_hand: whether robots can be dragged during the simulation.
        is_live: whether targets and controllers can be changed during the simulation; see
            `LiveControl`.
        batch: batch and row to simulate in, see `together`; None makes a batch of one.

    Attributes:
        robots: robots as simulated, by name; joints are elastic if the run requests it.
        rows: the log, shape (steps + 1, width). Rows after `step` contain only targets.
        times: times of the rows, shape (steps + 1,), s.
        step: number of completed steps.
        error: the error that ended this run of a batch, see `together`; otherwise None.
        drag_force: applies drag forces to links; None unless `by_hand`.
        live: changes targets and controllers; None unless `is_live`.

    Raises:
        DeclarationError: unstable gains, unreachable targets or limits of zero, which are only
            detected when models are compiled and targets are computed.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int | None = None,
        compiler: Compiler | None = None,
        *,
        by_hand: bool = False,
        is_live: bool = False,
        batch: tuple[RunBatch, int] | None = None,
    ) -> None:
        _check_size(scenario)
        if batch is not None:
            self._batch = batch[0]
            super().__init__(scenario, *batch)
            self.check_gains()
            return
        seed = scenario.run.seed if seed is None else seed
        own = RunBatch([scenario], [seed], compiler or Compiler(), raises=True)
        self._batch = own
        super().__init__(scenario, own, 0, by_hand=by_hand, is_live=is_live)
        own.begin([self])
        self.check_gains()

    @classmethod
    def together(
        cls, scenarios: Sequence[Scenario], compiler: Compiler | None = None
    ) -> list[Simulation | DeclarationError]:
        """Returns simulations that advance together: `advance` of one advances all.

        If one fails, its `error` is set and the others continue.

        Args:
            scenarios: scenarios with the same `batch_key`.

        Returns:
            one simulation per scenario, or the error that prevents it.
        """
        seeds = [each.run.seed for each in scenarios]
        batch = RunBatch(scenarios, seeds, compiler or Compiler(), raises=False)
        made: list[Simulation | DeclarationError] = []
        for row, scenario in enumerate(scenarios):
            try:
                made.append(cls(scenario, batch=(batch, row)))
            except DeclarationError as error:
                made.append(error)
        if runs := [each for each in made if isinstance(each, Simulation)]:
            batch.begin(runs)
        return made

    def __reduce__(
        self,
    ) -> tuple[Callable[..., Simulation], tuple[Scenario, Array, int, bool, bool]]:
        seed, by_hand = self.plant.sensors.seed, self.drag_force is not None
        return _begun_again, (self.scenario, self._start, seed, by_hand, self.live is not None)

    def restart(self, joint_angles: Array, seed: int) -> None:
        """Restarts with other joint angles and noise. Payloads and frictions stay as they are.

        Args:
            joint_angles: joint angles of all robots, shape (n,), rad or m.
        """
        self._batch.restart(joint_angles, seed)
        self.plan(joint_angles)
        self._batch.begin([self])

    @property
    def about(self) -> str:
        return f"simulation of {self.scenario.name}"

    @property
    def structure(self) -> Structure:
        """Structure of a log row as a packet."""
        return self.layout.structure

    @property
    def steps(self) -> int:
        """Number of steps of the run."""
        return len(self.rows) - 1

    @property
    def time(self) -> float:
        """Simulated time in seconds."""
        return float(self.rows[self.step, 0])

    @property
    def is_done(self) -> bool:
        return self.step >= self.steps

    def run(self, chunk: int = 1000) -> Iterator[tuple[int, int]]:
        """Runs to the end and yields the range of new rows after every `chunk` steps.

        Raises:
            SimulationError: the run cannot continue. Earlier rows are in the log.
        """
        first = 0 if self.step == 0 else self.step + 1
        watch = RealTimeWatch(self.scenario.name)
        while not self.is_done:
            try:
                self.advance(min(self.step + chunk, self.steps))
            finally:
                if self.step >= first:
                    yield first, self.step + 1
            first = self.step + 1
            watch.update(self.time, self._late)
        watch.finish(self.time, self._late)

    @property
    def _late(self) -> float:
        events = (event_of(name, STEP_LATENESS) for name in self.robots)
        late = [self.rows[self.step, self.layout.columns[event]] for event in events
                if event in self.layout.columns]  # fmt: skip
        return max((float(each[0]) for each in late), default=0.0)

    def advance(self, to_step: int) -> None:
        """Simulates up to a step.

        Each step applies, in this order: due disturbances and faults; each robot's controller and
        its torque limits; faulty drive gains, joint torque control and motor limits; the plant with
        pushes, physics and sensors, once or several times; the log. The external torques are
        estimated for several steps at once.

        Raises:
            SimulationError: the run cannot continue, and the log ends with the previous step; or a
                joint exceeds `run.runaway_speed`, and the log ends with this step.
        """
        try:
            self._batch.advance(min(to_step, self.steps))
        except BaseException:
            self.close()
            raise
        if self.is_done:
            self.close()

    def drop_oldest(self, keep: int) -> int:
        """Discards the oldest rows of the log to make room for new ones.

        Args:
            keep: minimum number of rows to keep.

        Returns:
            number of discarded rows.
        """
        dropped = max(self.step + 1 - keep, 0) // self.observed_every * self.observed_every
        if not dropped:
            return 0
        kept, timestep = self.step + 1 - dropped, self.scenario.run.timestep
        self.rows[:kept] = self.rows[dropped : self.step + 1]
        self.rows[kept:] = self.rows[kept - 1]
        self.times = self.times + dropped * timestep
        self.rows[:, 0] = self.times
        self.step -= dropped
        if self.drag_force is not None:
            self.drag_force.drop_oldest(dropped, kept)
        return dropped

    @property
    def log(self) -> RunLog:
        """The log up to now. Its signals are views."""
        rows = self.rows[: self.step + 1]
        return RunLog.from_rows(self.layout, rows, self.robots, name=self.scenario.name)

    def findings(self) -> list[Finding]:
        """Returns the faults that the monitor detects in the log up to now."""
        return self.scenario.monitor.find(self.log)

    def outcomes(self) -> list[Outcome]:
        """Returns the outcome of each expectation."""
        log, findings = self.log, self.findings()
        return [
            expect.judge(name, log, findings, self.scenario)
            for name, expect in self.scenario.expect.items()
        ]


def _begun_again(
    scenario: Scenario, start: Array, seed: int, by_hand: bool, is_live: bool
) -> Simulation:
    simulation = Simulation(scenario, seed, by_hand=by_hand, is_live=is_live)
    if not np.array_equal(start, simulation._start):
        simulation.restart(start, seed)
    return simulation


def _check_size(scenario: Scenario) -> None:
    joints = sum(robot.n for robot in scenario.scene.robots.values())
    signals = len((*MEASURED, *ACTUAL, *DRIVEN, *TARGETS, *ESTIMATED))
    size = 8 * (scenario.run.steps + 1) * signals * joints
    if size > MAX_BYTES:
        found = f"found {scenario.run.steps} steps, a log of {size / 2**30:.1f} GiB"
        message = f"{found}; expected at most {MAX_BYTES / 2**30:.0f} GiB"
        raise DeclarationError(scenario.scene.located([Problem("run.duration", message)]))
