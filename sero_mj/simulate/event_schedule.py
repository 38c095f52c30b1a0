"""`EventSchedule`: pushes, payloads and faults of a run, ordered by step; `CarriedObjects`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.frames import Array, Ints
from .disturbances import Force, Payload
from .due_actions import DueActions
from .external_loads import Push
from .fault_schedule import FaultSchedule
from .plant import Plant, PlantRows
from .runs.run_log import event_of
from .scenario import Scenario


class CarriedObjects:
    """Objects that robots of any rows carry, whose poses are computed and logged together.

    Args:
        plant: with the robots of all rows.
    """

    def __init__(self, plant: PlantRows) -> None:
        self._plant = plant
        # By row and name: the flange's body, T_flange_object, and where poses are written.
        self._carried: dict[tuple[int, str], tuple[int, Array, Array]] = {}

    def __bool__(self) -> bool:
        return bool(self._carried)

    def take(self, plant: Plant, name: str, robot: str, grasp: Array, poses: Array) -> None:
        """Lets an object be carried.

        Args:
            plant: the robots of its row.
            name: of the object.
            robot: name of the one that carries it.
            grasp: T_flange_object.
            poses: (T, 16), its poses at every step, to be written.
        """
        self._carried[plant.row, name] = plant.flange_body(robot), grasp, poses
        self._sort()

    def put_down(self, plant: Plant, name: str) -> None:
        """Lets an object be carried no more."""
        del self._carried[plant.row, name]
        self._sort()

    def clear(self) -> None:
        """Lets none be carried."""
        self._carried.clear()

    def _sort(self) -> None:
        self._rows = [row for row, _ in self._carried]
        carried = self._carried.values()
        self._bodies: Ints = np.array([body for body, _, _ in carried], np.intp)
        self._grasps = np.array([grasp for _, grasp, _ in carried])
        self._written = [poses for _, _, poses in carried]

    def write(self, k: int) -> None:
        """Writes where they are now into the rows k of their poses."""
        poses = self._plant.physics.poses_of(self._rows, self._bodies) @ self._grasps
        for written, pose in zip(self._written, poses.reshape(-1, 16), strict=True):
            written[k] = pose


@dataclass
class EventSchedule:
    """The disturbances and faults of a scenario, ordered by step.

    Args:
        scenario: with its disturbances and faults.
        plant: to which they are applied.
        steps: of the run.
        gains: (n,), factors of the commanded torques, after the limits: those of faulty drives; to
            be written.
        carried: the objects that robots carry, those of other runs in a batch as well.
    """

    scenario: Scenario
    plant: Plant
    steps: int
    gains: Array
    carried: CarriedObjects

    def __post_init__(self) -> None:
        self.gains[:] = 1.0
        self._due = DueActions(self.scenario.run.timestep)
        self._varying: list[tuple[Push, Array]] = []  # with force and torque at every step
        self._objects: dict[str, Array] = {}  # T_world_object at first, of those picked up
        self._columns: dict[str, slice] = {}
        self._log: Array = np.zeros((0, 0))
        self._now = 0  # the row before the step to come
        times = np.arange(self.steps + 1, dtype=np.float64) * self.scenario.run.timestep
        for disturbance in self.scenario.disturbances.values():
            if isinstance(disturbance, Force):
                self._plan_force(disturbance, times)
            elif isinstance(disturbance, Payload):
                self._plan_payload(disturbance)
        FaultSchedule(self.scenario, self.plant, self._due, self.gains)

    def before(self, k: int) -> None:
        """Applies the events due at row k, before the step after it."""
        self._now = k
        self._due.act(k)
        for push, forces in self._varying:
            push.wrench[...] = forces[k]

    @property
    def next(self) -> float:
        """The next row at which `before` changes anything; infinite for none."""
        return 0 if self._varying else self._due.next

    def log_events(self) -> dict[str, str]:
        """Further columns of the log: forces as they act, and objects that are carried."""
        events: dict[str, str] = {}
        for name, disturbance in self.scenario.disturbances.items():
            if isinstance(disturbance, Force):
                events |= {event_of(name, key): "1V" for key in disturbance.acts_by}
        events.update({event_of(name, "frame"): "1M" for name in self._objects})
        return events

    def fill(self, columns: dict[str, slice], rows: Array) -> None:
        """Writes events known in advance into the log, and keeps it for carried objects.

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
