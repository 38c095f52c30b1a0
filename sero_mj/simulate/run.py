"""`BatchRun`: one run of a batch, with its targets, controllers, events and log."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np

from ..base.errors import DeclarationError, Problem, SimulationError, UsageError, collect
from ..base.frames import Array, Ints, frame, rotation_from_quat
from ..robots.declared.mounts import base_frames, unmounted
from ..robots.declared.robot import SerialRobot
from .batch_setup import BatchSetup
from .control.compiler import fingerprint
from .control.controller import ControllerDeclaration, as_controller
from .control.plan import Plan, make_plan
from .control.robot_model import RobotModel
from .control.whole_body import WholeBody
from .drag_force import DragForce
from .event_schedule import EventSchedule
from .external_loads import Contacts
from .live_control import LiveControl, LiveRobot
from .robot_control import ControlledRobot
from .runs.measures import STEP_LATENESS
from .runs.run_log import MEASURED, TARGETS, RunLayout, event_of
from .scenario import Scenario

T = TypeVar("T")


# Time between two estimates in seconds: half of the observer's time constant at its default gain.
# Estimates in every step would cost ten times as much.
OBSERVED_EVERY = 0.01


def observed_every(scenario: Scenario) -> int:
    """Returns the number of steps between two estimates of the external torques."""
    run = scenario.run
    return max(round(min(OBSERVED_EVERY, 0.5 / run.observer_gain) / run.timestep), 1)


class BatchRun:
    """One run of a batch. See `Simulation` for arguments, other attributes and errors.

    Attributes:
        controlled: robots with their controllers, in the order of `robots`.
    """

    def __init__(
        self,
        scenario: Scenario,
        batch: BatchSetup,
        row: int,
        *,
        by_hand: bool = False,
        is_live: bool = False,
    ) -> None:
        self.scenario, self.compiler, self._setup = scenario, batch.compiler, batch
        self.robots, self.drives, self.plant = batch.robots, batch.drives, batch.plant.row(row)
        self.error: SimulationError | None = None
        self.drag_force = DragForce(self.plant, scenario) if by_hand else None
        self.live = LiveControl() if is_live else None
        self.whole_body = batch.whole_bodies[row] if batch.whole_bodies else None
        self.observed_every = observed_every(scenario)
        world = self.plant.world
        self._contacts = Contacts(world, self.plant.model) if scenario.has_surroundings else None
        self._free: dict[str, Callable[[Array], Array]] = {
            event_of(name, "base_frame"): part.base_pose
            for name, part in world.robots.items()
            if len(part.free)
        }
        for name, free in world.free_objects.items():
            self._free[event_of(name, "frame")] = partial(_pose_of, free)
        self.plan(batch.start)

    def plan(self, start: Array) -> None:
        """Computes the targets and makes new controllers for robots at rest.

        Args:
            start: joint angles of all robots, shape (n,), rad or m.
        """
        self.step, self._start = 0, start
        run, batch, row = self.scenario.run, self._setup, self.plant.row
        self.times = np.arange(run.steps + 1, dtype=np.float64) * run.timestep
        angles = {name: start[part.joints] for name, part in self.plant.world.robots.items()}
        bases = base_frames(self.robots, angles)
        standing = {name: unmounted(robot, bases[name]) for name, robot in self.robots.items()}
        if self.whole_body is not None:
            self.whole_body.update(start, self.plant.qpos)
        self._plans = self._of_robots(
            "targets", lambda name: self._plan_of(standing[name], angles[name])
        )
        self._schedule = EventSchedule(
            self.scenario, self.plant, run.steps, batch.gains[row], batch.carried
        )
        self.layout = self._make_layout()

        def control(name: str) -> ControlledRobot:
            stiffness = None
            loops = self.drives is not None and self.drives.loop is not None
            if loops and self.robots[name].elastic_joints:
                assert self.drives is not None
                stiffness = self.drives.gains[name].stiffness
            return ControlledRobot(
                standing[name],
                self.plant,
                self.scenario.controller_of(name),
                self._plans[name],
                run.timestep,
                stiffness,
                partial(_robot_model, batch, self.whole_body),  # no reference to this run
            )

        self.controlled = list(self._of_robots("controllers", control).values())

    def _plan_of(self, robot: SerialRobot, start: Array) -> Plan:
        name, scenario = robot.name, self.scenario
        if self.live is not None:  # `LiveControl` replaces the target, but uses its log columns
            return make_plan(robot, None, self.times[:1], self.compiler, start)
        controller = as_controller(scenario.controller_of(name))
        target = scenario.targets.get(name)
        needs = {"needs_target": controller.needs_target, "needs_pose": controller.needs_pose}
        known, key = self._setup.plans, fingerprint([name, target, needs])
        if key not in known:
            known[key] = make_plan(robot, target, self.times, self.compiler, start, **needs)
        return known[key]

    def check_gains(self) -> None:
        """Raises DeclarationError if a controller or the torque loop is unstable."""
        robots, start = dict(zip(self.robots, self.controlled, strict=True)), self._start
        self._of_robots(
            "controllers", lambda name: robots[name].controller.check(start[robots[name].joints])
        )
        if self.drives is not None and self.drives.loop is not None:
            try:
                for name, robot in robots.items():
                    linearised = robot.linearised(start[robot.joints])
                    self.drives.check(name, *linearised, has_springs=robot.has_springs)
            except DeclarationError as error:
                raise DeclarationError(self.scenario.scene.located(error.problems)) from None

    def _of_robots(self, section: str, make: Callable[[str], T]) -> dict[str, T]:
        made: dict[str, T] = {}
        problems: list[Problem] = []
        for name in self.robots:
            with collect(problems, f"{section}.{name}"):
                made[name] = make(name)
        if problems:
            raise DeclarationError(self.scenario.scene.located(problems))
        return made

    def _make_layout(self) -> RunLayout:
        plans, events = self._plans, self._schedule.log_events()
        if self._contacts is not None:
            events |= {event_of(name, "contact_force"): "1V" for name in plans}
        events |= dict.fromkeys(self._free, "1M")
        if self.drag_force is not None:
            events |= self.drag_force.log_events()
        for name, plan in plans.items():
            if plan.flange is not None:
                events[event_of(name, "target_pose")] = "1M"
            controller = as_controller(self.scenario.controller_of(name))
            events |= {
                event_of(name, key): "1F" for key in controller.logged if isinstance(key, str)
            }
            if controller.is_in_real_time:
                events[event_of(name, STEP_LATENESS)] = "1F"
        targets = tuple(name for name, plan in plans.items() if plan.joints is not None)
        joints = {name: robot.n for name, robot in self.robots.items()}
        return RunLayout(joints, targets, events)

    def open_log(self, rows: Array) -> None:
        """Starts the log in `rows`, shape (steps + 1, width), whose first row has measurements."""
        self.rows, columns = rows, self.layout.columns
        rows[:, 0] = self.times
        for name, plan in self._plans.items():
            if plan.joints is not None:
                rows[:, columns[event_of(name, "target_angles")]] = plan.joints.angles
                rows[:, columns[event_of(name, "target_velocities")]] = plan.joints.velocities
            if plan.flange is not None:
                poses = plan.flange.poses.reshape(-1, 16)
                rows[:, columns[event_of(name, "target_pose")]] = poses
        self._schedule.fill(columns, rows)
        block = self.layout.block(MEASURED)
        self._measured = rows[:, block].reshape(len(rows), len(MEASURED), -1)
        self._write_free(0)
        self._logged = {
            robot.robot.name: [
                columns[event]
                for key in as_controller(robot.declared).logged
                if isinstance(key, str) and (event := event_of(robot.robot.name, key)) in columns
            ]
            for robot in self.controlled
        }
        self._has_logged = any(self._logged.values())
        # Columns for the delays of real-time controllers that do not log them themselves.
        self._timed = [
            columns[event_of(robot.robot.name, STEP_LATENESS)]
            for robot in self.controlled
            if (controller := as_controller(robot.declared)).is_in_real_time
            and STEP_LATENESS not in controller.logged
        ]
        self.before = [
            each.before for each in (self._schedule, self.drag_force, self.live) if each is not None
        ]
        if self.drag_force is not None:
            self.drag_force.begin(columns, rows)
        if self.live is not None:
            self.live.begin(
                {robot.robot.name: self._live_robot(robot) for robot in self.controlled}
            )

    def _live_robot(self, controlled: ControlledRobot) -> LiveRobot:
        robot, columns = controlled.robot, self.layout.columns
        keys = (*TARGETS, "target_pose")
        return LiveRobot(
            robot=robot,
            model=self.robot_model(robot),
            timestep=self.scenario.run.timestep,
            target=controlled.target,
            measured=self.plant.measured[0, controlled.joints],
            speeds=self.plant.measured[1, controlled.joints],
            written=[self.rows[:, columns[event_of(robot.name, key)]] for key in keys],
            use=partial(self.use_controller, robot.name),
        )

    def robot_model(self, robot: SerialRobot) -> RobotModel:
        """Returns a new model of a robot, including the robots that are mounted on it.

        With joint torque control, the model has the shaped motor inertias.
        """
        return _robot_model(self._setup, self.whole_body, robot)

    @property
    def prepares(self) -> bool:
        """Whether `prepare` must be called in every step."""
        return self.drag_force is not None or self.live is not None

    @property
    def wakes(self) -> float:
        """Next row for which `prepare` must be called even if `prepares` is false, or infinity."""
        return self._schedule.next

    @property
    def finishes(self) -> bool:
        """Whether `finish` must be called in every step."""
        has_own = self._has_logged or self._timed
        return bool(self._free or self.drag_force is not None or has_own)

    def prepare(self, k: int) -> None:
        """Applies the events that are due before the step after row k."""
        for act in self.before:
            act(k)

    def finish(self, k: int) -> None:
        """Writes all values of log row k except measured values and torques."""
        if self._free:
            self._write_free(k)
        if self.drag_force is not None:
            self.drag_force.after(k)
        if self._has_logged:
            self._write_logged(k)
        if self._timed:
            now = clock.monotonic() - self.times[k]
            if k == 1:
                self._started = now
            for columns in self._timed:
                self.rows[k, columns] = max(now - self._started, 0.0)

    def _write_free(self, k: int) -> None:
        for event, pose in self._free.items():
            self.rows[k, self.layout.columns[event]] = pose(self.plant.qpos).ravel()

    def _write_logged(self, k: int) -> None:
        for robot in self.controlled:
            name, controller = robot.robot.name, robot.controller.controller
            places = self._logged[name]
            numbers = controller.logged
            if len(places) == len(numbers):  # differs after `use_controller`
                for columns, value in zip(places, numbers, strict=True):
                    self.rows[k, columns] = value
            wanted = controller.commanded_angles
            if wanted is not None and name in self.layout.targets:
                self.rows[k, self.layout.columns[event_of(name, "target_angles")]] = wanted

    def write_contacts(self, k: int) -> None:
        """Writes the contact forces of the last step to log row k."""
        if self._contacts is None:
            return
        forces = self._contacts.update(self.plant.model, self.plant.data)
        for name, force in zip(self.robots, forces, strict=True):
            self.rows[k, self.layout.columns[event_of(name, "contact_force")]] = force

    def use_controller(self, robot: str, controller: ControllerDeclaration) -> None:
        """Replaces the controller of a robot from the next step on.

        If an error is raised, the previous controller remains in use.

        Raises:
            DeclarationError: the gains do not fit the robot, or are unstable at this time step and
                in this pose.
            UsageError: other runs share the controller; see `Simulation.together`.
        """
        controlled = self.controlled[list(self.robots).index(robot)]
        if self._setup.plant.physics.m > 1 and controlled.control.rows:
            raise UsageError(
                f"{robot} shares its controller with other runs of the batch; run it in its own "
                "Simulation to change the controller"
            )
        angles = self.plant.actual[0, controlled.joints]
        before = controlled.in_use
        try:
            controlled.use(controller)
            controlled.controller.check(angles)
            if self.drives is not None and self.drives.loop is not None:
                linearised = controlled.linearised(angles)
                self.drives.check(robot, *linearised, has_springs=controlled.has_springs)
        except DeclarationError:
            controlled.in_use = before
            raise
        self._setup.has_changed = True

    def close(self) -> None:
        """Closes all controllers. The run cannot be continued."""
        for robot in self.controlled:
            robot.controller.controller.close()


def _robot_model(setup: BatchSetup, whole_body: WholeBody | None, robot: SerialRobot) -> RobotModel:
    model = setup.robot_model(robot)
    if whole_body is not None:
        model.follow((whole_body.mounting(robot.name), robot.base_frame, robot.n))
    return model


def _pose_of(free: Ints, qpos: Array) -> Array:
    at = qpos[free]
    return frame(rotation_from_quat(at[3:]), at[:3])
