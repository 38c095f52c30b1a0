"""`Simulation`: a scenario at work, step by step, with a log of everything."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from ..assemble.scene import Scene
from ..control.compiler import Compiler
from ..control.joint_control import GravityCompensation
from ..control.plan import Plan, make_plan
from ..errors import DeclarationError, Problem, SimulationError
from ..runs.monitor import Finding
from ..runs.run_log import ACTUAL, DRIVEN, ESTIMATED, MEASURED, TARGETS, RunLayout, RunLog, event_of
from .arm import Arm
from .contacts import Contacts
from .expect import Outcome
from .happenings import Happenings
from .plant import Plant
from .scenario import Scenario

Array = NDArray[np.float64]

MOST_BYTES = 2 * 2**30  # of a log; longer runs need a longer timestep


class Simulation:
    """Runs a scenario.

    Args:
        scenario: what to run.
        seed: of the noise; the scenario's when None.
        compiler: that remembers what it has compiled, for those who run many; a new one when None.

    Attributes:
        scenario: as given.
        compiler: as given.
        plant: the simulated robots.
        layout: of the log's rows.
        rows: (steps + 1, width), the log; rows behind `step` hold targets only.
        step: how many steps have been made.

    Raises:
        DeclarationError: what only shows when robots are compiled and targets computed: unstable
            gains, unreachable targets, limits of zero.
    """

    def __init__(
        self, scenario: Scenario, seed: int | None = None, compiler: Compiler | None = None
    ) -> None:
        run = scenario.run
        self.compiler = compiler or Compiler()
        self.scenario = scenario
        self.step = 0
        scene = scenario.scene
        _check_size(scenario)
        if run.elastic is not None:
            for robot in scene.robots.values():
                robot.elastic_joints = run.elastic
        sensors = scenario.make_sensors(run.seed if seed is None else seed)
        # Doubles, arrows and cameras take no part, and would cost time in every step. What is
        # carried is a mass of the flange, and nothing to run into.
        obstacles = scenario.obstacles
        stripped = Scene(
            robots=list(scene.robots.values()),
            objects=obstacles,
            floor=scene.floor,
            name=scene.name,
            file=scene.file,
        )
        self.plant = Plant(self.compiler.world(stripped), sensors, run.timestep)
        self.plant.looks_ahead = False  # controllers have models of their own
        times = np.arange(run.steps + 1, dtype=np.float64) * run.timestep
        plans = self._plans(times)
        self._happenings = Happenings(scenario, self.plant, run.steps)
        others = self._happenings.others()
        self._contacts = None
        if scenario.has_surroundings:
            self._contacts = Contacts(self.plant.world, self.plant.data)
            others |= {event_of(name, "contact_force"): "1V" for name in plans}
        for name, plan in plans.items():
            if plan.flange is not None:
                others[event_of(name, "target_pose")] = "1M"
        targets = tuple(name for name, plan in plans.items() if plan.joints is not None)
        joints = {name: robot.n for name, robot in scene.robots.items()}
        self.layout = RunLayout(joints, targets, others)
        self.rows: Array = np.zeros((len(times), self.layout.width))
        self.rows[:, 0] = times
        self._fill_targets(plans)
        self._happenings.fill(self.layout.columns, self.rows)
        self._commanded: Array = np.zeros(self.plant.n)
        self._driven: Array = np.zeros(self.plant.n)
        self._saturated: Array = np.zeros(self.plant.n)
        self._arms = self._make_arms(plans)
        self._measured_log = self.rows[:, self.layout.block(MEASURED)]
        self._actual_log = self.rows[:, self.layout.block(ACTUAL)]
        self._driven_log = self.rows[:, self.layout.block(DRIVEN)]
        self._estimated_log = self.rows[:, self.layout.block(ESTIMATED)]
        self._measured_log[0] = self.plant.measured.reshape(-1)
        self._actual_log[0] = self.plant.actual.reshape(-1)
        self._driven_log[0, : self.plant.n] = self.plant.actual[2]  # what holds it at rest
        for arm in self._arms:
            arm.observer.update(arm.sensed)

    def _plans(self, times: Array) -> dict[str, Plan]:
        plans, problems = {}, []
        for name, robot in self.scenario.scene.robots.items():
            controller = self.scenario.controllers.get(name, GravityCompensation())
            try:
                law = self.scenario.targets.get(name)
                plans[name] = make_plan(robot, law, controller, times, self.compiler)
            except DeclarationError as error:
                problems += [problem.inside(f"targets.{name}") for problem in error.problems]
        if problems:
            raise DeclarationError(self.scenario.scene.located(problems))
        return plans

    def _make_arms(self, plans: dict[str, Plan]) -> list[Arm]:
        arms, problems, first = [], [], 0
        for name, plan in plans.items():
            n = self.scenario.scene.robots[name].n
            joints = slice(first, first + n)
            first += n
            try:
                arms.append(Arm(name, self.scenario, plan, self.plant, joints, self.compiler))
            except DeclarationError as error:
                problems += [problem.inside(f"controllers.{name}") for problem in error.problems]
        if problems:
            raise DeclarationError(self.scenario.scene.located(problems))
        return arms

    def _fill_targets(self, plans: dict[str, Plan]) -> None:
        columns = self.layout.columns
        for name, plan in plans.items():
            if plan.joints is not None:
                self.rows[:, columns[event_of(name, "target_angles")]] = plan.joints.angles
                self.rows[:, columns[event_of(name, "target_velocities")]] = plan.joints.velocities
            if plan.flange is not None:
                poses = plan.flange.poses.reshape(len(self.rows), 16)
                self.rows[:, columns[event_of(name, "target_pose")]] = poses

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
        while not self.is_done:
            try:
                self.advance(min(self.step + chunk, self.steps))
            finally:
                if self.step >= first:
                    yield first, self.step + 1
            first = self.step + 1

    def advance(self, to_step: int) -> None:
        """Simulates until a step.

        Raises:
            SimulationError: it cannot go on; the log ends with the step before.
        """
        first, stop = self.step + 1, min(to_step, self.steps)
        if first > stop:
            return
        for arm in self._arms:
            arm.plan.load(arm.target, first - 1)
        happenings, k = self._happenings, first
        try:
            while k <= stop:
                happenings.before(k - 1)
                last = min(stop, happenings.next_step)
                if len(self._arms) == 1:
                    self._advance_alone(self._arms[0], k, last)
                else:
                    self._advance_all(k, last)
                k = last + 1
        finally:
            self._observe(first)

    def _advance_alone(self, arm: Arm, first: int, last: int) -> None:
        """The loop for one robot while nothing happens, with nothing looked up twice."""
        happenings, plant, controller = self._happenings, self.plant, arm.controller
        step, torques, sensed, target = plant.step, controller.torques, arm.sensed, arm.target
        moves, looks = arm.plan.moves, arm.has_to_look
        planned = target.planned[: arm.plan.rows.shape[1]]
        grows, is_tampered = happenings.is_growing, happenings.is_tampered
        surrounded = self._contacts is not None or happenings.carries
        data, commanded, asked = plant.data, self._commanded, controller.asked
        measured, is_perfect = plant.measured, plant.sensors.is_perfect
        actual = measured if is_perfect else plant.actual  # what perfect sensors read is what is
        # As bytes, which are made in half the time that a row of an array is written in.
        kept: list[bytes] = []
        keep = kept.extend
        rows = zip(
            range(first, last + 1),
            arm.plan.rows[first - 1 : last] if moves else repeat(None, last + 1 - first),
            self.rows[first - 1 : last, 0].tolist(),
            strict=True,
        )
        try:
            for k, planned_row, sensed.time in rows:
                if grows:
                    happenings.before(k - 1)
                if looks:
                    arm.sense()
                if moves:
                    planned[...] = planned_row
                torques(sensed, target, commanded)
                if is_tampered:
                    step(np.multiply(commanded, happenings.gains, self._driven))
                else:
                    step(commanded)
                keep((commanded.tobytes(), asked.tobytes(), actual.tobytes()))
                if not is_perfect:
                    keep((measured.tobytes(),))
                if surrounded and (data.ncon or happenings.carries):
                    self._note_surroundings(k)
        except SimulationError:
            if not np.isfinite(asked).all():
                raise controller.not_finite(sensed) from None
            raise
        finally:
            wanted = self._write(first, kept, (5 if is_perfect else 8) * plant.n)
        self._refuse_infinite(arm, wanted, first)

    def _write(self, first: int, kept: list[bytes], width: int) -> Array:
        """Writes rows of commanded and asked torques, what is, and what was measured (if else).

        Returns:
            the asked torques, (T, n).
        """
        n = self.plant.n
        found = np.frombuffer(b"".join(kept))
        found = found[: len(found) // width * width].reshape(-1, width)
        commanded, asked, actual = found[:, :n], found[:, n : 2 * n], found[:, 2 * n : 5 * n]
        self.step = first - 1 + len(found)
        part = slice(first, self.step + 1)
        self._driven_log[part, :n], self._driven_log[part, n:] = commanded, commanded != asked
        self._actual_log[part], self._measured_log[part] = actual, found[:, -3 * n :]
        return asked

    def _refuse_infinite(self, arm: Arm, asked: Array, first: int) -> None:
        """Goes back to before a torque was infinite: cut to the limit, the plant did not see it."""
        infinite = np.isinf(asked).any(axis=1)
        if infinite.any():
            row = int(np.argmax(infinite))
            self.step = first + row - 1
            arm.sensed.time = self.time
            arm.controller.asked[:] = asked[row]
            raise arm.controller.not_finite(arm.sensed)

    def _advance_all(self, first: int, last: int) -> None:
        """The same for several robots."""
        happenings, plant = self._happenings, self.plant
        n = plant.n
        for k in range(first, last + 1):
            if happenings.is_growing:
                happenings.before(k - 1)
            for arm in self._arms:
                arm.sense()
                arm.sensed.time = float(self.rows[k - 1, 0])
                if arm.plan.moves:
                    arm.plan.load(arm.target, k - 1)
                arm.controller.torques(arm.sensed, arm.target, self._commanded[arm.joints])
                if not np.isfinite(arm.controller.asked).all():
                    raise arm.controller.not_finite(arm.sensed)
                self._saturated[arm.joints] = arm.controller.saturated
            plant.step(np.multiply(self._commanded, happenings.gains, self._driven))
            self._measured_log[k] = plant.measured.reshape(-1)
            self._actual_log[k] = plant.actual.reshape(-1)
            self._driven_log[k, :n], self._driven_log[k, n:] = self._commanded, self._saturated
            self.step = k
            if plant.data.ncon or happenings.carries:
                self._note_surroundings(k)

    def _note_surroundings(self, k: int) -> None:
        """Writes what touches robots, and what they carry."""
        if self._contacts is not None:
            forces = self._contacts.update()
            for number, arm in enumerate(self._arms):
                columns = self.layout.columns[event_of(arm.name, "contact_force")]
                self.rows[k, columns] = forces[number]
        if self._happenings.carries:
            self._happenings.place_objects(self.layout.columns, self.rows[k])

    def _observe(self, first: int) -> None:
        """Estimates the external torques of the new rows."""
        columns = self.layout.columns
        for arm in self._arms:
            angles, velocities, torques = (
                self.rows[:, columns[event_of(arm.name, signal)]] for signal in MEASURED
            )
            estimates = self._estimated_log[:, arm.joints]
            arm.observe(first, self.step, (angles, velocities, torques), estimates)

    @property
    def log(self) -> RunLog:
        """The log until now; its signals are views."""
        rows = self.rows[: self.step + 1]
        return RunLog.from_rows(
            self.layout, rows, self.scenario.scene.robots, name=self.scenario.name
        )

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


def _check_size(scenario: Scenario) -> None:
    """Refuses a run whose log would not fit into memory, before anything is computed for it."""
    joints = sum(robot.n for robot in scenario.scene.robots.values())
    signals = len((*MEASURED, *ACTUAL, *DRIVEN, *TARGETS, *ESTIMATED))
    size = 8 * (scenario.run.steps + 1) * signals * joints
    if size > MOST_BYTES:
        found = f"found {scenario.run.steps} steps, a log of {size / 2**30:.1f} GiB"
        message = f"{found}; expected up to {MOST_BYTES / 2**30:.0f} GiB"
        raise DeclarationError(scenario.scene.located([Problem("run.duration", message)]))
