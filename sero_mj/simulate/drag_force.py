"""`DragForce`: pulls a link of a simulated robot by a spring to a point that is moved meanwhile."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from math import sqrt

import mujoco
import numpy as np

from ..base.errors import UsageError
from ..base.frames import Array
from .external_loads import Push
from .plant import Plant
from .runs.run_log import event_of
from .scenario import Scenario

LIMIT = 150.0  # N; what a person pulls with an arm
STIFFNESS = 500.0  # N/m, at first
STIFFNESS_RANGE = (20.0, 5000.0)  # N/m
STRONGER = 1.25  # factor of one step of the wheel
_DAMPING = 0.7  # of the critical one of the spring with the mass that the point feels like
_MOST_DAMPED = 0.5  # of the point's speed in a step: beyond 1 a damper would throw it back
_MOST_BENT = 0.25  # of the same for the spring, whose step is squared
_LIGHTEST = 1e-6  # 1/kg; what moves less has no degree of freedom
_DECIMALS = 3  # of forces, N: files of them are short, and say exactly what acted
_NAME = "by_hand"


@dataclass
class Pull:
    """A pull at one point, from grab to release.

    Attributes:
        at: the frame.
        point: (3,), in it, m.
        first: the row of the log from which on it acts.
        forces: (3,) of every step from then on, in the world, N.
    """

    at: str
    point: Array
    first: int
    forces: list[Array] = field(default_factory=list)


class DragForce:
    """Pulls a link of a simulated robot by a spring and a damper.

    The force in a step is k (target - point) - d v, at most `LIMIT`, with the state at its
    beginning; d makes the spring with what the point weighs (the smallest eigenvalue of
    (J M^-1 J^T)^-1) a damped oscillator. Stiffness and damping are as large as the step holds.

    Attributes:
        name: of the arrow that shows the force, and of its signals in the log.
        pulls: those until now, with that which acts.
        stiffness: k, N/m, as it is wished; set it at any time.
        target: (3,), where it pulls to, m, in the world; set it at any time.
        force: (3,), in the last step, N.
        place: (3,), where the grabbed point is, m, in the world.
        limit: of the force, N.
    """

    limit = LIMIT

    def __init__(self, plant: Plant, scenario: Scenario) -> None:
        scene = scenario.scene
        taken = {*scene.robots, *scene.doubles, *scene.arrows, *scene.frames, *scene.cameras}
        taken |= {*scenario.disturbances, *(each.name for each in scene.objects)}
        self.name = _NAME
        while self.name in taken or f"{self.name}_point" in taken:
            self.name += "_"
        self._plant, self._timestep = plant, scenario.run.timestep
        self._columns: tuple[slice, slice] = (slice(0, 0), slice(0, 0))
        self._rows: Array = np.zeros((0, 0))
        self.stiffness = STIFFNESS
        self._clear()

    def _clear(self) -> None:
        self.pulls: list[Pull] = []
        self.target: Array = np.zeros(3)
        self.force: Array = np.zeros(3)
        self.place: Array = np.zeros(3)
        self._push: _SpringPush | None = None  # that acts in the plant
        self._wanted: _SpringPush | None = None  # that is to act from the next step on

    def grab(self, frame: str, point: Array) -> None:
        """Grabs a point, from the next step on; pulls nothing until `target` is set.

        Args:
            frame: of the link, `lwr/link3`.
            point: (3,), in it, m.

        Raises:
            UnknownName: no such frame.
            UsageError: nothing there can move.
        """
        plant = self._plant
        push = _SpringPush(self, plant, frame, point)
        now = copy.copy(plant.data)  # leaves the plant's own data unchanged
        mujoco.mj_forward(plant.model, now)
        mobility = push.mobility(plant.model, now)
        if mobility < _LIGHTEST:
            raise UsageError(f"{frame} cannot move: nothing to pull")
        push.mass = 1.0 / mobility
        self.place = push.point(now).copy()
        self.target = self.place
        self._wanted = push

    def make_stronger(self, steps: float) -> None:
        """Makes the spring stiffer by so many steps of a wheel, softer for less than zero."""
        low, high = STIFFNESS_RANGE
        self.stiffness = min(max(self.stiffness * STRONGER**steps, low), high)

    def release(self) -> None:
        """Lets go, from the next step on."""
        self._wanted = None

    def gains(self, mass: float) -> tuple[float, float]:
        """Stiffness, N/m, and damping, N s/m, that the step holds for a mass, kg."""
        step = self._timestep
        stiffness = min(self.stiffness, _MOST_BENT * mass / step**2)
        damping = min(2 * _DAMPING * sqrt(stiffness * mass), _MOST_DAMPED * mass / step)
        return stiffness, damping

    def log_events(self) -> dict[str, str]:
        """Columns of the log: the force, and the frame at the point where it acts."""
        return {event_of(self.name, "force"): "1V", event_of(self.name, "frame"): "1M"}

    def begin(self, columns: dict[str, slice], rows: Array) -> None:
        """Discards all pulls, and continues with another log.

        Args:
            rows: (T, width), the log.
        """
        self._clear()
        force, frame = (columns[event] for event in self.log_events())
        self._columns, self._rows = (force, frame), rows
        rows[:, frame] = np.eye(4).ravel()

    def drop_oldest(self, dropped: int, kept: int) -> None:
        """Discards pulls in rows that the log has discarded.

        Args:
            kept: how many are left; those behind them have nothing yet.
        """
        for pull in self.pulls:
            pull.first -= dropped
            if pull.first < 0:
                del pull.forces[: -pull.first]
                pull.first = 0
        acting = self.pulls[-1] if self._push is not None else None
        self.pulls = [pull for pull in self.pulls if pull.forces or pull is acting]
        force, frame = self._columns
        self._rows[kept:, force], self._rows[kept:, frame] = 0.0, np.eye(4).ravel()

    def before(self, k: int) -> None:
        """Applies requested grabs and releases before the step after row k."""
        if self._wanted is not self._push:
            if self._push is not None:
                self._plant.release(self._push)
                self.force = np.zeros(3)
                self._rows[k, self._columns[0]] = self.force
            if self._wanted is not None:
                self._plant.add_push(self._wanted)
                self.pulls.append(Pull(self._wanted.frame, self._wanted.offset, k))
            self._push = self._wanted
        if self._push is not None:
            self._push.is_due = True

    def after(self, k: int) -> None:
        """Writes the pull of the step before row k, as long as it lasts."""
        if self._push is None:
            return
        self.force = self._push.force.copy()
        self.pulls[-1].forces.append(self.force)
        force, frame = self._columns
        self._rows[k - 1 : k + 1, force] = self.force
        pose = np.eye(4)
        pose[:3, 3] = self.place = self._push.place
        self._rows[k - 1 : k + 1, frame] = pose.ravel()


class _SpringPush(Push):
    """A push by the pointer's spring, updated in every step of the controllers.

    It is computed where pushes act, not before: what a step computes, and in which order, is then
    the same as where the scenario repeats it.

    Attributes:
        offset: (3,), the point in the frame, m.
        mass: that the point feels like, kg.
        place: (3,), the point in the world at the beginning of the step, m.
        is_due: whether a step of the controllers begins.
    """

    def __init__(self, drag: DragForce, plant: Plant, frame: str, point: Array) -> None:
        super().__init__(plant.world, frame, np.zeros(3), np.zeros(3), "world", point)
        self.offset = np.array(point, np.float64)
        self.mass = 1.0
        self.place: Array = np.zeros(3)
        self.is_due = True
        self._drag = drag
        self._jacobian: Array = np.zeros((3, plant.model.nv))

    def apply(self, model: mujoco.MjModel, data: mujoco.MjData, torques: Array) -> None:
        if self.is_due:
            self.is_due = False
            self.place = self.point(data).copy()
            mujoco.mj_jac(model, data, self._jacobian, None, self.place, self.body)
            stiffness, damping = self._drag.gains(self.mass)
            force = stiffness * (self._drag.target - self.place)
            force -= damping * (self._jacobian @ data.qvel)
            force *= min(1.0, LIMIT / max(float(np.linalg.norm(force)), 1e-9))
            self.force[:] = np.round(force, _DECIMALS)
        super().apply(model, data, torques)

    def mobility(self, model: mujoco.MjModel, data: mujoco.MjData) -> float:
        """The largest acceleration of the point by a force of 1 N, 1/kg: of J M^-1 J^T."""
        mujoco.mj_jac(model, data, self._jacobian, None, self.point(data), self.body)
        accelerations = np.zeros_like(self._jacobian)
        mujoco.mj_solveM(model, data, accelerations, self._jacobian)
        return float(np.linalg.eigvalsh(self._jacobian @ accelerations.T)[-1])
