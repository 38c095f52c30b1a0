"""`Simulation`: runs a scenario step by step, with a log of everything."""

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

MAX_BYTES = 2 * 2**30  # of a log; longer runs need a longer timestep


class Simulation(BatchRun):
    """Runs a scenario.

    Args:
        seed: of the noise; the scenario's when None.
        compiler: that remembers what it has compiled, for those who run many; a new one when None.
        by_hand: whether robots can be pulled by hand while it runs.
        is_live: whether targets and controllers are changed while it runs, see `LiveControl`.
        batch: that it is simulated in, and its row there, see `together`; one of its own when None.

    Attributes:
        robots: by name, as they are simulated: with elastic joints where the run asks for them.
        plant: the simulated robots.
        layout: of the log's rows.
        rows: (steps + 1, width), the log; rows behind `step` hold targets only.
        times: (steps + 1,), of the rows, s.
        step: number of steps that have been made.
        error: what has ended it, if it is simulated `together` with others; else None.
        drag_force: pulls robots by hand; None without.
        live: changes targets and controllers; None without.

    Raises:
        DeclarationError: what only shows when robots are compiled and targets computed: unstable
            gains, unreachable targets, limits of zero.
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
        """Simulations that are advanced together: one's `advance` is that of all.

        Where one cannot go on it has its `error`, and the others go on.

        Args:
            scenarios: with one `batch_key`.

        Returns:
            in their order; where one cannot be run, why.
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
        """Pickles what is run, so that it runs anew, to the same log, where it is unpickled."""
        seed, by_hand = self.plant.sensors.seed, self.drag_force is not None
        return _begun_again, (self.scenario, self._start, seed, by_hand, self.live is not None)

    def restart(self, joint_angles: Array, seed: int) -> None:
        """Restarts with other joint angles and noise; changes of the plant persist.

        Args:
            joint_angles: (n,), of all robots together, rad or m.
        """
        self._batch.restart(joint_angles, seed)
        self.plan(joint_angles)
        self._batch.begin([self])

    @property
    def about(self) -> str:
        return f"simulation of {self.scenario.name}"

    @property
    def structure(self) -> Structure:
        """Of a row of the log as a packet."""
        return self.layout.structure

    @property
    def steps(self) -> int:
        """How many steps the run has."""
        return len(self.rows) - 1

    @property
    def time(self) -> float:
        """Until when it has been simulated, s."""
        return float(self.rows[self.step, 0])

    @property
    def is_done(self) -> bool:
        """Whether the run is over."""
        return self.step >= self.steps

    def run(self, chunk: int = 1000) -> Iterator[tuple[int, int]]:
        """Runs to the end, and tells after every so many steps which rows are new.

        Raises:
            SimulationError: it cannot go on; names the joint and the time. What came before is in
                the log.
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
        """Simulates until a step.

        In every step, in this order: disturbances and faults that begin or end; each robot's
        controller, from what its sensors read, then its torque limits; the drives, with gains of
        faulty controllers, joint torque control and the motors' limits; the plant, once or several
        times, with pushes, physics and sensors; the log. The observer takes several steps at once.

        Raises:
            SimulationError: it cannot go on, and the log ends with the step before; or a joint has
                run away, and the log ends there.
        """
        try:
            self._batch.advance(min(to_step, self.steps))
        except BaseException:
            self.close()
            raise
        if self.is_done:
            self.close()

    def drop_oldest(self, keep: int) -> int:
        """Discards all but the last rows of the log, which makes room for new ones.

        Args:
            keep: how many rows, at least; a few more are kept.

        Returns:
            how many were forgotten.
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
        """The log until now; its signals are views."""
        rows = self.rows[: self.step + 1]
        return RunLog.from_rows(self.layout, rows, self.robots, name=self.scenario.name)

    def findings(self) -> list[Finding]:
        """What the monitor finds in the log until now."""
        return self.scenario.monitor.find(self.log)

    def outcomes(self) -> list[Outcome]:
        """Whether what was expected held."""
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
        message = f"{found}; expected up to {MAX_BYTES / 2**30:.0f} GiB"
        raise DeclarationError(scenario.scene.located([Problem("run.duration", message)]))
