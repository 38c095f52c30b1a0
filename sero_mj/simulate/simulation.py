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

MAX_BYTES = 2 * 2**30  # maximum size of a log


class Simulation(BatchRun):
    """One run of a scenario, which is simulated step by step.

    Args:
        seed: seed of the sensor noise (default: the scenario's seed).
        compiler: cache of compiled models that simulations can share (default: a new cache).
        by_hand: whether robots can be dragged during the simulation.
        is_live: whether targets and controllers can be changed during the simulation; see
            `LiveControl`.
        batch: batch and row index of the run; set by `together`.

    Attributes:
        robots: simulated robots by name, with elastic joints if the run requests them.
        rows: rows of the log, shape (steps + 1, width). Rows after `step` contain only values that
            are known in advance, such as targets.
        times: times of the rows, shape (steps + 1,), s.
        step: number of completed steps.
        error: error that ended this run of a batch, or None; see `together`.
        drag_force: object that applies drag forces to links; None unless `by_hand`.
        live: object that changes targets and controllers; None unless `is_live`.

    Raises:
        DeclarationError: gains are unstable, targets are unreachable or limits are zero.
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
        """Returns simulations that advance together when one of them advances.

        If a simulation fails, its `error` is set and the others continue.

        Args:
            scenarios: scenarios with the same `batch_key`.

        Returns:
            for each scenario, its simulation or the error that prevents it.
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
        return _restarted, (self.scenario, self._start, seed, by_hand, self.live is not None)

    def restart(self, joint_angles: Array, seed: int) -> None:
        """Restarts the run at rest. Attached payloads and changed friction remain.

        Args:
            joint_angles: initial joint angles of all robots, shape (n,), rad or m.
            seed: seed of the sensor noise.
        """
        self._batch.restart(joint_angles, seed)
        self.plan(joint_angles)
        self._batch.begin([self])

    @property
    def about(self) -> str:
        return f"simulation of {self.scenario.name}"

    @property
    def structure(self) -> Structure:
        """Packet structure that describes a row of the log."""
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
        """Runs to the end, and yields the half-open range of new rows after every `chunk` steps.

        Raises:
            SimulationError: the run cannot continue. The log contains the earlier rows.
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

        Each step starts due disturbances and faults, computes the controllers' limited torques,
        applies faulty drive gains, joint torque control and motor limits, steps the plant once or
        several times, and writes a log row. External torques are estimated for several steps at
        once.

        Raises:
            SimulationError: the run cannot continue (the log ends with the previous step), or a
                joint exceeds `run.runaway_speed` (the log ends with this step).
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
        """Log of the run up to the current step. Its signals are views of `rows`."""
        rows = self.rows[: self.step + 1]
        return RunLog.from_rows(self.layout, rows, self.robots, name=self.scenario.name)

    def findings(self) -> list[Finding]:
        """Returns the faults that the monitor detects in the current log."""
        return self.scenario.monitor.find(self.log)

    def outcomes(self) -> list[Outcome]:
        """Returns the outcome of each expectation."""
        log, findings = self.log, self.findings()
        return [
            expect.judge(name, log, findings, self.scenario)
            for name, expect in self.scenario.expect.items()
        ]


def _restarted(
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
