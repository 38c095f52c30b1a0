"""`ControlledRobot`: a robot of a plant, its controller, and its observer of external torques."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np

from ..base.frames import Array
from ..robots.assemble.robot import SerialRobot
from .control.controller import ControllerDeclaration, Sensed, Target
from .control.make_controller import LimitedController, make_controller
from .control.observer import MomentumObserver
from .control.plan import Plan
from .control.robot_model import RobotModel
from .control.torque_loop import HangingLinks
from .drives import Drives
from .plant_rows import PlantRow
from .scenario import Scenario

_ROUNDS = 30  # of `HangingLinks`: what is left of the first is less than 0.2 %
_MOVE = 1e-5  # rad and rad/s, between which controllers are linear


class ControlledRobot:
    """A robot of a plant, its controller, and the observer of its external torques.

    Args:
        robot: as it stands in the world at first.
        scenario: what is run.
        plant: that it is in.
        drives: between its controller and the plant; None where there are none.
        make_model: of what its controller knows of it; not kept.
        plan: its target at every step.
        drive: (2, N), torques of all joints of the plant, Nm or N: commanded, and asked for before
            the limits; its own are written there.
        observed_every: steps between two estimates of the external torques.

    Attributes:
        robot: as given.
        joints: which joints of the plant are its own.
        in_use: its controller as declared, and as made; and where the links of elastic joints rest.

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
        plan: Plan,
        drive: Array,
        observed_every: int,
    ) -> None:
        name, timestep = robot.name, scenario.run.timestep
        self.joints = joints = plant.world.robots[name].joints
        self._timestep = timestep
        self.robot = robot
        self.commanded, self._requested = drive[:, joints]
        # Springs and dampers act on the motors of elastic joints, which have encoders of their own.
        motor_state = np.zeros(2 * robot.n) if robot.elastic_joints else None
        # What is measured of the only robot is used in place.
        measured = plant.measured[:, joints]
        values = measured if measured.flags.c_contiguous else None
        self._sensed = sensed = Sensed(robot.n, values, motor_state)
        self._copies: list[tuple[Array, Array]] = []  # of what else is measured: to, from; views
        if values is None:
            self._copies.append((sensed.values, measured))
        if robot.elastic_joints:
            self._copies += [
                (sensed.motor_angles, plant.motor_angles[joints]),
                (sensed.motor_velocities, plant.motor_velocities[joints]),
            ]
        self._joint_stiffness: Array | None = None
        if robot.elastic_joints and drives is not None and drives.loop:
            self._joint_stiffness = drives.gains[name].stiffness
        self.in_use: tuple[Any, LimitedController, HangingLinks | None]
        self.use(scenario.controller_of(name), make_model)
        self._target = Target(robot.n)
        self._target.posture[:] = robot.home
        self._target.has_torques = False  # no target motion has any
        self._moves, self._planned_rows = plan.moves, plan.rows
        self._planned = self._target.planned[: plan.rows.shape[1]]
        self._planned[...] = plan.rows[0]
        self._observer = MomentumObserver(
            make_model(robot),
            scenario.run.observer_gain,
            timestep * observed_every,
        )
        self._sense()
        self._observer.update(self._sensed)

    def use(self, declared: Any, make_model: Callable[[SerialRobot], RobotModel]) -> None:
        """Controls the robot by another controller from now on.

        Args:
            declared: see `Scenario.controllers`.
            make_model: of what it knows of the robot; not kept.

        Raises:
            DeclarationError: gains or limits do not fit the robot.
        """
        robot = self.robot
        model = make_model(robot)
        controller = make_controller(declared, model, self._timestep, robot.torque_limits)
        controller.requested = self._requested
        hanging, stiffness = None, self._joint_stiffness
        if stiffness is not None:
            hold_links = getattr(controller.controller, "hold_links", None)
            at_rest = hold_links(stiffness) if hold_links is not None else None
            hanging = HangingLinks(stiffness, at_rest, make_model(robot), robot.home)
        self.in_use = declared, controller, hanging

    @property
    def controller(self) -> LimitedController:
        """The controller, behind its torque limits."""
        return self.in_use[1]

    @property
    def target(self) -> Target:
        """What it is asked for, to be written into."""
        return self._target

    def _sense(self) -> None:
        """Lets the controller see what was measured."""
        for sensed, measured in self._copies:
            sensed[...] = measured
        hanging = self.in_use[2]
        if hanging is not None:
            self._sensed.motor_angles[...] = hanging.link_angles(self._sensed.motor_angles)

    @property
    def has_springs(self) -> bool:
        """Whether a stiffness is declared, for which its damping is designed."""
        return hasattr(self.in_use[0], "stiffness")

    def linearised(
        self, make_model: Callable[[SerialRobot], RobotModel], angles: Array
    ) -> tuple[Array, Array, Array]:
        """The robot and its controller about a pose at rest, in which its target is.

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
        declared = self.in_use[0]
        if isinstance(declared, ControllerDeclaration):
            controller = declared.make(make_model(self.robot), self._timestep)
            sensed, target, torques = Sensed(n), Target(n), np.zeros((2, n))
            target.angles[:] = target.posture[:] = angles
            target.pose[:] = model.flange()
            target.has_torques = False
            stiffness = self._joint_stiffness
            bends: Array = np.zeros((2, n))  # of elastic joints: at first, and now; else zero
            if stiffness is not None:
                hold_links = getattr(controller, "hold_links", None)
                at_rest = model.gravity() if hold_links is None else hold_links(stiffness)
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

    def command(self, k: int, time: float) -> None:
        """Computes `commanded` for the step that leads on from row k of the log.

        Args:
            k: the row.
            time: of it, s.

        Raises:
            SimulationError: a torque is NaN or infinite.
        """
        self._sense()
        self._sensed.time = time
        if self._moves:
            self._planned[...] = self._planned_rows[k]
        self.in_use[1].torques(self._sensed, self._target, self.commanded)

    def observe(self, measured: Array) -> Array:
        """Estimates the external torques after further steps, (n,), Nm or N.

        The observer gets the mean of the measured torques: that is what changed the momentum
        meanwhile.

        Args:
            measured: (steps, 3, n), angles, velocities and torques of all robots of the plant in
                these steps.

        Returns:
            the estimate, which stands until the next; the same array every time.
        """
        angles, velocities, _ = measured[-1, :, self.joints]
        mean = np.add.reduce(measured[:, 2, self.joints]) / len(measured)
        self._observer.model.update(angles, velocities)
        return self._observer.update_with(velocities, mean)
