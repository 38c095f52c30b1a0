"""What an agent commands, joint torques or target offsets, and the controller that does it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Literal

import numpy as np
from dm_env import specs

from ...base.errors import Problem, SimulationError
from ...base.frames import Array
from ...robots.declared.joint_speeds import joint_speeds
from ...robots.declared.robot import SerialRobot
from ...simulate.control.controller import Controller, Sensed, Target
from ...simulate.control.joint_control import JointImpedance, Torque
from ...simulate.control.make_controller import make_controller
from ...simulate.control.robot_model import RobotModel

Kind = Literal["torque", "impedance"]


class Action(ABC):
    """What an agent commands a robot.

    Attributes:
        unit: of an action's numbers, for messages.
        spec: (n,), with their bounds.
        controller: that carries it out.
    """

    unit: ClassVar[str]
    spec: specs.BoundedArray
    controller: JointImpedance | Torque

    @abstractmethod
    def begin(self, target: Target, angles: Array, which: Any = slice(None)) -> None:
        """Begins an episode.

        Args:
            target: of the controller, which is written here from now on. Of m robots (m, n) arrays.
            angles: (n,), where the robot stands; of several robots (k, n).
            which: of m robots those k that begin.
        """

    @abstractmethod
    def take(self, action: Array) -> None:
        """Begins a control step; the action, (n,) or (m, n), is within its bounds."""

    def advance(self) -> None:  # noqa: B027 - most do nothing
        """Begins a step of the simulation."""

    def observation(self) -> dict[str, Array]:
        """The state of the action that an agent observes."""
        return {}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of that."""
        return {}


class TorqueAction(Action):
    """Joint torques on top of gravity compensation, held for a control step.

    As on the robot: its controller adds gravity to what it is asked for, and the drives cut off
    what is beyond their limits.

    Attributes:
        spec: (n,), Nm or N, within the torque limits.

    Raises:
        DeclarationError: the robot has no torque limits.
    """

    unit = "Nm"

    def __init__(self, robot: SerialRobot) -> None:
        high = np.array(robot.torque_bounds, np.float64)
        missing = np.flatnonzero(np.isinf(high))
        if missing.size:
            where = "" if missing.size == robot.n else f" for {robot.names[missing[0]]}"
            message = (
                f"is required{where} for torques as actions; expected one per joint, Nm, or "
                'action="impedance"'
            )
            raise Problem(f"robots.{robot.name}.torque_limits", message).error()
        self.controller = Torque()
        self.spec = specs.BoundedArray((robot.n,), np.float64, -high, high, name="torques")

    def begin(self, target: Target, angles: Array, which: Any = slice(None)) -> None:
        """Begins an episode without torques."""
        self._target = target
        target.torques[which] = 0.0

    def take(self, action: Array) -> None:
        """Commands these torques."""
        self._target.torques[:] = action


