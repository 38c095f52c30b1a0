"""Pushes, payloads and faults of a run, ordered by step, and the objects that robots carry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..base.frames import Array, Ints
from .disturbances import Fault, Force, Payload
from .external_loads import Push
from .plant import Plant, PlantRows
from .runs.run_log import event_of
from .scenario import Scenario


class TimedActions:
    """Scheduled actions. Actions of the same step run in the order in which they were added."""

    def __init__(self, timestep: float) -> None:
        self._timestep = timestep
        self._due: list[tuple[int, Callable[[], None]]] = []
        self._next = 0

    def add(self, time: float, action: Callable[[], None]) -> None:
        """Schedules an action for a time in seconds."""
        self._due.append((max(round(time / self._timestep), 0), action))
        self._due.sort(key=lambda entry: entry[0])

    @property
    def next(self) -> float:
        """Row at which the next action is due; infinite if there is none."""
        return self._due[self._next][0] if self._next < len(self._due) else math.inf

    def act(self, k: int) -> None:
        """Runs the actions that are due at log row k, before the next step."""
        while self._next < len(self._due) and self._due[self._next][0] <= k:
            self._due[self._next][1]()
            self._next += 1


class FaultSchedule:
    """Starts and ends the faults of a scenario.

    Args:
        gains: factor of each commanded torque, shape (n,); drive faults change it.
    """

    def __init__(self, scenario: Scenario, plant: Plant, due: TimedActions, gains: Array) -> None:
        self._scenario, self._plant, self._gains = scenario, plant, gains
        self._active: list[Fault] = []
        model, parts = plant.world.model, plant.world.robots
        self._friction = {
            name: (model.dof_damping[part.dofs].copy(), model.dof_frictionloss[part.dofs].copy())
            for name, part in parts.items()
        }
        for fault in scenario.faults.values():
            due.add(fault.begin, partial(self._begin, fault))
            if fault.end is not None:
                due.add(fault.end, partial(self._end, fault))

    def _begin(self, fault: Fault) -> None:
        self._active.append(fault)
        self._apply(fault)

    def _apply(self, fault: Fault) -> None:
        fault.apply(self._plant, fault.rows(self._scenario.scene.robots), self._gains)

    def _end(self, fault: Fault) -> None:
        self._active = [other for other in self._active if other is not fault]
        others = [other for other in self._active if other.part == fault.part]

        def apply_others() -> None:
            for other in others:
                self._apply(other)

        if fault.part == "sensors":
            self._plant.sensors.end_faults(apply_others)
            return
        if fault.part == "drives":
            self._gains[:] = 1.0
        else:
            for name, (viscous, coulomb) in self._friction.items():
                self._plant.set_friction(name, viscous, coulomb)
        apply_others()


class CarriedObjects:
    """The objects that robots carry in all runs of a batch. Their poses are logged together."""

    def __init__(self, plant: PlantRows) -> None:
        self._plant = plant
        # Flange body, T_flange_object and output poses of each object, by row and name.
        self._carried: dict[tuple[int, str], tuple[int, Array, Array]] = {}

    def __bool__(self) -> bool:
        return bool(self._carried)

    def take(self, plant: Plant, name: str, robot: str, grasp: Array, poses: Array) -> None:
        """Adds a carried object.

        Args:
            grasp: pose of the object at the flange, T_flange_object.
            poses: output array for the poses of the object in each step, shape (T, 16).
        """
        self._carried[plant.row, name] = plant.flange_body(robot), grasp, poses
        self._sort()

    def put_down(self, plant: Plant, name: str) -> None:
        """Removes a carried object."""
        del self._carried[plant.row, name]
        self._sort()

    def clear(self) -> None:
        self._carried.clear()

    def _sort(self) -> None:
        self._rows = [row for row, _ in self._carried]
        carried = self._carried.values()
        self._bodies: Ints = np.array([body for body, _, _ in carried], np.intp)
        self._grasps = np.array([grasp for _, grasp, _ in carried])
        self._written = [poses for _, _, poses in carried]

    def write(self, k: int) -> None:
        """Writes the current poses of all objects to row k of their output arrays."""
        poses = self._plant.physics.poses_of(self._rows, self._bodies) @ self._grasps
        for written, pose in zip(self._written, poses.reshape(-1, 16), strict=True):
            written[k] = pose


@dataclass
class EventSchedule:
    """The disturbances and faults of a scenario, ordered by step.

    Args:
        gains: factor of each commanded torque, shape (n,); drive faults change it.
        carried: carried objects of all runs of the batch.
    """

    scenario: Scenario
    plant: Plant
    steps: int
    gains: Array
    carried: CarriedObjects

    def __post_init__(self) -> None:
        self.gains[:] = 1.0
        self._due = TimedActions(self.scenario.run.timestep)
        self._varying: list[tuple[Push, Array]] = []  # pushes, and force and torque of every step
        self._objects: dict[str, Array] = {}  # initial T_world_object of carried objects
        self._columns: dict[str, slice] = {}
        self._log: Array = np.zeros((0, 0))
        self._now = 0  # row before the next step
        times = np.arange(self.steps + 1, dtype=np.float64) * self.scenario.run.timestep
        for disturbance in self.scenario.disturbances.values():
            if isinstance(disturbance, Force):
                self._plan_force(disturbance, times)
            elif isinstance(disturbance, Payload):
                self._plan_payload(disturbance)
        FaultSchedule(self.scenario, self.plant, self._due, self.gains)

    def before(self, k: int) -> None:
        self._now = k
        self._due.act(k)
        for push, forces in self._varying:
            push.wrench[...] = forces[k]

    @property
    def next(self) -> float:
        """Next row at which `before` changes anything, or infinity if there is none."""
        return 0 if self._varying else self._due.next

    def log_events(self) -> dict[str, str]:
        """Returns the log columns for applied forces and for poses of carried objects."""
        events: dict[str, str] = {}
        for name, disturbance in self.scenario.disturbances.items():
            if isinstance(disturbance, Force):
                events |= {event_of(name, key): "1V" for key in disturbance.acts_by}
        events.update({event_of(name, "frame"): "1M" for name in self._objects})
        return events

    def fill(self, columns: dict[str, slice], rows: Array) -> None:
        """Writes planned forces and initial poses to `rows`, the log that later poses go to."""
        times = rows[:, 0]
        self._columns, self._log = columns, rows
        for name, disturbance in self.scenario.disturbances.items():
            if not isinstance(disturbance, Force):
                continue
            found = disturbance.at_times(times)
            for i, key in enumerate(("force", "torque")):
                if (event := event_of(name, key)) in columns:
                    rows[:, columns[event]] = found[:, i]
        for name, frame in self._objects.items():
            rows[:, columns[event_of(name, "frame")]] = frame.ravel()

    def _plan_force(self, force: Force, times: Array) -> None:
        def begin() -> None:
            push = self.plant.push(
                force.at, force.force, force.torque, force.expressed_in, force.point
            )
            if force.profile != "step" or force.samples is not None:
                self._varying.append((push, force.at_times(times)))
            if force.end is not None and force.profile != "ramp":
                self._due.add(force.end, lambda: end(push))

        def end(push: Push) -> None:
            self._varying = [entry for entry in self._varying if entry[0] is not push]
            self.plant.release(push)

        self._due.add(force.begin, begin)

    def _plan_payload(self, payload: Payload) -> None:
        name = payload.object
        if name is not None:
            (declared,) = (each for each in self.scenario.scene.objects if each.name == name)
            self._objects[name] = np.array(declared.frame, np.float64)

        def poses_of(name: str) -> Array:
            return self._log[:, self._columns[event_of(name, "frame")]]

        def pick_up() -> None:
            self.plant.attach_payload(
                payload.robot, payload.mass, payload.center_of_mass, payload.inertia
            )
            if name is not None:
                grasp = payload.grasp
                if grasp is None:
                    pose = poses_of(name)[self._now].reshape(4, 4)
                    grasp = np.linalg.inv(self.plant.flange(payload.robot)) @ pose
                self.carried.take(
                    self.plant, name, payload.robot, np.asarray(grasp), poses_of(name)
                )

        def put_down() -> None:
            self.plant.detach_payload(payload.robot)
            if name is not None:
                self.carried.put_down(self.plant, name)
                poses = poses_of(name)
                poses[self._now :] = poses[self._now]

        self._due.add(payload.begin, pick_up)
        if payload.end is not None:
            self._due.add(payload.end, put_down)
