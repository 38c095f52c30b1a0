"""`ControlledRobot`: a robot of a plant, its controller, and its observer of external torques."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np

from ..base.frames import Array
from ..robots.declared.robot import SerialRobot
from .control.controller import ControllerDeclaration, LinkHolder, Sensed, Successor, Target
from .control.make_controller import LimitedController, make_controller
from .control.model_rows import ModelRows
from .control.observer import MomentumObserver
from .control.plan import Plan
from .control.robot_model import RobotModel
from .control.torque_loop import HangingLinks
from .drives import Drives
from .plant_rows import PlantRow, PlantRows
from .scenario import Scenario

_ROUNDS = 30  # of `HangingLinks`, until less than 0.2 % of the first deviation is left
_MOVE = 1e-5  # rad and rad/s, between which controllers are linear


class RobotControl:
    """What a controller senses, is asked for and commands: of one robot, or of it in many rows.

    Args:
        robot: as it stands in the world at first.
        plant: that it is in: one row, or all of them, which are then the first axis of all.
        drive: (2, N), torques of all joints of the plant, Nm or N: commanded, and asked for before
            the limits; its own are written there.

    Attributes:
        robot: as given.
        joints: which joints of the plant are its own.
        sensed: what it senses.
        target: what it is asked for, to be written into.
        controller: behind its torque limits; to be set.
        hanging: where the links of elastic joints rest; None where that does not matter.
        moving: parts of `target.planned` with what stands there at every step, (T, k).
    """

    controller: LimitedController

    def __init__(self, robot: SerialRobot, plant: PlantRow | PlantRows, drive: Array) -> None:
        self.robot, self.joints = robot, plant.world.robots[robot.name].joints
        measured = plant.measured[..., self.joints]
        rows = measured.shape[:-2]
        self.commanded = drive[..., 0, self.joints]
        self.requested = drive[..., 1, self.joints]
        # Springs and dampers act on the motors of elastic joints, which have encoders of their own.
        motor_state = np.zeros((*rows, 2 * robot.n)) if robot.elastic_joints else None
        # What is measured of the only robot is used in place.
        values = measured if measured.flags.c_contiguous else None
        self.sensed = sensed = Sensed(robot.n, values, motor_state, rows)
        self._copies: list[tuple[Array, Array]] = []  # of what else is measured: to, from; views
        if values is None:
            self._copies.append((sensed.values, measured))
        if robot.elastic_joints:
            self._copies += [
                (sensed.motor_angles, plant.motor_angles[..., self.joints]),
                (sensed.motor_velocities, plant.motor_velocities[..., self.joints]),
            ]
        self.target = Target(robot.n, rows)
        self.target.posture[:] = robot.home
        self.hanging: HangingLinks | None = None
        self.moving: list[tuple[Array, Array]] = []

    def sense(self) -> None:
        """Passes the measurements on to the controller."""
        for sensed, measured in self._copies:
            sensed[...] = measured
        if self.hanging is not None:
            self.sensed.motor_angles[...] = self.hanging.link_angles(self.sensed.motor_angles)

    def command(self, k: int, time: float) -> None:
        """Computes `commanded` for the step after row k of the log.

        Args:
            k: the row.
            time: of it, s.

        Raises:
            SimulationError: a torque of the only robot is NaN or infinite.
        """
        self.sense()
        self.sensed.time = time
        for planned, rows in self.moving:
            planned[...] = rows[k]
        self.controller.torques(self.sensed, self.target, self.commanded)

    def use_limited(self, controller: LimitedController) -> None:
        """Replaces the controller."""
        controller.requested = self.requested
        self.controller = controller


class ControlledRobot(RobotControl):
    """A robot of a row of a plant with its controller, and the observer of its external torques.

    Args:
        robot: as it stands in the world at first.
        scenario: what is run.
        plant: that it is in.
        drives: between its controller and the plant; None where there are none.
        make_model: of what its controller knows of it; not kept.
        observer_model: the same for its observer; it is moved before it is asked.
        plan: its target at every step.
        drive: see `RobotControl`.
        observed_every: steps between two estimates of the external torques.

    Attributes:
        declared: its controller.
        is_joined: whether it is commanded with those of other rows, see `join`.

    Raises:
        DeclarationError: gains or limits do not fit the robot.
    """

    def __init__(
        self,
        robot: SerialRobot,
        scenario: Scenario,
        plant: PlantRow,
        drives: Drives | None,
        make_model: Callable[[SerialRobot], RobotModel],
        observer_model: RobotModel,
        plan: Plan,
        drive: Array,
        observed_every: int,
    ) -> None:
        super().__init__(robot, plant, drive)
        self._timestep, self.is_joined = scenario.run.timestep, False
        self._joint_stiffness: Array | None = None
        if robot.elastic_joints and drives is not None and drives.loop:
            self._joint_stiffness = drives.gains[robot.name].stiffness
        self.declared = scenario.controller_of(robot.name)
        controller, self.hanging = self._made(self.declared, make_model)
        self.use_limited(controller)
        self.target.has_torques = False  # no target motion has any
        planned = self.target.planned[: plan.rows.shape[1]]
        planned[...] = plan.rows[0]
        if plan.moves:
            self.moving = [(planned, plan.rows)]
        self._observer = MomentumObserver(
            observer_model,
            scenario.run.observer_gain,
            self._timestep * observed_every,
        )
        self.sense()
        self._observer.update(self.sensed)

    def use(self, declared: Any, make_model: Callable[[SerialRobot], RobotModel]) -> None:
        """Replaces the controller of the robot.

        Args:
            declared: see `Scenario.controllers`.
            make_model: of what it knows of the robot; not kept.

        Raises:
            DeclarationError: gains or limits do not fit the robot.
        """
        controller, hanging = self._made(declared, make_model)
        before, after = self.controller.controller, controller.controller
        if type(before) is type(after) and isinstance(after, Successor):
            after.take_over(before)
        self.declared, self.hanging = declared, hanging
        self.use_limited(controller)

    def _made(
        self, declared: Any, make_model: Callable[[SerialRobot], RobotModel]
    ) -> tuple[LimitedController, HangingLinks | None]:
        """Makes a declared controller, and finds where links of elastic joints rest under it."""
        robot, stiffness = self.robot, self._joint_stiffness
        controller = make_controller(
            declared, make_model(robot), self._timestep, robot.torque_limits
        )
        if stiffness is None:
            return controller, None
        return controller, _hanging(stiffness, controller, make_model(robot), robot.home)

    @property
    def in_use(self) -> tuple[Any, LimitedController, HangingLinks | None]:
        """Its controller as declared, and as made; and where the links of elastic joints rest."""
        return self.declared, self.controller, self.hanging

    @in_use.setter
    def in_use(self, value: tuple[Any, LimitedController, HangingLinks | None]) -> None:
        self.declared, self.controller, self.hanging = value

    @property
    def has_springs(self) -> bool:
        """Whether a stiffness is declared, for which its damping is designed."""
        return hasattr(self.declared, "stiffness")

    def linearised(
        self, make_model: Callable[[SerialRobot], RobotModel], angles: Array
    ) -> tuple[Array, Array, Array]:
        """Linearises the robot and its controller about a target pose at rest.

        Args:
            make_model: as for `use`.
            angles: (n,), rad or m.

        Returns:
            the links' mass matrix, and stiffness and damping matrix: the slopes by which torques
            fall with angles and with velocities, without limits. Compensation of gravity, whose
            slope gravity takes away, is left out: of the stiffness only what pulls back. Both are
            zero for a controller that is not declared, because asking it may change it. (n, n)
            each.
        """
        n, model = len(angles), make_model(self.robot)
        slopes: Array = np.zeros((2, n, n))
        model.update(angles, np.zeros(n))
        mass = model.mass() - np.diag(model.motor_inertia)
        declared = self.declared
        if isinstance(declared, ControllerDeclaration) and declared.may_be_asked:
            controller = declared.make(make_model(self.robot), self._timestep)
            sensed, target, torques = Sensed(n), Target(n), np.zeros((2, n))
            target.angles[:] = target.posture[:] = angles
            target.pose[:] = model.flange()
            target.has_torques = False
            stiffness = self._joint_stiffness
            bends: Array = np.zeros((2, n))  # of elastic joints: at first, and now; else zero
            if stiffness is not None:
                at_rest = model.gravity()
                if isinstance(controller, LinkHolder):
                    at_rest = controller.hold_links(stiffness)
                bends[:] = model.gravity() / stiffness
            for k, joint in product(range(2), range(n)):
                for torque, move in zip(torques, (_MOVE, -_MOVE), strict=True):
                    for _ in range(_ROUNDS if stiffness is not None and k == 0 else 1):
                        sensed.values[:2] = angles + bends[0] - bends[1], np.zeros(n)
                        sensed.values[k, joint] += move
                        controller.torques(sensed, target, torque)
                        if stiffness is not None:
                            bends[1] = at_rest / stiffness
                    bends[1] = bends[0]
                slopes[k, :, joint] = (torques[1] - torques[0]) / (2 * _MOVE)
            values, vectors = np.linalg.eigh((slopes[0] + slopes[0].T) / 2)
            slopes[0] = (vectors * np.maximum(values, 0.0)) @ vectors.T
        return mass, *slopes

    def observe(self, measured: Array) -> Array:
        """Estimates the external torques after further steps, see `observe`."""
        return observe(self._observer, measured[..., self.joints])


def observe(observer: MomentumObserver, measured: Array) -> Array:
    """Estimates the external torques of a robot after further steps, (n,), Nm or N.

    The observer gets the mean of the measured torques: that is what changed the momentum meanwhile.

    Args:
        observer: of the robot, or of it in many rows, which are then an axis behind that of steps.
        measured: (steps, 3, n), its angles, velocities and torques in these steps.

    Returns:
        the estimate, which stands until the next; the same array every time.
    """
    angles, velocities = measured[-1, ..., 0, :], measured[-1, ..., 1, :]
    mean = np.add.reduce(measured[..., 2, :]) / len(measured)
    observer.model.update(angles, velocities)
    return observer.update_with(velocities, mean)


def _are_same(moving: Sequence[tuple[Array, Array]]) -> bool:
    """Whether all rows get the same at every step."""
    return all(rows is moving[0][1] for _, rows in moving)


def join_observers(each: Sequence[ControlledRobot], model: RobotModel) -> MomentumObserver:
    """One observer for a robot in all rows of a plant.

    Args:
        each: the robot in every row, at one step.
        model: of one of them, for itself.
    """
    return MomentumObserver.joined([one._observer for one in each], ModelRows(model, len(each)))


def _hanging(
    stiffness: Array, controller: LimitedController, model: RobotModel | ModelRows, angles: Array
) -> HangingLinks:
    """The resting positions of links held by a controller; see `HangingLinks`."""
    held = controller.controller
    at_rest = held.hold_links(stiffness) if isinstance(held, LinkHolder) else None
    return HangingLinks(stiffness, at_rest, model, angles)


def join(
    each: Sequence[ControlledRobot], plant: PlantRows, drive: Array, model: RobotModel
) -> RobotControl | None:
    """One control for a robot in all rows of a plant, before their first step.

    Args:
        each: the robot in every row.
        plant: with all rows.
        drive: (m, 2, N), see `RobotControl`.
        model: of one of them, for itself.

    Returns:
        None where controllers are of several kinds, or of one that has no form for many rows.
    """
    models = ModelRows(model, len(each))
    controller = LimitedController.joined([one.controller for one in each], models)
    if controller is None:
        return None
    first = each[0]
    made = RobotControl(first.robot, plant, drive)
    made.use_limited(controller)
    made.target.has_torques = False
    if first._joint_stiffness is not None:
        home = np.tile(first.robot.home, (len(each), 1))
        made.hanging = _hanging(first._joint_stiffness, controller, models, home)
    planned = made.target.planned
    for one, own in zip(each, planned, strict=True):
        own[...] = one.target.planned
        made.moving += [(own[: rows.shape[1]], rows) for _, rows in one.moving]
        one.is_joined = True
    if made.moving and len(made.moving) == len(each) and _are_same(made.moving):
        _, rows = made.moving[0]
        made.moving = [(planned[:, : rows.shape[1]], rows)]
    made.sense()
    return made
