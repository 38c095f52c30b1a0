"""`Simulation`: a scenario at work, step by step, with a log of everything."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..assemble.scene import Scene
from ..errors import DeclarationError, Problem
from .compiler import Compiler
from .controllers import make_controller
from .expect import Outcome
from .happenings import Happenings
from .joint_control import GravityCompensation
from .monitor import Finding
from .observer import MomentumObserver
from .plan import Plan, make_plan
from .plant import Plant
from .run_log import ACTUAL, DRIVEN, ESTIMATED, MEASURED, RunLayout, RunLog, event_of
from .scenario import Scenario
from .state import Sensed, Target
from .torque_limits import LimitedController

Array = NDArray[np.float64]

MOST_BYTES = 2 * 2**30  # of a log; longer runs need a longer timestep


class _Arm:
    """One robot with its controller, and what that sees and is asked for."""

    def __init__(
        self, name: str, simulation: Simulation, joints: slice, plan: Plan, shares: Array | None
    ) -> None:
        scenario = simulation.scenario
        robot = scenario.scene.robots[name]
        self.joints, self.plan = joints, plan
        self.model = simulation.compiler.robot_model(robot)
        declared = scenario.controllers.get(name, GravityCompensation())
        self.controller: LimitedController = make_controller(
            declared, self.model, scenario.run.timestep, robot.torque_limits
        )
        # Of one robot alone what the plant measures is seen in place.
        self.copies = shares is None
        # Elastic joints are controlled over their motors, which encoders of their own measure.
        self.motors: Array | None = np.zeros(2 * robot.n) if robot.elastic_joints else None
        self.sensed = Sensed(robot.n, shares, self.motors)
        self.target = Target(robot.n)
        self.target.posture[:] = robot.home
        self.observer = MomentumObserver(
            simulation.compiler.robot_model(robot),
            scenario.run.observer_gain,
            scenario.run.timestep,
        )


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
        if run.elastic is not None:
            for robot in scene.robots.values():
                robot.elastic_joints = run.elastic
        sensors = scenario.make_sensors(run.seed if seed is None else seed)
        # Doubles, arrows and cameras take no part, and would cost time in every step.
        stripped = Scene(
            robots=list(scene.robots.values()),
            objects=scene.objects,
            floor=scene.floor,
            name=scene.name,
            file=scene.file,
        )
        self.plant = Plant(self.compiler.world(stripped), sensors, run.timestep)
        times = np.arange(run.steps + 1, dtype=np.float64) * run.timestep
        plans = self._plans(times)
        self._happenings = Happenings(scenario, self.plant, run.steps)
        others = self._happenings.others()
        for name, plan in plans.items():
            if plan.flange is not None:
                others[event_of(name, "target_pose")] = "1M"
        targets = tuple(name for name, plan in plans.items() if plan.joints is not None)
        joints = {name: robot.n for name, robot in scene.robots.items()}
        self.layout = RunLayout(joints, targets, others)
        if (size := 8 * len(times) * self.layout.width) > MOST_BYTES:
            found = f"found {run.steps} steps, a log of {size / 2**30:.1f} GiB"
            message = f"{found}; expected up to {MOST_BYTES / 2**30:.0f} GiB"
            raise DeclarationError([Problem("run.duration", message)])
        self.rows: Array = np.zeros((len(times), self.layout.width))
        self.rows[:, 0] = times
        self._fill_targets(plans)
        self._happenings.fill(self.layout.columns, self.rows)
        self._commanded: Array = np.zeros(self.plant.n)
        self._driven: Array = np.zeros(self.plant.n)
        self._saturated: Array = np.zeros(self.plant.n)
        self._external: Array = np.zeros(self.plant.n)
        self._arms = self._make_arms(plans)
        self._measured_log = self.rows[:, self.layout.block(MEASURED)]
        self._actual_log = self.rows[:, self.layout.block(ACTUAL)]
        self._driven_log = self.rows[:, self.layout.block(DRIVEN)]
        self._estimated_log = self.rows[:, self.layout.block(ESTIMATED)]
        self._write(0)

    def _plans(self, times: Array) -> dict[str, Plan]:
        plans, problems = {}, []
        for name, robot in self.scenario.scene.robots.items():
            controller = self.scenario.controllers.get(name, GravityCompensation())
            try:
                plans[name] = make_plan(robot, self.scenario.targets.get(name), controller, times)
            except DeclarationError as error:
                problems += [problem.inside(f"targets.{name}") for problem in error.problems]
        if problems:
            raise DeclarationError(self.scenario.scene.located(problems))
        return plans

    def _make_arms(self, plans: dict[str, Plan]) -> list[_Arm]:
        arms, problems, first = [], [], 0
        alone = len(plans) == 1
        for name, plan in plans.items():
            n = self.scenario.scene.robots[name].n
            joints = slice(first, first + n)
            first += n
            try:
                arm = _Arm(name, self, joints, plan, self.plant.measured if alone else None)
                self._check_gains(name, arm)
            except DeclarationError as error:
                problems += [problem.inside(f"controllers.{name}") for problem in error.problems]
                continue
            arms.append(arm)
        if problems:
            raise DeclarationError(self.scenario.scene.located(problems))
        return arms

    def _check_gains(self, name: str, arm: _Arm) -> None:
        """Refuses gains that the timestep is too long for, where the controller can tell."""
        check = getattr(arm.controller, "check", None) or getattr(
            arm.controller.controller, "check", None
        )
        if check is not None:
            check(np.asarray(self.scenario.scene.robots[name].home, np.float64))

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
        for arm in self._arms:
            if not arm.plan.moves:
                arm.plan.load(arm.target, 0)
        for k in range(self.step + 1, min(to_step, self.steps) + 1):
            self._make_step(k)
            self.step = k

    def _sense(self, arm: _Arm) -> None:
        """Lets a controller see what was measured."""
        plant = self.plant
        if arm.copies:
            np.copyto(arm.sensed.values, plant.measured[:, arm.joints])
        if arm.motors is not None:
            n = len(arm.motors) // 2
            arm.motors[:n] = plant.motor_angles[arm.joints]
            arm.motors[n:] = plant.motor_velocities[arm.joints]

    def _make_step(self, k: int) -> None:
        happenings, plant, commanded = self._happenings, self.plant, self._commanded
        if happenings.next_step < k:
            happenings.before(k - 1)
        for arm in self._arms:
            self._sense(arm)
            arm.sensed.time = plant.data.time
            if arm.plan.moves:
                arm.plan.load(arm.target, k - 1)
            arm.controller.torques(arm.sensed, arm.target, commanded[arm.joints])
            self._saturated[arm.joints] = arm.controller.saturated
        driven = commanded
        if happenings.is_tampered:
            driven = np.multiply(commanded, happenings.gains, self._driven)
        plant.step(driven)
        for arm in self._arms:
            self._sense(arm)
            self._external[arm.joints] = arm.observer.update(arm.sensed)
        self._write(k)
        if happenings.carries:
            happenings.place_objects(self.layout.columns, self.rows[k:])

    def _write(self, k: int) -> None:
        n = self.plant.n
        self._measured_log[k] = self.plant.measured.reshape(-1)
        self._actual_log[k] = self.plant.actual.reshape(-1)
        driven = self._driven_log[k]
        driven[:n] = self._commanded
        driven[n:] = self._saturated
        self._estimated_log[k] = self._external

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
