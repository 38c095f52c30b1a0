"""`ControlledRobot`: a robot with its controller. `RobotControl`: computes torques in each step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np

from ..base.frames import Array
from ..robots.declared.robot import SerialRobot
from .control.controller import ControllerDeclaration, Sensed, Target
from .control.make_controller import LimitedController, make_controller
from .control.plan import Plan
from .control.robot_model import RobotModel
from .control.robot_models import RobotModels
from .control.torque_loop import StaticDeflection
from .joint_model import as_slice
from .plant import Plant, PlantRows

_ROUNDS = 30  # iterations of `StaticDeflection`, after which less than 0.2 % of the error remains
_MOVE = 1e-5  # step of the numeric derivatives, rad and rad/s


class ControlledRobot:
    """A robot of a run with its controller and target.

    Args:
        stiffness: stiffness of elastic joints behind a torque loop, shape (n,), Nm/rad (N/m), or
            None if there are none.
        make_model: function that returns a new model of a robot for its controller.

    Attributes:
        joints: slice of the robot's joints in the plant.
        controller: controller with its torque limits.
        control: object that computes the torques, possibly for several robots.

    Raises:
        DeclarationError: gains or limits do not fit the robot.
    """

    control: RobotControl

    def __init__(
        self,
        robot: SerialRobot,
        plant: Plant,
        declared: Any,
        plan: Plan,
        timestep: float,
        stiffness: Array | None,
        make_model: Callable[[SerialRobot], RobotModel],
    ) -> None:
        self.robot, self.plan, self.stiffness = robot, plan, stiffness
        self.joints: slice = plant.world.robots[robot.name].joints
        self._timestep, self._make_model = timestep, make_model
        self.target = Target(robot.n)
        self.target.posture[:] = robot.home
        self.target.has_torques = False
        plan.write(0, self.target)
        self.declared, self.controller = declared, self._made(declared)

    def _made(self, declared: Any) -> LimitedController:
        robot = self.robot
        model = self._make_model(robot)
        made = make_controller(declared, model, self._timestep, robot.torque_limits)
        if self.stiffness is not None:
            self._at_rest = made.controller.hold_links(self.stiffness)
        return made

    @property
    def sensed(self) -> Sensed:
        """Input of the controller if it controls only this robot."""
        return self.control.sensed

    def use(self, declared: Any) -> None:
        """Replaces the controller. Raises DeclarationError if gains or limits do not fit."""
        made = self._made(declared)
        before = self.controller.controller
        if type(before) is type(made.controller):
            made.controller.take_over(before)
        self.declared, self.controller = declared, made

    @property
    def in_use(self) -> tuple[Any, LimitedController]:
        """Declaration of the current controller, and the controller itself."""
        return self.declared, self.controller

    @in_use.setter
    def in_use(self, value: tuple[Any, LimitedController]) -> None:
        self.declared, self.controller = value

    @property
    def group(self) -> object:
        """Hashable key: robots with equal keys can share a `RobotControl`. None for no sharing."""
        controller = self.controller.controller
        if controller.group is None:
            return None
        return controller.group, self.stiffness is None, bool(self.robot.elastic_joints)

    def deflection(self) -> StaticDeflection | None:
        """Returns the static deflection of elastic joints, or None if the controller ignores it."""
        if self.stiffness is None:
            return None
        return StaticDeflection(self.stiffness, self._at_rest, self.model(), self.robot.home)

    def model(self) -> RobotModel:
        return self._make_model(self.robot)

    @property
    def has_springs(self) -> bool:
        """Whether the controller's damping is designed for a declared stiffness."""
        return hasattr(self.declared, "stiffness")

    def linearised(self, angles: Array) -> tuple[Array, Array, Array]:
        """Linearizes the robot and its controller about a target pose at rest.

        Args:
            angles: target pose, shape (n,), rad or m.

        Returns:
            mass matrix of the links, stiffness matrix and damping matrix of the controller, shape
                (n, n) each. Stiffness and damping are the negative derivatives of the unlimited
                torques with respect to angles and velocities. The stiffness consists of its
                restoring part, so gravity compensation has no effect. Both are zero if the
                controller must not be called outside of a run (`may_be_probed`).
        """
        n, model = len(angles), self.model()
        slopes: Array = np.zeros((2, n, n))
        model.update(angles, np.zeros(n))
        mass = model.mass() - np.diag(model.motor_inertia)
        declared = self.declared
        if isinstance(declared, ControllerDeclaration) and declared.may_be_probed:
            controller = declared.make(self.model(), self._timestep)
            sensed, target, torques = Sensed(n), Target(n), np.zeros((2, n))
            target.angles[:] = target.posture[:] = angles
            target.pose[:] = model.flange()
            target.has_torques = False
            stiffness = self.stiffness
            bends: Array = np.zeros((2, n))  # of elastic joints: initially, and now
            if stiffness is not None:
                held = controller.hold_links(stiffness)
                at_rest: Array = model.gravity() if held is None else held
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