class ImpedanceAction(Action):
    """By how much the target angles of a joint impedance move in a control step.

    They move at constant speed over the step, within the position limits; as labs drive real LWRs,
    whose springs, dampers and gravity compensation run in the robot's own controller.

    Args:
        control_timestep: s between two actions.
        timestep: s between two steps of the simulation.
        stiffness: Nm/rad, one for all joints or (n,).

    Attributes:
        spec: (n,), rad or m, within what the velocity limits allow in a control step; robots
            without are taken to have 1 rad/s and 0.25 m/s.

    Raises:
        DeclarationError: gains that no joint impedance has.
    """

    unit = "rad"

    def __init__(
        self,
        robot: SerialRobot,
        control_timestep: float,
        timestep: float,
        stiffness: Any,
        damping: Any,
    ) -> None:
        self._substeps = max(round(control_timestep / timestep), 1)
        self._duration = self._substeps * timestep
        most = joint_speeds(robot, "agent") * self._duration
        limits = robot.position_limits
        far = np.full(robot.n, np.inf)
        self._low: Array = -far if limits is None else limits[:, 0]
        self._high: Array = far if limits is None else limits[:, 1]
        self._step: Array = np.zeros(robot.n)
        self._goal: Array = np.zeros(robot.n)
        self._left = 0
        self.controller: JointImpedance = JointImpedance(stiffness=stiffness, damping=damping)
        self.spec = specs.BoundedArray((robot.n,), np.float64, -most, most, name="target_offsets")

    def begin(self, target: Target, angles: Array, which: Any = slice(None)) -> None:
        """Begins an episode: the target is where the robot stands."""
        self._target = target
        if self._goal.shape != target.angles.shape:
            self._goal, self._step = np.zeros((2, *target.angles.shape))
        target.angles[which] = self._goal[which] = angles
        target.velocities[which] = 0.0
        self._left = 0

    def take(self, action: Array) -> None:
        """Begins a control step; the action is within its bounds."""
        target = self._target
        np.clip(target.angles + action, self._low, self._high, self._goal)
        np.subtract(self._goal, target.angles, self._step)
        np.divide(self._step, self._duration, target.velocities)
        np.divide(self._step, self._substeps, self._step)
        self._left = self._substeps

    def advance(self) -> None:
        """Begins a step of the simulation."""
        if self._left > 0:
            self._left -= 1
            self._target.angles += self._step
            if self._left == 0:
                self._target.angles[:] = self._goal  # no error adds up

    def observation(self) -> dict[str, Array]:
        """The target angles, (n,) or (m, n), without which the next state cannot be predicted."""
        return {"commanded_angles": self._goal.copy()}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of that."""
        name = "commanded_angles"
        return {
            name: specs.BoundedArray(self.spec.shape, np.float64, self._low, self._high, name=name)
        }


class AgentController(Controller):
    """The controller that carries out an agent's actions.

    Args:
        timestep: s between two steps of the simulation.

    Raises:
        DeclarationError: gains that do not fit the robot.
    """

    def __init__(
        self, action: Action, robot: SerialRobot, model: RobotModel, timestep: float
    ) -> None:
        self._action, self._robot, self.model, self._timestep = action, robot, model, timestep
        self.begin_at(np.asarray(robot.home, np.float64))

    def begin_at(self, angles: Array) -> None:
        """Begins an episode: nothing that was remembered gets into it.

        Args:
            angles: (n,), where the robot stands, rad or m.
        """
        self._target = Target(self._robot.n)
        self._inner = make_controller(
            self._action.controller, self.model, self._timestep, self._robot.torque_limits
        )
        self._action.begin(self._target, angles)

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        self._action.advance()
        self._inner.torques(sensed, self._target, out)

    def check(self, angles: Array) -> None:
        """Refuses gains for which the time step is too long; see `LimitedController.check`."""
        self._inner.check(angles)


def checked_action(
    action: Any,
    spec: specs.BoundedArray,
    robot: SerialRobot,
    unit: str,
    time: float,
    m: int | None = None,
) -> Array:
    """Returns an action as (n,) numbers within the bounds; what is beyond is cut off.

    Args:
        time: s, for messages.
        m: number of environments, where it is of many: then (m, n).

    Raises:
        ValueError: it is not n numbers.
        SimulationError: one of them is NaN or infinite; names the joint.
    """
    shape = spec.shape if m is None else (m, *spec.shape)
    numbers = " x ".join(map(str, shape))
    try:
        values = np.asarray(action, np.float64)
    except (TypeError, ValueError):
        raise Problem("action", found=action, expected=f"{numbers} numbers").error() from None
    if values.shape != shape:
        found = " x ".join(map(str, values.shape)) or "one number"
        raise Problem(
            "action", f"found {found}", expected=f"{numbers} numbers, one per joint"
        ).error()
    bad = ~np.isfinite(values)
    if bad.any():
        place = tuple(np.argwhere(bad)[0].tolist())
        joint = place[-1]
        low, high = spec.minimum[joint], spec.maximum[joint]
        problem = Problem(
            "",
            "found an action of",
            found=float(values[place]),
            of="" if m is None else f"in environment {place[0]}",
            expected=f"{low:g} to {high:g} {unit}",
        )
        raise SimulationError(time, f"{robot.name}/{robot.names[joint]}", problem)
    return np.clip(values, spec.minimum, spec.maximum)
