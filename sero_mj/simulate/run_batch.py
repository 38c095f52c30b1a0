"""`RunBatch`: runs of equal robots that are simulated together; a run by itself is a batch of one.

In every step MuJoCo, drives, sensors, the log, and controllers and observers of a kind that has a
form for many are asked once for all runs; others run by run, and events when they are due. A run in
a batch is the same as one by itself, to rounding.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol
from weakref import ref

import numpy as np

from ..base.errors import DeclarationError, Problem, SimulationError
from ..base.frames import Array, RowIndex
from ..robots.assemble.world import World
from ..robots.declared.joint_speeds import joint_speeds
from ..robots.declared.robot import SerialRobot
from ..robots.declared.scene import Scene
from .control.compiler import Compiler, fingerprint
from .control.observer import MomentumObserver
from .control.plan import Plan
from .control.robot_model import RobotModel
from .control.whole_body import WholeBody
from .controlled_robot import ControlledRobot, RobotControl, join, join_observers, observe
from .drives import Drives
from .event_schedule import CarriedObjects
from .plant import Plant
from .plant_rows import PlantRow, PlantRows
from .rows import ManyRows, OneRow
from .runs.run_log import ACTUAL, DRIVEN, ESTIMATED, MEASURED, RunLayout
from .scenario import Scenario
from .sensors import Sensors

# Of a run's declaration, what may differ between those of a batch.
_OWN = ("seed", "observer_gain", "show_targets", "show_paths")


class BatchedRun(Protocol):
    """What a batch knows of its runs; see `Simulation`."""

    scenario: Scenario
    plant: PlantRow
    layout: RunLayout
    controlled: list[ControlledRobot]
    times: Array
    step: int
    observed_every: int
    error: SimulationError | None

    @property
    def prepares(self) -> bool:
        """Whether `prepare` has to be called for every row of the log."""

    @property
    def wakes(self) -> float:
        """Else the next row for which it has to be; infinite for none."""

    @property
    def finishes(self) -> bool:
        """Whether `finish` has to be called for every row of the log."""

    def robot_model(self, robot: SerialRobot) -> RobotModel:
        """A new model of a robot for its controller."""

    def open_log(self, rows: Array) -> None:
        """Begins to write a log, (T, width)."""

    def prepare(self, k: int) -> None:
        """Applies controllers and events for the step after row k of the log."""

    def write_contacts(self, k: int) -> None:
        """Writes the forces of the contacts that there are into row k of the log."""

    def finish(self, k: int) -> None:
        """Completes the step before row k of the log."""

    def observe(self, k: int) -> None:
        """Estimates the external torques of row k and those after it."""


def batch_key(scenario: Scenario) -> object:
    """A hashable value; scenarios with equal ones can be simulated as one batch.

    They have the same robots and surroundings, duration, rates and drives. Controllers, targets,
    sensors, disturbances, faults and what is expected may differ.
    """
    scene, run = scenario.scene, scenario.run
    shared = {key: getattr(run, key) for key in type(run).model_fields if key not in _OWN}
    declared = [scene.robots, scene.groups, scenario.obstacles, scene.floor, shared]
    return fingerprint([*declared, scenario.amplifies])


class RunBatch:
    """The plant, drives and log of runs that are simulated together.

    Args:
        scenarios: of the runs, with one `batch_key`.
        seeds: of their noise.
        compiler: of the world.
        raises: whether what ends a run is raised, as for one by itself; else it is its `error`.

    Attributes:
        robots: by name, as they are simulated: with elastic joints where the runs ask for them.
        plant: the simulated robots, a row for every run.
        drives: between controllers and motors; None where that is only a wire.
        start: (n,), joint angles at first, rad or m.
        drive: (m, 2, n), torques, Nm or N: commanded, and asked for before the limits; without the
            axis of the runs where there is one, as all that follows.
        gains: (m, n), factors of the commanded torques, after the limits: those of faulty drives.
        observer_models: what the observers of all runs know of a robot, by its name.
        carried: objects that robots of any run carry.
        plans: targets of its runs, by robot and all that they depend on.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seeds: Sequence[int],
        compiler: Compiler,
        *,
        raises: bool,
    ) -> None:
        scenario = scenarios[0]
        run, self._raises = scenario.run, raises
        elastic = {} if run.elastic is None else {"elastic_joints": run.elastic}
        self.robots = {
            name: robot.model_copy(update=elastic) for name, robot in scenario.scene.robots.items()
        }
        sensors = [one.make_sensors(seed) for one, seed in zip(scenarios, seeds, strict=True)]
        world = compiler.world(self._stripped(scenario), run.gravity)
        self.start: Array = np.concatenate([robot.home for robot in self.robots.values()])
        timestep = run.timestep / run.substeps
        self.plant: Plant | PlantRows
        if len(scenarios) == 1:
            self.plant = Plant(world, sensors[0], timestep)
        else:
            self.plant = self._many(world, sensors, timestep)
        self.plant.joints.looks_ahead = False  # controllers have models of their own
        self.drives: Drives | None = None
        if run.torque_control or run.substeps > 1 or run.drive_delay or scenario.amplifies:
            with located_in(scenario.scene):
                self.drives = Drives(self.plant, self.robots, run)
        shape = self.plant.rows.shape
        self.drive: Array = np.zeros((*shape, 2, self.plant.n))
        self.gains: Array = np.ones((*shape, self.plant.n))
        self.observer_models: dict[str, RobotModel] = {}
        self.carried = CarriedObjects(self.plant)
        self.plans: dict[object, Plan] = {}
        self._runs: list[ref[BatchedRun]] = []  # a run that nobody has any more is not simulated
        self._limit_speeds(run.runaway_speed)

    def _stripped(self, scenario: Scenario) -> Scene:
        """The scene without doubles, arrows and cameras, which would cost time in every step.

        What is carried is a mass of the flange, and nothing to run into.
        """
        scene = scenario.scene
        return Scene(
            robots=list(self.robots.values()),
            # Links of a group's robots that stand together do not collide.
            groups=[group.without_defaults() for group in scene.groups.values()],
            objects=scenario.obstacles,
            floor=scene.floor,
            name=scene.name,
            file=scene.file,
        )

    def _many(self, world: World, sensors: list[Sensors], timestep: float) -> PlantRows:
        alone = Plant(world, None, timestep)
        rows = ManyRows(world.physics_model(), len(sensors))
        plant = PlantRows(world, rows, Sensors.joined(sensors))
        for row, own in enumerate(sensors):
            alone.sensors.seed = own.seed
            plant.place(row, alone)
        return plant

    def _limit_speeds(self, share: float) -> None:
        """Computes the speeds at which joints run away, `share` times their limits; 0 for none."""
        limits = [joint_speeds(robot, "runaway") for robot in self.robots.values()]
        self._runaway, self._fastest = share, np.concatenate(limits) * (share or np.inf)
        # While the sum of all squared speeds is below this, no joint exceeds its limit.
        self._surely_slow = float(self._fastest.min()) ** 2
        self._motor_speeds = self.plant.motor_velocities if self.plant.joints.elastic else None

    def begin(self, runs: Sequence[BatchedRun]) -> None:
        """Makes the logs of runs that begin, at rest."""
        self.carried.clear()
        self._runs = [ref(run) for run in runs]
        steps, width = runs[0].scenario.run.steps, max(run.layout.width for run in runs)
        log: Array = np.zeros((len(self.plant.rows.indices), steps + 1, width))
        # Views (T, m, signals, n): those of all robots lie in a row.
        by_time = log.swapaxes(0, 1) if self.plant.rows.shape else log[0]
        self._measured, self._actual, self._driven, self._estimated = (
            by_time[..., runs[0].layout.block(signals)].reshape(
                *by_time.shape[:-1], len(signals), -1
            )
            for signals in (MEASURED, ACTUAL, DRIVEN, ESTIMATED)
        )
        self._measured[0], self._actual[0] = self.plant.measured, self.plant.actual
        self._driven[0, ..., 0, :] = self.plant.actual[..., 2, :]  # what holds it at rest
        for run in runs:
            row = run.plant.index
            run.open_log(log[0 if row is ... else row, :, : run.layout.width])
        self._join({run.plant.index: run for run in runs})

    def _join(self, runs: dict[RowIndex, BatchedRun]) -> None:
        """Joins controllers, where their kind supports it, and observers of robots in all rows."""
        plant, rows = self.plant, self.plant.rows
        self._joined: list[RobotControl] = []
        self._observers: list[tuple[slice, MomentumObserver]] = []
        # What mounted robots know of each other is asked for row by row.
        if isinstance(rows, OneRow) or WholeBody.is_needed(plant.world):
            return
        first = next(iter(runs.values()))  # stands in for runs that could not be made
        self._observed_every = first.observed_every
        at_once = (
            len({(run.observed_every, run.layout.block(ESTIMATED).start) for run in runs.values()})
            == 1
        )
        for number, robot in enumerate(first.controlled):
            each = [runs.get(index, first).controlled[number] for index in rows.indices]
            one = join(each, plant, self.drive, first.robot_model(robot.robot))
            if one is not None:
                self._joined.append(one)
            if at_once:
                observer = join_observers(each, self.observer_models[robot.robot.name])
                self._observers.append((robot.joints, observer))

    def advance(self, to_step: int) -> None:
        """Simulates all active runs up to a step, see `Simulation.advance`.

        Raises:
            SimulationError: a run cannot go on; see `raises`.
        """
        held = [run() for run in self._runs]
        going = [run for run in held if run is not None and run.error is None]
        if not going:
            return
        first, rows = going[0].step + 1, self.plant.rows
        if isinstance(rows, ManyRows):
            indices = {run.plant.index for run in going}
            rows.begin(np.array([index in indices for index in rows.indices]))
        self._sort(going)
        try:
            self._make_steps(going, first, to_step + 1)
        finally:
            self._sort([])  # a run that is given up afterwards ends with its last reference
            written = self._driven[first : to_step + 1]
            written[..., 1, :] = written[..., 0, :] != written[..., 1, :]  # saturated, or not

    def _make_steps(self, going: list[BatchedRun], first: int, stop: int) -> None:
        joined = self._joined
        plant, commanded, gains = self.plant, self.drive[..., 0, :], self.gains
        measured, actual, driven = self._measured, self._actual, self._driven
        slow, motor_speeds = self._surely_slow, self._motor_speeds
        move = plant.step if self.drives is None else self.drives.step
        for k in range(first, stop):
            if not going:
                return
            self._prepare(going, k - 1)
            if joined and going:
                time = float(going[0].times[k - 1])
                for control in joined:
                    control.command(k - 1, time)
                if not np.vdot(self.drive, self.drive) < np.inf:
                    self._end_not_finite(going)
            try:
                move(commanded * gains)
            except SimulationError as error:  # of the only run
                self._end(going, going[0], error)
                return
            if plant.failed:
                self._end_failed(going)
            measured[k], actual[k], driven[k] = plant.measured, plant.actual, self.drive
            self._finish(k)
            speeds = actual[k, ..., 1, :]
            if np.vdot(speeds, speeds) > slow or (
                motor_speeds is not None and np.vdot(motor_speeds, motor_speeds) > slow
            ):
                self._stop_runaways(going, speeds)

    def _sort(self, going: list[BatchedRun]) -> None:
        """Finds what each run is to be asked for: a call for all of them costs as much as a step.

        Runs that have ended stay in these lists.
        """
        self._by_row = {run.plant.index: run for run in going}
        self._busy = [run for run in going if run.prepares]
        self._resting = [run for run in going if not run.prepares]
        self._wakes: float = 0  # the next row for which one of those has something to do
        self._finishing = [run for run in going if run.finishes]
        self._observing = [] if self._observers else going[:]

    def _prepare(self, going: list[BatchedRun], k: int) -> None:
        """Applies controllers and events of those runs that have any for the step after row k."""
        asked = self._busy
        if is_waking := k >= self._wakes:
            asked = asked + [run for run in self._resting if run.wakes <= k]
        for run in asked:
            if run.error is None:
                try:
                    run.prepare(k)
                except SimulationError as error:
                    self._end(going, run, error)
        if is_waking:
            self._wakes = min((run.wakes for run in self._resting), default=np.inf)

    def _finish(self, k: int) -> None:
        """Completes row k of the log, where measured, actual and driven torques are already."""
        for row in self.plant.rows.touching():
            touching = self._by_row.get(row)
            if touching is not None and touching.error is None:
                touching.write_contacts(k)
        if self.carried:
            self.carried.write(k)
        for run in self._finishing:
            if run.error is None:
                run.finish(k)
        for run in self._observing:
            if k % run.observed_every == 0 and run.error is None:
                run.observe(k)
        if self._observers and k % self._observed_every == 0:
            begin = k - self._observed_every + 1
            for joints, observer in self._observers:
                estimate = observe(observer, self._measured[begin : k + 1, ..., joints])
                self._estimated[k : k + self._observed_every, ..., 0, joints] = estimate
        for run in self._by_row.values():  # what controllers and hooks call the time
            if run.error is None:
                run.step = k

    def _end(self, going: list[BatchedRun], run: BatchedRun, error: SimulationError) -> None:
        if self._raises:
            raise error
        if isinstance(self.plant.rows, ManyRows):
            self.plant.rows.drop(run.plant.index)
        self.drive[run.plant.index] = 0.0
        going.remove(run)
        run.error = error

    def _end_not_finite(self, going: list[BatchedRun]) -> None:
        """Ends the runs whose controllers ask for torques that are not finite."""
        for run in going[:]:
            for control in self._joined:
                index = run.plant.index
                if run in going and not control.controller.is_finite(index):
                    error = control.controller.not_finite(control.sensed, index)
                    self._end(going, run, error)

    def _end_failed(self, going: list[BatchedRun]) -> None:
        """Ends the runs whose robots have failed in this step."""
        for run in going[:]:
            if run.plant.index in self.plant.failed:
                self._end(going, run, self.plant.failed.pop(run.plant.index))

    def _stop_runaways(self, going: list[BatchedRun], speeds: Array) -> None:
        """Ends runs in which a joint, or the motor of an elastic one, has run away.

        Args:
            going: the runs that go on.
            speeds: (m, n), of the links now, rad/s or m/s.
        """
        speeds = np.abs(speeds)
        if self._motor_speeds is not None:
            speeds = np.maximum(speeds, np.abs(self._motor_speeds))
        if not (speeds > self._fastest).any():
            return
        for run in going[:]:
            own = speeds[run.plant.index]
            if (own > self._fastest).any():
                time = float(run.times[run.step])
                self._end(going, run, self._runaway_error(time, own))

    def _runaway_error(self, time: float, speeds: Array) -> SimulationError:
        joints = [(robot, j) for robot in self.robots.values() for j in range(robot.n)]
        row = int(np.argmax(speeds / self._fastest))
        robot, joint = joints[row]
        unit = "rad/s" if robot.types[joint] == "revolute" else "m/s"
        limit = f"{self._fastest[row] / self._runaway:.4g} {unit}"
        named = f"its velocity limit, {limit}"
        if robot.velocity_limits is None:
            named = f"{limit}, which stands for a velocity limit where none is declared"
        problem = Problem(
            found=float(speeds[row]),
            of=f"{unit}, more than {self._runaway:g} times {named}: it runs away",
            expected="other gains or torques, or another run.runaway_speed (0 for none)",
        )
        return SimulationError(time, f"{robot.name}/{robot.names[joint]}", problem)


@contextmanager
def located_in(scene: Scene) -> Iterator[None]:
    """Adds the scene's file and lines to the problems of a `DeclarationError` in its context."""
    try:
        yield
    except DeclarationError as error:
        raise DeclarationError(scene.located(error.problems)) from None
