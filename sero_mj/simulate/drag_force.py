"""`DragForce`: pulls a link of a simulated robot toward a moving point with a spring."""

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

LIMIT = 150.0  # maximum force, N; a person can pull with about this force with one arm
STIFFNESS = 500.0  # initial stiffness, N/m
STIFFNESS_RANGE = (20.0, 5000.0)  # range of the stiffness, N/m
STRONGER = 1.25  # stiffness factor of one wheel notch
_DAMPING = 0.7  # damping ratio with the apparent mass of the point
_MAX_DAMPED = 0.5  # maximum d T / m; a damper above 1 would reverse the motion in a step
_MAX_SPRING = 0.25  # maximum k T^2 / m
_MIN_MOBILITY = 1e-6  # minimum mobility of a link that can move, 1/kg
_DECIMALS = 3  # decimal places of forces in N, so that files are short and exact
_NAME = "by_hand"


@dataclass
class Pull:
    """A pull at one point, from grab to release.

    Attributes:
        at: name of the frame that is pulled.
        point: pulled point in the frame, shape (3,), m.
        first: first log row in which the pull acts.
        forces: force in each step, in world axes, shape (3,), N.
    """

    at: str
    point: Array
    first: int
    forces: list[Array] = field(default_factory=list)


class DragForce:
    """Pulls a link of a simulated robot with a spring and a damper.

    The force in a step is k (target - point) - d v, limited to `LIMIT`, with the state at the
    beginning of the step. The damping d makes a damped oscillator of the spring and the apparent
    mass of the point (the smallest eigenvalue of (J M^-1 J^T)^-1). Stiffness and damping are
    reduced if they would be unstable at the timestep.

    Attributes:
        name: name of the force arrow and of the signals in the log.
        pulls: all pulls, including the active one.
        stiffness: requested stiffness k, N/m; may be set at any time.
        target: point to pull toward, shape (3,), m, in the world; may be set at any time.
        force: force of the last step, shape (3,), N.
        place: position of the grabbed point, shape (3,), m, in the world.
        limit: maximum force, N.
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
        self._push: _SpringPush | None = None  # active in the plant
        self._wanted: _SpringPush | None = None  # requested from the next step on

    def grab(self, frame: str, point: Array) -> None:
        """Grabs a point of a link from the next step on. Set `target` to pull the point.

        Args:
            frame: frame of the link, for example `lwr/link3`.
            point: grabbed point in the frame, shape (3,), m.

        Raises:
            UnknownName: there is no such frame.
            UsageError: the link cannot move.
        """
        plant = self._plant
        push = _SpringPush(self, plant, frame, point)
        now = copy.copy(plant.data)  # leaves the plant's own data unchanged
        mujoco.mj_forward(plant.model, now)
        mobility = push.mobility(plant.model, now)
        if mobility < _MIN_MOBILITY:
            raise UsageError(f"{frame} cannot be pulled: it has no degree of freedom")
        push.mass = 1.0 / mobility
        self.place = push.point(now).copy()
        self.target = self.place
        self._wanted = push

    def make_stronger(self, steps: float) -> None:
        """Makes the spring stiffer by a number of wheel notches, or softer if it is negative."""
        low, high = STIFFNESS_RANGE
        self.stiffness = min(max(self.stiffness * STRONGER**steps, low), high)

    def release(self) -> None:
        """Releases the point from the next step on."""
        self._wanted = None

    def gains(self, mass: float) -> tuple[float, float]:
        """Returns stable stiffness (N/m) and damping (N s/m) for a mass in kg."""
        step = self._timestep
        stiffness = min(self.stiffness, _MAX_SPRING * mass / step**2)
        damping = min(2 * _DAMPING * sqrt(stiffness * mass), _MAX_DAMPED * mass / step)
        return stiffness, damping

    def log_events(self) -> dict[str, str]:
        """Returns the log columns of the force and of a frame at the point of application."""
        return {event_of(self.name, "force"): "1V", event_of(self.name, "frame"): "1M"}

    def begin(self, columns: dict[str, slice], rows: Array) -> None:
        """Discards all pulls and continues with another log `rows`, shape (T, width)."""
        self._clear()
        force, frame = (columns[event] for event in self.log_events())
        self._columns, self._rows = (force, frame), rows
        rows[:, frame] = np.eye(4).ravel()

    def drop_oldest(self, dropped: int, kept: int) -> None:
        """Discards the pulls in the oldest `dropped` log rows, after which `kept` rows remain."""
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
        """Applies requested grabs and releases before the step after log row k."""
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
        """Logs the force of the step that led to log row k."""
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
    """The push of the drag spring, which computes its force when the plant applies it.

    A scenario with the recorded forces applies them in the same way, with identical results.

    Attributes:
        mass: apparent mass of the point, kg.
        place: position of the point at the beginning of the step, in the world, shape (3,), m.
        is_due: whether a step of the controllers has begun, for which a force must be computed.
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
        """Returns the point's largest acceleration per force, 1/kg (eigenvalue of J M^-1 J^T)."""
        mujoco.mj_jac(model, data, self._jacobian, None, self.point(data), self.body)
        accelerations = np.zeros_like(self._jacobian)
        mujoco.mj_solveM(model, data, accelerations, self._jacobian)
        return float(np.linalg.eigvalsh(self._jacobian @ accelerations.T)[-1])
