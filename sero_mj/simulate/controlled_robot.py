"""`ControlledRobot`: a simulated robot with its controller, step by step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..control.compiler import Compiler
from ..control.controller import Sensed, Target
from ..control.controllers import make_controller
from ..control.joint_control import GravityCompensation
from ..control.observer import MomentumObserver
from ..control.plan import Plan
from .plant import Plant
from .scenario import Scenario

Array = NDArray[np.float64]

OBSERVED_EVERY = 0.01  # s; half the observer's time constant, and a tenth of the cost


def observed_every(timestep: float) -> int:
    """Steps between two estimates of the external torques, at a timestep in s."""
    return max(round(OBSERVED_EVERY / timestep), 1)


class ControlledRobot:
    """A robot of a plant, its controller, and the observer of its external torques.

    Args:
        name: of the robot.
        scenario: that it is in.
        plan: its target at every step.
        plant: that simulates it.
        commanded: (N,), torques of all joints of the plant, Nm or N; its own are written there.
        compiler: of the models that controller and observer have.

    Attributes:
        name: as given.
        joints: which joints of the plant are its own.
        commanded: (n,), its torques in the last step, within the limits, Nm or N: a view.
        controller: behind its torque limits.

    Raises:
        DeclarationError: gains or limits do not fit the robot.
    """

    def __init__(
        self,
        name: str,
        scenario: Scenario,
        plan: Plan,
        plant: Plant,
        commanded: Array,
        compiler: Compiler,
    ) -> None:
        part, timestep = plant.world.robots[name], scenario.run.timestep
        robot = part.robot
        self.name, self.joints = name, part.joints
        self.commanded: Array = commanded[part.joints]
        declared = scenario.controllers.get(name, GravityCompensation())
        self.controller = make_controller(
            declared, compiler.robot_model(robot), timestep, robot.torque_limits
        )
        # Springs and dampers act on the motors of elastic joints, which have encoders of their own.
        motor_state = np.zeros(2 * robot.n) if robot.elastic_joints else None
        self._sensed = sensed = Sensed(robot.n, motor_state=motor_state)
        self._sensors = [
            (sensed.values, plant.measured[:, part.joints])
        ]  # views: where to, and what
        if robot.elastic_joints:
            self._sensors += [
                (sensed.motor_angles, plant.motor_angles[part.joints]),
                (sensed.motor_velocities, plant.motor_velocities[part.joints]),
            ]
        self._target = Target(robot.n)
        self._target.posture[:] = robot.home
        self._target.has_torques = False  # no target motion has any
        self._moves, self._planned_rows = plan.moves, plan.rows
        self._planned = self._target.planned[: plan.rows.shape[1]]
        self._planned[...] = plan.rows[0]
        self._observer = MomentumObserver(
            compiler.robot_model(robot),
            scenario.run.observer_gain,
            timestep * observed_every(timestep),
        )
        self._sense()
        self._observer.update(self._sensed)

    def _sense(self) -> None:
        """Lets the controller see what was measured."""
        for sensed, measured in self._sensors:
            sensed[...] = measured

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
        self.controller.torques(self._sensed, self._target, self.commanded)

    def observe(self, measured: Array) -> Array:
        """Estimates the external torques after further `observed_every` steps, (n,), Nm or N.

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
