"""`RunBatch`: simulates runs with the same robots together; a single run is a batch of one.

MuJoCo, drives, sensors, log, observers and controllers of the same group are computed together for
all runs. Other controllers are called one by one. The result of a run does not depend on its batch,
except for rounding.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from weakref import ref

import numpy as np

from ..base.errors import Problem, SimulationError
from ..base.frames import Array
from ..robots.declared.joint_speeds import joint_speeds
from .batch_setup import BatchSetup
from .control.compiler import Compiler, fingerprint
from .control.observer import MomentumObserver
from .control.robot_models import RobotModels
from .robot_control import RobotControl
from .run import BatchRun
from .runs.run_log import ACTUAL, DRIVEN, ESTIMATED, MEASURED
from .scenario import Scenario

# Fields of `Run` that may differ within a batch.
_OWN = ("seed", "observer_gain", "show_targets", "show_paths")


def batch_key(scenario: Scenario) -> object:
    """Returns a hashable key. Scenarios with equal keys can be simulated in one batch.

    Such scenarios have the same robots, surroundings, duration, rates and drives. Controllers,
    targets, sensors, disturbances, faults and expectations may differ.
    """
    scene, run = scenario.scene, scenario.run
    shared = {key: getattr(run, key) for key in type(run).model_fields if key not in _OWN}
    declared = [scene.robots, scene.groups, scenario.obstacles, scene.floor, shared]
    return fingerprint([*declared, scenario.amplifies])


class RunBatch(BatchSetup):
    """Runs that are simulated together.

    Args:
        scenarios: scenarios with the same `batch_key`.
        raises: whether an error in a run is raised instead of stored as the run's `error`.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seeds: Sequence[int],
        compiler: Compiler,
        *,
        raises: bool,
    ) -> None:
        super().__init__(scenarios, seeds, compiler)
        self._raises = raises
        self._runs: list[ref[BatchRun]] = []  # runs without other references are skipped
        self._limit_speeds(self._run.runaway_speed)

    def _limit_speeds(self, share: float) -> None:
        limits = [joint_speeds(robot, "runaway") for robot in self.robots.values()]
        self._runaway, self._fastest = share, np.concatenate(limits) * (share or np.inf)
        # If the sum of all squared speeds is below this, no joint exceeds its limit.
        self._surely_slow = float(self._fastest.min()) ** 2
        self._motor_speeds = self.plant.motor_velocities if self.plant.joints.elastic else None

    def restart(self, joint_angles: Array, seed: int) -> None:
        """Resets the plant of a single run to rest in a pose, with a new noise seed."""
        plant = self.plant.row(0)
        plant.sensors.seed = seed
        plant.reset(joint_angles)
        self.plans.clear()
        if self.drives is not None:
            self.drives.reset()

    def begin(self, runs: Sequence[BatchRun]) -> None:
        """Creates the logs and observers of new runs at rest."""
        self.carried.clear()
        self._runs = [ref(run) for run in runs]
        layout, steps = runs[0].layout, self._run.steps
        width = max(run.layout.width for run in runs)
        log: Array = np.zeros((self.plant.physics.m, steps + 1, width))
        # Views of shape (T, m, signals, n).
        self._measured, self._actual, self._driven = (
            log.swapaxes(0, 1)[..., layout.block(signals)].reshape(
                steps + 1, len(log), len(signals), -1
            )
            for signals in (MEASURED, ACTUAL, DRIVEN)
        )
        self._measured[0], self._actual[0] = self.plant.measured, self.plant.actual
        self._driven[0, :, 0] = self.plant.actual[:, 2]  # torques that hold the robots at rest
        observed: dict[int, list[int]] = defaultdict(list)
        self._estimated: dict[int, Array] = {}
        for run in runs:
            row = run.plant.row
            run.open_log(log[row, :, : run.layout.width])
            observed[run.observed_every].append(row)
            self._estimated[row] = run.rows[:, run.layout.block(ESTIMATED)]
        standing = [one.robot for one in runs[0].controlled]
        gains = np.array([[one.run.observer_gain] for one in self._scenarios])
        self._observers = [
            _Observer(every, rows, self.models(standing, rows), gains[rows], self._run.timestep)
            for every, rows in observed.items()
        ]
        for observer in self._observers:
            observer.update(self._measured[:1])
        self._join(runs)

    def _join(self, runs: Sequence[BatchRun]) -> None:
        self.has_changed = False
        by_row = {run.plant.row: run for run in runs}
        # Rows whose run could not be made use the first run's robots.
        rows = [by_row.get(row, runs[0]).controlled for row in range(self.plant.physics.m)]
        self._controls: list[RobotControl] = []
        self._alone: list[tuple[int, RobotControl]] = []
        groups: dict[object, list[int]] = defaultdict(list)
        for number, (first, *others) in enumerate(zip(*rows, strict=True)):
            group, controller = first.group, first.controller.controller
            # Models of several rows do not follow the bases of mounted robots.
            is_bound = not controller.spans_robots and self.whole_bodies and len(rows) > 1
            if is_bound or any(one.group != group for one in others):
                group = None
            groups[(number,) if group is None else group].append(number)
        for group, numbers in groups.items():
            # A single controller is faster alone: numpy's `dot` takes half the time of `matvec`.
            if group == (numbers[0],) or len(numbers) * len(rows) == 1:
                for run in by_row.values():
                    one = run.controlled[numbers[0]]
                    control = RobotControl.alone(one, self.plant, self.drive, run.plant.row)
                    self._alone.append((run.plant.row, control))
                continue
            each = [[row[number] for number in numbers] for row in rows]
            models = self.models([one.robot for one in each[0]], range(len(rows)))
            is_live = any(run.live is not None for run in runs)
            self._controls.append(
                RobotControl.joined(each, self.plant, self.drive, models, is_live=is_live)
            )

    def advance(self, to_step: int) -> None:
        """Simulates all active runs up to a step; see `Simulation.advance`."""
        held = [run() for run in self._runs]
        going = [run for run in held if run is not None and run.error is None]
        if not going:
            return
        first, physics = going[0].step + 1, self.plant.physics
        rows = {run.plant.row for run in going}
        physics.begin(np.array([row in rows for row in range(physics.m)]))
        self._sort(going)
        try:
            self._make_steps(going, first, to_step + 1)
        finally:
            self._sort([])  # keep no references, so that abandoned runs are freed
            written = self._driven[first : to_step + 1]
            written[:, :, 1] = written[:, :, 0] != written[:, :, 1]  # whether saturated

    def _make_steps(self, going: list[BatchRun], first: int, stop: int) -> None:
        plant, commanded, gains = self.plant, self.drive[:, 0], self.gains
        measured, actual, driven = self._measured, self._actual, self._driven
        slow, motor_speeds = self._surely_slow, self._motor_speeds
        move = plant.step if self.drives is None else self.drives.step
        for k in range(first, stop):
            self._prepare(going, k - 1)
            if going:
                self._control(going, k - 1)
            if not going:
                return
            move(commanded * gains)
            if plant.failed:
                self._end_failed(going)
            measured[k], actual[k], driven[k] = plant.measured, plant.actual, self.drive
            self._finish(k)
            speeds = actual[k, :, 1]
            if np.vdot(speeds, speeds) > slow or (
                motor_speeds is not None and np.vdot(motor_speeds, motor_speeds) > slow
            ):
                self._stop_runaways(going, speeds)

    def _sort(self, going: list[BatchRun]) -> None:
        # The runs are sorted once per `advance`, because calling each run in each step costs as
        # much as a step. Runs that have ended stay in these lists.
        self._by_row = {run.plant.row: run for run in going}
        self._busy = [run for run in going if run.prepares]
        self._resting = [run for run in going if not run.prepares]
        self._wakes: float = 0  # next row for which a resting run has an event
        self._finishing = [run for run in going if run.finishes]

    def _prepare(self, going: list[BatchRun], k: int) -> None:
        due = self._busy
        if is_waking := k >= self._wakes:
            due = due + [run for run in self._resting if run.wakes <= k]
        for run in due:
            if run.error is None:
                try:
                    run.prepare(k)
                except SimulationError as error:
                    self._end(going, run, error)
        if is_waking:
            self._wakes = min((run.wakes for run in self._resting), default=np.inf)

    def _control(self, going: list[BatchRun], k: int) -> None:
        if self.has_changed:
            self._join(going)
        if self.whole_bodies:
            self._move_whole_bodies(k)
        time = float(going[0].times[k])
        for row, control in self._alone:
            run = self._by_row.get(row)
            if run is not None and run.error is None:
                try:
                    control.command(k, time)
                except SimulationError as error:
                    self._end(going, run, error)
        for control in self._controls:
            control.command(k, time)
        if not np.vdot(self.drive, self.drive) < np.inf:
            self._end_not_finite(going)

    def _move_whole_bodies(self, k: int) -> None:
        each = zip(self.whole_bodies, self._measured[k], self.plant.physics.qpos, strict=True)
        for whole_body, measured, qpos in each:
            whole_body.update(measured[0], qpos)

    def _finish(self, k: int) -> None:
        for row in self.plant.physics.touching():
            touching = self._by_row.get(row)
            if touching is not None and touching.error is None:
                touching.write_contacts(k)
        if self.carried:
            self.carried.write(k)
        for run in self._finishing:
            if run.error is None:
                run.finish(k)
        for observer in self._observers:
            if k % observer.every == 0:
                if self.whole_bodies:
                    self._move_whole_bodies(k)
                estimates = observer.update(self._measured[k - observer.every + 1 : k + 1])
                for row, estimate in zip(observer.rows, estimates, strict=True):
                    self._estimated[row][k : k + observer.every] = estimate
        for run in self._by_row.values():  # controllers and hooks read the time from `step`
            if run.error is None:
                run.step = k

    def _end(self, going: list[BatchRun], run: BatchRun, error: SimulationError) -> None:
        if self._raises:
            raise error
        self.plant.physics.drop(run.plant.row)
        self.drive[run.plant.row] = 0.0
        going.remove(run)
        run.error = error

    def _end_not_finite(self, going: list[BatchRun]) -> None:
        for run in going[:]:
            for control in self._controls:
                index = run.plant.row
                if run in going and not control.controller.is_finite(index):
                    error = control.controller.not_finite(control.sensed, index)
                    self._end(going, run, error)

    def _end_failed(self, going: list[BatchRun]) -> None:
        for run in going[:]:
            if run.plant.row in self.plant.failed:
                self._end(going, run, self.plant.failed.pop(run.plant.row))

    def _stop_runaways(self, going: list[BatchRun], speeds: Array) -> None:
        speeds = np.abs(speeds)
        if self._motor_speeds is not None:
            speeds = np.maximum(speeds, np.abs(self._motor_speeds))
        if not (speeds > self._fastest).any():
            return
        for run in going[:]:
            own = speeds[run.plant.row]
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
            named = f"the default velocity limit, {limit}"
        problem = Problem(
            found=float(speeds[row]),
            of=f"{unit}, more than {self._runaway:g} times {named}",
            expected="a stable motion. Change gains, torques or run.runaway_speed (0 disables it)",
        )
        return SimulationError(time, f"{robot.name}/{robot.names[joint]}", problem)


class _Observer:
    def __init__(
        self, every: int, rows: list[int], models: RobotModels, gains: Array, timestep: float
    ) -> None:
        self.every, self.rows = every, rows
        self._own = MomentumObserver(models, gains, timestep * every)

    def update(self, measured: Array) -> Array:
        """Returns estimated external torques, shape (k, n), Nm or N, valid until the next call.

        The observer uses the mean of the measured torques since the last update.

        Args:
            measured: angles, velocities and torques since the last update, (steps, m, 3, n).
        """
        own = measured if measured.shape[1] == len(self.rows) else measured[:, self.rows]
        angles, velocities = own[-1, :, 0], own[-1, :, 1]
        mean = np.add.reduce(own[:, :, 2]) / len(own)
        self._own.model.update(angles, velocities)
        return self._own.update_with(velocities, mean)
