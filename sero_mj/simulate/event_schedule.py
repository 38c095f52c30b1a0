"""`EventSchedule`: pushes, payloads and faults of a run, ordered by step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.frames import Array
from .disturbances import Force, Payload
from .due_actions import DueActions
from .external_loads import Push
from .fault_schedule import FaultSchedule
from .plant_rows import PlantRow
from .runs.run_log import event_of
from .scenario import Scenario


@dataclass
class EventSchedule:
    """The disturbances and faults of a scenario, ordered by step.

    Args:
        scenario: with its disturbances and faults.
        plant: to which they are applied.
        steps: of the run.
        gains: (n,), factors of the commanded torques, after the limits: those of faulty drives; to
            be written.
    """

    scenario: Scenario
    plant: PlantRow
    steps: int
    gains: Array

    def __post_init__(self) -> None:
        self.gains[:] = 1.0
        self._due = DueActions(self.scenario.run.timestep)
        self._varying: list[tuple[Push, Array]] = []  # with force and torque at every step
        # By object: its robot, T_flange_object, and its columns in the log.
        self._carried: dict[str, tuple[str, Array, slice]] = {}
        self._objects: dict[str, Array] = {}  # T_world_object of objects that are picked up
        self._columns: dict[str, slice] = {}
        self._log: Array = np.zeros((0, 0))
        self._timestep = self.scenario.run.timestep
        times = np.arange(self.steps + 1, dtype=np.float64) * self._timestep
        for disturbance in self.scenario.disturbances.values():
            if isinstance(disturbance, Force):
                self._plan_force(disturbance, times)
            elif isinstance(disturbance, Payload):
                self._plan_payload(disturbance)
        FaultSchedule(self.scenario, self.plant, self._due, self.gains)

    @property
    def carries(self) -> bool:
        """Whether any object is carried during the run."""
        return bool(self._objects)

    def before(self, k: int) -> None:
        """Applies the events due at row k, before the step after it."""
        self._due.act(k)
        for push, forces in self._varying:
            push.force[:], push.torque[:] = forces[k]

    @property
    def next(self) -> float:
        """The next row at which `before` changes anything; infinite for none."""
        return 0 if self._varying else self._due.next

    def after(self, k: int) -> None:
        """Writes the poses of carried objects into row k of the log."""
        for name, (robot, grasp, columns) in self._carried.items():
            self._objects[name] = pose = self.plant.flange(robot) @ grasp
            self._log[k, columns] = pose.ravel()

    def log_events(self) -> dict[str, str]:
        """Further columns of the log: forces as they act, and objects that are carried."""
        events: dict[str, str] = {}
        for name, disturbance in self.scenario.disturbances.items():
            if isinstance(disturbance, Force):
                events |= {event_of(name, key): "1V" for key in disturbance.acts_by}
        events.update({event_of(name, "frame"): "1M" for name in self._objects})
        return events

    def fill(self, columns: dict[str, slice], rows: Array) -> None:
        """Writes events known in advance into the log, and keeps the log for `after`.

        Args:
            columns: of every event.
            rows: (T, width), the log.
        """
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

        def pick_up() -> None:
            self.plant.attach_payload(
                payload.robot, payload.mass, payload.center_of_mass, payload.inertia
            )
            if name is not None:
                grasp = payload.grasp
                if grasp is None:
                    grasp = np.linalg.inv(self.plant.flange(payload.robot)) @ self._objects[name]
                columns = self._columns[event_of(name, "frame")]
                self._carried[name] = payload.robot, np.asarray(grasp), columns

        def put_down() -> None:
            self.plant.detach_payload(payload.robot)
            if name is not None:
                self._carried.pop(name)
                k = round(payload.end / self._timestep) if payload.end else self.steps
                self._log[k:, self._columns[event_of(name, "frame")]] = self._objects[name].ravel()

        self._due.add(payload.begin, pick_up)
        if payload.end is not None:
            self._due.add(payload.end, put_down)
