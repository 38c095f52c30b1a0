"""What happens in a run besides control, step by step: pushes, payloads, faults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..runs.run_log import event_of
from .disturbances import Force, Payload
from .faults import Fault
from .plant import Plant
from .push import Push
from .scenario import Scenario

Array = NDArray[np.float64]


@dataclass
class Happenings:
    """The disturbances and faults of a scenario, ordered by step.

    Args:
        scenario: what happens.
        plant: that it happens to.
        steps: of the run.

    Attributes:
        gains: (n,), what the torques that controllers ask for are multiplied by.
        is_tampered: whether any of them is not 1.
    """

    scenario: Scenario
    plant: Plant
    steps: int
    gains: Array = field(init=False)
    is_tampered: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        model = self.plant.model
        self.gains = np.ones(self.plant.n)
        self._due: list[tuple[int, Callable[[], None]]] = []
        self._growing: list[tuple[Push, Force, Array]] = []
        self._carried: dict[str, tuple[str, Array]] = {}  # object to robot and T_flange_object
        self._objects: dict[str, Array] = {}  # where objects that are picked up are
        self._columns: dict[str, slice] = {}
        self._log: Array = np.zeros((0, 0))
        times = np.arange(self.steps + 1, dtype=np.float64) * self.plant.timestep
        for disturbance in self.scenario.disturbances.values():
            if isinstance(disturbance, Force):
                self._plan_force(disturbance, times)
            elif isinstance(disturbance, Payload):
                self._plan_payload(disturbance)
        self._broken: list[Fault] = []
        self._friction = {
            name: (model.dof_damping[part.dofs].copy(), model.dof_frictionloss[part.dofs].copy())
            for name, part in self.plant.world.robots.items()
        }
        for fault in self.scenario.faults.values():
            self._at(fault.begin, partial(self._break, fault))
            if fault.end is not None:
                self._at(fault.end, partial(self._mend, fault))
        self._due.sort(key=lambda entry: entry[0])
        self._next = 0

    @property
    def next_step(self) -> int:
        """The last step that nothing new happens before; beyond the end when nothing will."""
        return self._due[self._next][0] if self._next < len(self._due) else self.steps + 1

    @property
    def is_growing(self) -> bool:
        """Whether a push changes from step to step: then `before` is to be called for each."""
        return bool(self._growing)

    def before(self, k: int) -> None:
        """Does what is due at row k, before the step that leads on from it."""
        while self._next < len(self._due) and self._due[self._next][0] <= k:
            self._due[self._next][1]()
            self._next += 1
        for push, force, share in self._growing:
            np.multiply(force.force, share[k], push.force)
            np.multiply(force.torque, share[k], push.torque)

    def others(self) -> dict[str, str]:
        """Further events of the log: forces as they act, and objects that are carried."""
        events = {}
        for name, disturbance in self.scenario.disturbances.items():
            if isinstance(disturbance, Force):
                for key in ("force", "torque"):
                    if getattr(disturbance, key).any():
                        events[event_of(name, key)] = "1V"
        events.update({event_of(name, "frame"): "1M" for name in self._objects})
        return events

    def fill(self, columns: dict[str, slice], rows: Array) -> None:
        """Writes what is known before the run into its log, (T, width)."""
        times = rows[:, 0]
        self._columns, self._log = columns, rows
        for name, disturbance in self.scenario.disturbances.items():
            if not isinstance(disturbance, Force):
                continue
            share = disturbance.share(times)[:, None]
            for key in ("force", "torque"):
                if (event := event_of(name, key)) in columns:
                    rows[:, columns[event]] = share * getattr(disturbance, key)
        for name, frame in self._objects.items():
            rows[:, columns[event_of(name, "frame")]] = frame.ravel()

    @property
    def carries(self) -> bool:
        """Whether any object goes with a robot now."""
        return bool(self._carried)

    def place_objects(self, columns: dict[str, slice], row: Array) -> None:
        """Writes where objects are now into a row of the log."""
        for name, (robot, grasp) in self._carried.items():
            self._objects[name] = self._flange(robot) @ grasp
            row[columns[event_of(name, "frame")]] = self._objects[name].ravel()

    def _at(self, time: float, action: Callable[[], None]) -> None:
        self._due.append((max(round(time / self.plant.timestep), 0), action))

    def _plan_force(self, force: Force, times: Array) -> None:
        def begin() -> None:
            push = self.plant.push(force.at, force.force, force.torque, force.expressed_in)
            if force.profile != "step":
                self._growing.append((push, force, force.share(times)))
            if force.end is not None and force.profile != "ramp":
                self._due.append((round(force.end / self.plant.timestep), lambda: end(push)))
                self._due.sort(key=lambda entry: entry[0])

        def end(push: Push) -> None:
            self._growing = [entry for entry in self._growing if entry[0] is not push]
            self.plant.release(push)

        self._at(force.begin, begin)

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
                    grasp = np.linalg.inv(self._flange(payload.robot)) @ self._objects[name]
                self._carried[name] = (payload.robot, np.asarray(grasp))

        def put_down() -> None:
            self.plant.detach_payload(payload.robot)
            if name is not None:
                self._carried.pop(name)
                k = round(payload.end / self.plant.timestep) if payload.end else self.steps
                self._log[k:, self._columns[event_of(name, "frame")]] = self._objects[name].ravel()

        self._at(payload.begin, pick_up)
        if payload.end is not None:
            self._at(payload.end, put_down)

    def _flange(self, robot: str) -> Array:
        """T_world_flange now, as the plant has it."""
        self.plant.joints.look()
        body = self.plant.world.robots[robot].flange_body
        frame = np.eye(4)
        frame[:3, :3] = self.plant.data.xmat[body].reshape(3, 3)
        frame[:3, 3] = self.plant.data.xpos[body]
        return frame

    def _break(self, fault: Fault) -> None:
        self._broken.append(fault)
        fault.happen(self.plant, self.gains)
        self.is_tampered = bool((self.gains != 1.0).any())

    def _mend(self, fault: Fault) -> None:
        """Ends a fault; others of the same part go on, in the order in which they began."""
        self._broken = [other for other in self._broken if other is not fault]
        others = [other for other in self._broken if other.part == fault.part]

        def go_on() -> None:
            for other in others:
                other.happen(self.plant, self.gains)

        if fault.part == "sensors":
            self.plant.sensors.mend(go_on)
            return
        if fault.part == "drives":
            self.gains[:] = 1.0
        else:
            for name, (viscous, coulomb) in self._friction.items():
                self.plant.set_friction(name, viscous, coulomb)
        go_on()
        self.is_tampered = bool((self.gains != 1.0).any())
