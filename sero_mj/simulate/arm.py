"""`Arm`: one simulated robot with its controller, and what that sees and is asked for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..control.compiler import Compiler
from ..control.controllers import make_controller
from ..control.joint_control import GravityCompensation
from ..control.observer import MomentumObserver
from ..control.plan import Plan
from ..control.state import Sensed, Target
from .plant import Plant
from .scenario import Scenario

Array = NDArray[np.float64]

OBSERVED_EVERY = 0.01  # s; half the observer's time constant, and a tenth of the cost


class Arm:
    """A robot at work.

    Args:
        name: of the robot.
        scenario: that it is in.
        plan: where it is to be.
        plant: that holds it.
        joints: which joints of the plant are its own.
        compiler: of the models that controller and observer have.

    Attributes:
        name: as given.
        joints: as given.
        plan: as given.
        controller: behind its torque limits.
        sensed: what that sees.
        target: what it is asked for.
        observer: of external torques; asked every `observed_every` steps.
        observed_every: see there.

    Raises:
        DeclarationError: gains or limits do not fit the robot.
    """

    def __init__(
        self,
        name: str,
        scenario: Scenario,
        plan: Plan,
        plant: Plant,
        joints: slice,
        compiler: Compiler,
    ) -> None:
        robot, timestep = scenario.scene.robots[name], scenario.run.timestep
        self.name, self.joints, self.plan = name, joints, plan
        declared = scenario.controllers.get(name, GravityCompensation())
        self.controller = make_controller(
            declared, compiler.robot_model(robot), timestep, robot.torque_limits
        )
        self.controller.check(np.asarray(robot.home, np.float64))
        self.controller.checks = False  # the plant looks as well
        # Of one robot alone what the plant measures is seen in place.
        copies = robot.n < plant.n
        # Elastic joints are controlled over their motors, which have encoders of their own.
        motors: Array | None = np.zeros(2 * robot.n) if robot.elastic_joints else None
        self.sensed = Sensed(robot.n, None if copies else plant.measured, motors)
        self._seen: list[tuple[Array, Array]] = []  # where to, and what; all are views
        if copies:
            self._seen.append((self.sensed.values, plant.measured[:, joints]))
        if motors is not None:
            self._seen.append((self.sensed.motor_angles, plant.motor_angles[joints]))
            self._seen.append((self.sensed.motor_velocities, plant.motor_velocities[joints]))
        self.target = Target(robot.n)
        self.target.posture[:] = robot.home
        self.target.has_torques = False  # no law has any
        self.observed_every = max(round(OBSERVED_EVERY / timestep), 1)
        self.observer = MomentumObserver(
            compiler.robot_model(robot), scenario.run.observer_gain, timestep * self.observed_every
        )

    @property
    def has_to_look(self) -> bool:
        """Whether `sense` does anything."""
        return bool(self._seen)

    def sense(self) -> None:
        """Lets the controller see what was measured."""
        for to, what in self._seen:
            to[...] = what

    def observe(
        self, first: int, last: int, measured: tuple[Array, Array, Array], log: Array
    ) -> None:
        """Estimates external torques from new rows of a log, every so many steps.

        In between the estimate stands. The observer gets the mean of the torques since it was last
        asked: that is what changed the momentum meanwhile.

        Args:
            first: the first new row.
            last: the last one.
            measured: angles, velocities and torques, (T, n) each, whole logs.
            log: where the estimates go, (T, n).
        """
        angles, velocities, torques = measured
        every, observer = self.observed_every, self.observer
        log[first : min(first + every, last + 1)] = observer.external
        for k in range(-(-first // every) * every, last + 1, every):
            mean = np.add.reduce(torques[k - every + 1 : k + 1]) / every
            observer.model.update(angles[k], velocities[k])
            log[k : min(k + every, last + 1)] = observer.update_with(velocities[k], mean)
