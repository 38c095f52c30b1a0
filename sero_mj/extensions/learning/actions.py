"""Actions of an agent (joint torques or target offsets), and the controller that executes them."""

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
    """The kind of commands that an agent sends to a robot.

    Attributes:
        unit: unit of an action, for messages.
        spec: specification of an action with its shape (n,) and bounds.
        controller: controller that executes the action.
    """

    unit: ClassVar[str]
    spec: specs.BoundedArray
    controller: JointImpedance | Torque

    @abstractmethod
    def begin(self, target: Target, angles: Array, which: Any = slice(None)) -> None:
        """Begins an episode, in which actions are written to `target`.

        `angles` contains the joint values of the robot, shape (n,). For m robots, the arrays in
        `target` have the shape (m, n), and `angles` contains the joint values of the k robots that
        `which` selects, shape (k, n).
        """

    @abstractmethod
    def take(self, action: Array) -> None:
        """Begins a control step with an action, shape (n,) or (m, n), already within the bounds."""

    def advance(self) -> None:  # noqa: B027 - optional
        """Begins a step of the simulation."""

    def observation(self) -> dict[str, Array]:
        """Returns the observations that depend on the kind of action."""
        return {}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Returns the shapes and bounds of `observation`."""
        return {}


class TorqueAction(Action):
    """Joint torques (Nm or N) in addition to gravity compensation, constant for a control step.

    As on the real robot, the controller adds gravity torques, and the drives clip the sum to their
    limits.

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
        self._target = target
        target.torques[which] = 0.0

    def take(self, action: Array) -> None:
        self._target.torques[:] = action


class ImpedanceAction(Action):
    """Offsets (rad or m) by which the target of a joint impedance controller moves.

    The target moves by the offset at constant speed during a control step, within the position
    limits. Real LWRs are commanded in this way, because their controller includes impedance control
    and gravity compensation. The bounds result from the velocity limits (default: 1 rad/s, 0.25
    m/s).

    Args:
        control_timestep: time between two actions, s.
        timestep: time step of the simulation, s.
        stiffness: stiffness of all joints, or of each joint, shape (n,), Nm/rad.
        damping: damping ratio of all joints, or of each joint, shape (n,).

    Raises:
        DeclarationError: the gains are invalid.
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
        bound = joint_speeds(robot, "agent") * self._duration
        limits = robot.position_limits
        far = np.full(robot.n, np.inf)
        self._low: Array = -far if limits is None else limits[:, 0]
        self._high: Array = far if limits is None else limits[:, 1]
        self._step: Array = np.zeros(robot.n)
        self._goal: Array = np.zeros(robot.n)
        self._left = 0
        self.controller: JointImpedance = JointImpedance(stiffness=stiffness, damping=damping)
        self.spec = specs.BoundedArray((robot.n,), np.float64, -bound, bound, name="target_offsets")

    def begin(self, target: Target, angles: Array, which: Any = slice(None)) -> None:
        self._target = target
        if self._goal.shape != target.angles.shape:
            self._goal, self._step = np.zeros((2, *target.angles.shape))
        target.angles[which] = self._goal[which] = angles
        target.velocities[which] = 0.0
        self._left = 0

    def take(self, action: Array) -> None:
        target = self._target
        np.clip(target.angles + action, self._low, self._high, self._goal)
        np.subtract(self._goal, target.angles, self._step)
        np.divide(self._step, self._duration, target.velocities)
        np.divide(self._step, self._substeps, self._step)
        self._left = self._substeps

    def advance(self) -> None:
        if self._left > 0:
            self._left -= 1
            self._target.angles += self._step
            if self._left == 0:
                self._target.angles[:] = self._goal  # prevents accumulated rounding errors

    def observation(self) -> dict[str, Array]:
        # The next state depends on the target.
        return {"commanded_angles": self._goal.copy()}

    def observation_spec(self) -> dict[str, specs.Array]:
        name = "commanded_angles"
        return {
            name: specs.BoundedArray(self.spec.shape, np.float64, self._low, self._high, name=name)
        }


class AgentController(Controller):
    """The controller that executes an agent's actions.

    Raises:
        DeclarationError: the gains do not fit the robot.
    """

    def __init__(
        self, action: Action, robot: SerialRobot, model: RobotModel, timestep: float
    ) -> None:
        self._action, self._robot, self.model, self._timestep = action, robot, model, timestep
        self.begin_at(np.asarray(robot.home, np.float64))

    def begin_at(self, angles: Array) -> None:
        """Resets the controller for an episode that begins at joint values, shape (n,)."""
        self._target = Target(self._robot.n)
        self._inner = make_controller(
            self._action.controller, self.model, self._timestep, self._robot.torque_limits
        )
        self._action.begin(self._target, angles)

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        self._action.advance()
        self._inner.torques(sensed, self._target, out)

    def check(self, angles: Array) -> None:
        self._inner.check(angles)


def checked_action(
    action: Any,
    spec: specs.BoundedArray,
    robot: SerialRobot,
    unit: str,
    time: float,
    m: int | None = None,
) -> Array:
    """Returns an action that is clipped to its bounds, shape (n,), or (m, n) for m environments.

    Raises:
        ValueError: the shape is wrong.
        SimulationError: a number is NaN or infinite.
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
