"""`Drives`: joint torque control, delay and saturation between controllers and motors.

Joint torque control at the rate of the physics, torque limits and delay act in this order. One step
of the drives is one step of the controllers and `substeps` steps of the plant.
"""

from __future__ import annotations

import numpy as np

from ..base.errors import DeclarationError, Problem, collect
from ..base.frames import Array, Bools
from ..robots.assemble.robot_dynamics import robot_dynamics
from ..robots.declared.robot import SerialRobot
from .control.joint_control import largest_share
from .control.torque_loop import LoopGains, TorqueLoop, unstable_loop
from .plant import PlantRows
from .scenario import Run


class Drives:
    """The drives of all robots, which step a plant with the commands of its controllers.

    Args:
        plant: plant whose time step divides the time step of the controllers.
        robots: robots in the order of the plant.

    Attributes:
        loop: joint torque control, or None if the run does not use it.
        gains: gains of the torque loop by robot name.
        substeps: number of plant steps in one step of the controllers.

    Raises:
        DeclarationError: the gains of a torque loop do not fit its robot.
    """

    def __init__(self, plant: PlantRows, robots: dict[str, SerialRobot], run: Run) -> None:
        self.plant, self.substeps = plant, run.substeps
        self._high: Array = np.concatenate([robot.torque_bounds for robot in robots.values()])
        self._low: Array = -self._high
        self.gains: dict[str, LoopGains] = {}
        self.loop: TorqueLoop | None = None
        if run.torque_control:
            self._find_gains(robots)
            joined = LoopGains.joined([*self.gains.values()])
            self.loop = TorqueLoop(joined, plant.timestep, self._high, plant.physics.m)
        # Elastic joints have ideal motor encoders; other joints use the links' sensors.
        self._velocities = plant.motor_velocities if plant.joints.elastic else None
        self._measured: Array = plant.measured[:, 1:]
        # Ring buffer of delayed torques, and the index of its next entry.
        delay = round(run.drive_delay / plant.timestep)
        self._pending: Array = np.zeros((delay + 1, plant.physics.m, plant.n))
        self._place = 0
        self.reset()

    def _find_gains(self, robots: dict[str, SerialRobot]) -> None:
        problems: list[Problem] = []
        for name, robot in robots.items():
            with collect(problems, f"robots.{name}"):
                dynamics = robot_dynamics(robot)
                self.gains[name] = LoopGains.of(
                    robot.torque_control, dynamics, robot.elastic_joints
                )
        if problems:
            raise DeclarationError(problems)

    def check(
        self, name: str, mass: Array, stiffness: Array, damping: Array, *, has_springs: bool = True
    ) -> None:
        """Checks the stability of a robot's torque loop and of its controller.

        Args:
            mass: mass matrix of the links without motors, shape (n, n), kg m2 (kg).
            stiffness: stiffness of the controller, shape (n, n), Nm/rad (N/m).
            damping: damping of the controller, shape (n, n), Nm s/rad (N s/m).
            has_springs: whether the damping is designed for the stiffness and changes with it.

        Raises:
            DeclarationError: the loop or the controller is unstable. The error names the joint with
                the fastest growing vibration, and a stable value.
        """
        gains, timestep = self.gains[name], self.plant.timestep
        joints = self.plant.world.robots[name].robot.names
        joint = unstable_loop(gains, mass, timestep)
        if joint is not None:
            share = largest_share(
                lambda each: unstable_loop(gains.lighter(each), mass, timestep) is None
            )
            minimum = 1.01 * gains.lighter(share).shaped_inertias[joint]
            better = (
                f"at least {minimum:.3g}, or a shorter run.physics_timestep"
                if share > 0
                else "a lower torque_control.bandwidth, or a shorter run.physics_timestep"
            )
            raise Problem(
                f"robots.{name}.torque_control.motor_inertias",
                f"a torque loop of {1 / timestep:.0f} Hz makes joint {joints[joint]} unstable "
                "with a motor inertia of",
                found=float(gains.shaped_inertias[joint]),
                expected=better,
            ).error()

        def shaken(share: float) -> int | None:
            # Designed damping is proportional to the square root of the stiffness.
            scaled = share * stiffness, (np.sqrt(share) if has_springs else share) * damping
            return unstable_loop(gains, mass, timestep, *scaled, self.substeps)

        joint = shaken(1.0)
        if joint is not None:
            share = largest_share(lambda each: shaken(each) is None)
            what = "stiffness" if has_springs else "damping"
            raise Problem(
                f"controllers.{name}.{what}",
                f"joint {joints[joint]} is unstable with a torque loop of {1 / timestep:.0f} Hz "
                "and a time step of",
                found=1000.0 * timestep * self.substeps,
                of="ms",
                expected=f"at most {99 * share:.2g} % of each {what}, a shorter run.timestep, or "
                "a larger torque_control.inertia_ratio",
            ).error()

    def reset(self, which: Bools | slice = slice(None)) -> None:
        """Resets some rows to the motor torques that hold the plant at rest."""
        plant = self.plant
        self._pending[:, which] = plant.actual[which, 2]
        if self.loop is not None:
            measured = plant.measured[which]
            velocities = measured[:, 1] if self._velocities is None else self._velocities[which]
            self.loop.reset(measured[:, 2], velocities, which)

    def step(self, commanded: Array) -> None:
        """Simulates one time step of the controllers, which is `substeps` steps of the plant.

        Args:
            commanded: torques after the controllers' limits and drive faults, shape (m, n), Nm or
                N.
        """
        plant, loop = self.plant, self.loop
        if loop is None:
            motor_torques = np.minimum(np.maximum(commanded, self._low), self._high)
            for _ in range(self.substeps):
                plant.step(self._delayed(motor_torques))
            return
        loop.command(commanded)
        motor_torques, sensed = plant.joints.motor_torques, loop.sensed
        is_late = len(self._pending) > 1
        for _ in range(self.substeps):
            sensed[...] = self._measured
            if self._velocities is not None:
                sensed[:, 0] = self._velocities
            loop.step(motor_torques)
            if is_late:
                motor_torques[...] = self._delayed(motor_torques)
            plant.step_with_set_torques()

    def _delayed(self, torques: Array) -> Array:
        pending = self._pending
        if len(pending) == 1:
            return torques
        pending[self._place % len(pending)] = torques
        self._place += 1
        acting: Array = pending[self._place % len(pending)]
        return acting