class RobotControl:
    """A controller with its inputs and outputs.

    It controls one robot in one row of a plant, or one or more robots in all rows. In the latter
    case, the rows are the first axis of all arrays.

    Args:
        drive: output array for commanded torques after and before the limits, for all joints of the
            plant, shape (m, 2, n), Nm or N.
        row: index of the controlled row; None for all rows.

    Attributes:
        rows: leading shape of all arrays: () for one row, or (m,).
        parts: slice of each robot's joints among the controlled joints.
        commanded: commanded torques of the last step, Nm or N.
        controller: controller with its torque limits, which `use` sets.
        deflection: static deflection of elastic joints; None if it is not needed.
        live: pairs of targets, of which the second is copied to the first in every step.
    """

    controller: LimitedController

    def __init__(
        self,
        robots: Sequence[SerialRobot],
        plant: PlantRows,
        drive: Array,
        row: int | None = None,
    ) -> None:
        self.rows: tuple[int, ...] = () if row is not None else (plant.physics.m,)
        of: int | slice = slice(None) if row is None else row
        places = [np.arange(plant.n)[plant.world.robots[robot.name].joints] for robot in robots]
        ends = np.cumsum([0, *(len(each) for each in places)]).tolist()
        self.parts = [slice(a, b) for a, b in pairwise(ends)]
        n, self._joints = ends[-1], as_slice(np.concatenate(places))
        self._drive: Array = drive[of]
        measured: Array = plant.measured[of]
        # Controllers of elastic joints use the motor encoders.
        has_motors = bool(robots[0].elastic_joints)
        is_view = isinstance(self._joints, slice)
        own = measured[..., self._joints] if is_view else None
        motor_state = np.zeros((*self.rows, 2 * n)) if has_motors else None
        values = own if own is not None and own.flags.c_contiguous else None
        self.sensed = sensed = Sensed(n, values, motor_state, self.rows)
        self._read: list[tuple[Array, Array]] = []  # destination and source of copied signals
        if values is None:
            self._read.append((sensed.values, measured))
        if has_motors:
            self._read += [
                (sensed.motor_angles, plant.motor_angles[of]),
                (sensed.motor_velocities, plant.motor_velocities[of]),
            ]
        self.target = Target(n, self.rows)
        self.deflection: StaticDeflection | None = None
        self.live: list[tuple[Target, Target]] = []
        self._moving: list[tuple[Array, Array]] = []  # destination, and source for every step
        self.commanded: Array = np.zeros((*self.rows, n))
        self._requested: Array | None = None
        if is_view:
            self.commanded = self._drive[..., 0, self._joints]
            self._requested = self._drive[..., 1, self._joints]

    @classmethod
    def alone(
        cls, robot: ControlledRobot, plant: PlantRows, drive: Array, row: int
    ) -> RobotControl:
        """Returns the control of one robot in one row."""
        made = cls([robot.robot], plant, drive, row)
        made.target, made.deflection = robot.target, robot.deflection()
        if robot.plan.moves:
            made._follow(robot.plan, robot.target)
        made.use(robot.controller)
        robot.control = made
        return made

    @classmethod
    def joined(
        cls,
        each: Sequence[Sequence[ControlledRobot]],
        plant: PlantRows,
        drive: Array,
        models: RobotModels,
        *,
        is_live: bool,
    ) -> RobotControl:
        """Returns one control for the robots in all rows, whose controllers have the same group.

        Args:
            is_live: whether targets can change at any time.
        """
        first, flat = each[0], [one for row in each for one in row]
        made = cls([one.robot for one in first], plant, drive)
        made.use(LimitedController.joined([one.controller for one in flat], len(first), models))
        target = made.target
        target.has_torques = False
        for k, row in enumerate(each):
            for one, joints in zip(row, made.parts, strict=True):
                one.control = made
                own = target.part(k, joints)
                own.set(one.target)
                if is_live:
                    made.live.append((own, one.target))
                elif one.plan.moves and not made._is_same(each, row.index(one)):
                    made._follow(one.plan, own)
        for number, (one, joints) in enumerate(zip(first, made.parts, strict=True)):
            if not is_live and one.plan.moves and made._is_same(each, number):
                made._follow(one.plan, target, joints)
        if first[0].stiffness is not None:
            stiffness = np.concatenate(
                [one.stiffness for one in first if one.stiffness is not None]
            )
            home = np.tile(np.concatenate([one.robot.home for one in first]), (len(each), 1))
            at_rest = made.controller.controller.hold_links(stiffness)
            made.deflection = StaticDeflection(stiffness, at_rest, models, home)
        return made

    @staticmethod
    def _is_same(each: Sequence[Sequence[ControlledRobot]], number: int) -> bool:
        return all(row[number].plan is each[0][number].plan for row in each)

    def _follow(self, plan: Plan, target: Target, joints: slice = slice(None)) -> None:
        assert plan.motion is not None
        self._moving.append((target.motion[..., joints], plan.motion))
        if plan.flange is not None:
            flange = plan.flange
            self._moving += [(target.pose, flange.poses), (target.twist, flange.twists)]

    def use(self, controller: LimitedController) -> None:
        if self._requested is not None:
            controller.requested = self._requested
        self.controller = controller

    def command(self, k: int, time: float) -> None:
        """Computes `commanded` for the step after log row k.

        Raises:
            SimulationError: a torque is NaN or infinite. It is raised only for a single row.
        """
        sensed, joints = self.sensed, self._joints
        for to, measured in self._read:
            to[...] = measured[..., joints]
        if self.deflection is not None:
            sensed.motor_angles[...] = self.deflection.link_angles(sensed.motor_angles)
        sensed.time = time
        for to, rows in self._moving:
            to[...] = rows[k]
        for own, target in self.live:
            own.set(target)
        self.controller.torques(sensed, self.target, self.commanded)
        if self._requested is None:
            self._drive[..., 0, joints] = self.commanded
            self._drive[..., 1, joints] = self.controller.requested
