"""`Simulation`: runs a scenario step by step, with a log of everything."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..assemble.scene import Scene
from ..control.compiler import Compiler
from ..control.joint_control import GravityCompensation
from ..control.plan import Plan, make_plan
from ..errors import DeclarationError, Problem
from ..receive.structure import Structure
from ..runs.monitor import Finding
from ..runs.run_log import ACTUAL, DRIVEN, ESTIMATED, MEASURED, TARGETS, RunLayout, RunLog, event_of
from .controlled_robot import ControlledRobot, observed_every
from .event_schedule import EventSchedule
from .expect import Outcome
from .external_loads import Contacts
from .plant import Plant
from .scenario import Scenario

Array = NDArray[np.float64]

MAX_BYTES = 2 * 2**30  # of a log; longer runs need a longer timestep


class Simulation:
    """Runs a scenario.

    Args:
        scenario: what to run.
        seed: of the noise; the scenario's when None.
        compiler: that remembers what it has compiled, for those who run many; a new one when None.

    Attributes:
        scenario: as given.
        compiler: as given.
        robots: by name, as they are simulated: with elastic joints where the run asks for them.
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
        run, scene = scenario.run, scenario.scene
        self.compiler = compiler or Compiler()
        self.scenario = scenario
        _check_size(scenario)
        elastic = {} if run.elastic is None else {"elastic_joints": run.elastic}
        self.robots = {
            name: robot.model_copy(update=elastic) for name, robot in scene.robots.items()
        }
        sensors = scenario.make_sensors(run.seed if seed is None else seed)
        # Doubles, arrows and cameras take no part, and would cost time in every step. What is
        # carried is a mass of the flange, and nothing to run into.
        stripped = Scene(
            robots=list(self.robots.values()),
            objects=scenario.obstacles,
            floor=scene.floor,
            name=scene.name,
            file=scene.file,
        )
        self.plant = Plant(self.compiler.world(stripped), sensors, run.timestep)
        self.plant.looks_ahead = False  # controllers have models of their own
        self._observed_every = observed_every(run.timestep)
        self._contacts = None
        if scenario.has_surroundings:
            self._contacts = Contacts(self.plant.world, self.plant.data)
        start = np.concatenate([robot.home for robot in self.robots.values()])
        self._begin(start)
        self._check_gains(start)

    def restart(self, joint_angles: Array, seed: int) -> None:
        """Begins anew with other joint angles and noise; what was changed about the plant stays.

        Args:
            joint_angles: (n,), of all robots together, rad or m.
            seed: of the noise.
        """
        self.plant.sensors.seed = seed
        self.plant.reset(joint_angles)
        self._begin(joint_angles)

    def _begin(self, start: Array) -> None:
        """Makes a new log, and controllers that remember nothing, for a plant that is at rest."""
        self.step = 0
        run = self.scenario.run
        times = np.arange(run.steps + 1, dtype=np.float64) * run.timestep
        plans = self._make_plans(times, start)
        self._schedule = EventSchedule(self.scenario, self.plant, run.steps)
        self.layout = self._make_layout(plans)
        self.rows: Array = np.zeros((len(times), self.layout.width))
        self.rows[:, 0] = times
        self._fill_targets(plans)
        self._schedule.fill(self.layout.columns, self.rows)
        self._commanded: Array = np.zeros(self.plant.n)
        self._robots = self._make_robots(plans)
        # Views of the log, (T, signals, n): those of all robots lie in a row.
        self._measured, self._actual, self._driven = (
            self.rows[:, self.layout.block(signals)].reshape(len(times), len(signals), -1)
            for signals in (MEASURED, ACTUAL, DRIVEN)
        )
        self._estimated = self.rows[:, self.layout.block(ESTIMATED)]
        self._measured[0], self._actual[0] = self.plant.measured, self.plant.actual
        self._driven[0, 0] = self.plant.actual[2]  # what holds it at rest

    def _make_plans(self, times: Array, start: Array) -> dict[str, Plan]:
        plans, problems = {}, []
        parts = self.plant.world.robots
        for name, robot in self.robots.items():
            controller = self.scenario.controllers.get(name, GravityCompensation())
            try:
                first = start[parts[name].joints]
                law = self.scenario.targets.get(name)
                plans[name] = make_plan(robot, law, controller, times, self.compiler, first)
            except DeclarationError as error:
                problems += [problem.inside(f"targets.{name}") for problem in error.problems]
        if problems:
            raise DeclarationError(self.scenario.scene.located(problems))
        return plans

    def _make_layout(self, plans: dict[str, Plan]) -> RunLayout:
        events = self._schedule.events()
        if self._contacts is not None:
            events |= {event_of(name, "contact_force"): "1V" for name in plans}
        for name, plan in plans.items():
            if plan.flange is not None:
                events[event_of(name, "target_pose")] = "1M"
        targets = tuple(name for name, plan in plans.items() if plan.joints is not None)
        joints = {name: robot.n for name, robot in self.robots.items()}
        return RunLayout(joints, targets, events)

    def _make_robots(self, plans: dict[str, Plan]) -> list[ControlledRobot]:
        robots, problems = [], []
        for name, plan in plans.items():
            try:
                robots.append(
                    ControlledRobot(
                        name, self.scenario, plan, self.plant, self._commanded, self.compiler
                    )
                )
            except DeclarationError as error:
                problems += [problem.inside(f"controllers.{name}") for problem in error.problems]
        if problems:
            raise DeclarationError(self.scenario.scene.located(problems))
        return robots

    def _check_gains(self, start: Array) -> None:
        problems = []
        for robot in self._robots:
            try:
                robot.controller.check(start[robot.joints])
            except DeclarationError as error:
                problems += [
                    problem.inside(f"controllers.{robot.name}") for problem in error.problems
                ]
        if problems:
            raise DeclarationError(self.scenario.scene.located(problems))

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
    def about(self) -> str:
        """What it is, for people."""
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
        schedule, plant = self._schedule, self.plant
        for k in range(self.step + 1, min(to_step, self.steps) + 1):
            schedule.before(k - 1)
            time = float(self.rows[k - 1, 0])
            for robot in self._robots:
                robot.command(k - 1, time)
            plant.step(self._commanded * schedule.gains)
            self._write(k)
            self.step = k

    def _write(self, k: int) -> None:
        """Writes row k of the log: what came of the step that led to it."""
        plant, columns = self.plant, self.layout.columns
        self._measured[k] = plant.measured
        self._actual[k] = plant.actual
        self._driven[k, 0] = self._commanded
        for robot in self._robots:
            self._driven[k, 1, robot.joints] = robot.commanded != robot.controller.asked
        if self._contacts is not None and plant.data.ncon:
            for name, force in zip(self.robots, self._contacts.update(), strict=True):
                self.rows[k, columns[event_of(name, "contact_force")]] = force
        self._schedule.after(k)
        every = self._observed_every
        if k % every == 0:
            for robot in self._robots:
                estimate = robot.observe(self._measured[k - every + 1 : k + 1])
                self._estimated[k : k + every, robot.joints] = estimate

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


def _check_size(scenario: Scenario) -> None:
    """Refuses a run whose log would not fit into memory, before anything is computed for it."""
    joints = sum(robot.n for robot in scenario.scene.robots.values())
    signals = len((*MEASURED, *ACTUAL, *DRIVEN, *TARGETS, *ESTIMATED))
    size = 8 * (scenario.run.steps + 1) * signals * joints
    if size > MAX_BYTES:
        found = f"found {scenario.run.steps} steps, a log of {size / 2**30:.1f} GiB"
        message = f"{found}; expected up to {MAX_BYTES / 2**30:.0f} GiB"
        raise DeclarationError(scenario.scene.located([Problem("run.duration", message)]))
