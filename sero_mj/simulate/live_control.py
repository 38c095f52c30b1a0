"""`LiveControl`: changes controllers, gains and targets of robots while they are simulated."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..base.errors import DeclarationError, UnknownName
from ..base.frames import Array
from ..robots.declared.joint_speeds import joint_speeds
from ..robots.declared.robot import SerialRobot
from .control.controller import ControllerDeclaration, Target
from .control.joint_control import largest_share
from .control.make_controller import controller_kinds
from .control.robot_model import RobotModel

_HALVINGS = 8  # maximum number of times that an unstable initial stiffness is reduced
# The target moves to its goal like a critically damped mass with this natural frequency (1/s), and
# not faster than this fraction of the joints' velocity limits.
_FREQUENCY = 20.0
_SHARE = 0.7
_AT_REST = 1e-9  # maximum distance and speed of a target at its goal, rad and rad/s (m and m/s)


def kind_of_control(name: str) -> str:
    """Returns the controller kind for a kind or a short name. Raises UnknownName."""
    kinds = controller_kinds()
    by_name = {kind.short: key for key, kind in kinds.items() if kind.short}
    if name not in kinds and name not in by_name:
        raise UnknownName("controller", name, [*by_name, *kinds])
    return by_name.get(name, name)


@dataclass(eq=False)
class LiveRobot:
    """A robot whose controller and target can be changed during the simulation.

    Attributes:
        robot: robot with its initial base frame in the world.
        model: robot model that is not shared with the controller.
        timestep: time step of the controllers, s.
        target: target that the controller follows.
        measured: view of the measured joint angles, shape (n,), rad or m.
        speeds: view of the measured joint velocities, shape (n,), rad/s or m/s.
        written: views of the log columns of target angles, velocities and pose, shape (T, ...).
        use: function that replaces the controller. It raises DeclarationError for unstable gains.
        controllers: all available controllers by kind, with the current gains.
        control: kind of the current controller.
        first: all available controllers with the initial gains.
        goal: final joint angles of the target, shape (n,), rad or m.
    """

    robot: SerialRobot
    model: RobotModel
    timestep: float
    target: Target
    measured: Array
    speeds: Array
    written: list[Array]
    use: Callable[[ControllerDeclaration], None]
    controllers: dict[str, ControllerDeclaration] = field(default_factory=dict)

    def __post_init__(self) -> None:
        robot = self.robot
        self.goal: Array = self.measured.copy()
        self._fastest: Array = _SHARE * np.minimum(joint_speeds(robot, "target"), 1e3)
        self._is_moving = True
        self.model.update(self.measured, np.zeros(robot.n))
        for name, kind in controller_kinds().items():
            declared = kind.for_robot(robot, self.model)
            if declared is not None:
                self.controllers.setdefault(name, declared)
        self.first = dict(self.controllers)
        self.control = next(iter(self.controllers))

    @property
    def controller(self) -> ControllerDeclaration:
        return self.controllers[self.control]

    def choose(self, control: str) -> str:
        """Changes the controller, and sets the target to the current pose.

        Returns:
            reason why the controller is rejected, or an empty string.

        Raises:
            UnknownName: no controller of that kind is available.
        """
        control = kind_of_control(control)
        if control not in self.controllers:
            raise UnknownName("available controller", control, self.controllers)
        self._stand()
        declared: ControllerDeclaration | None = self.controllers[control]
        why = ""
        for _ in range(_HALVINGS):
            if declared is None:
                break
            try:
                self.use(declared)
            except DeclarationError as error:
                why, declared = _reason(error), declared.softer()
                continue
            self.controllers[control], self.control = declared, control
            return ""
        return why

    def change(
        self, values: Mapping[str, Any], format_gains: Callable[[Mapping[str, Any]], str]
    ) -> str:
        """Changes gains of the current controller unless they are unstable.

        Returns:
            error message with the largest stable gains, or an empty string.
        """
        now = self.controller
        try:
            declared = now.changed(values)
            self.use(declared)
        except DeclarationError as error:
            if not all(np.isfinite(np.asarray(value)).all() for value in values.values()):
                return f"refused: {_reason(error)}"
            before = {key: np.asarray(getattr(now, key)) for key in values}

            def part(share: float) -> dict[str, Any]:
                return {
                    key: before[key] + share * (np.asarray(value) - before[key])
                    for key, value in values.items()
                }

            def holds(share: float) -> bool:
                try:
                    self.use(now.changed(part(share)))
                except DeclarationError:
                    return False
                return True

            largest = format_gains(part(0.99 * largest_share(holds)))
            self.use(now)
            return f"refused: {_reason(error)}. The largest stable value here is {largest}"
        self.controllers[self.control] = declared
        return ""

    def _stand(self) -> None:
        target = self.target
        target.angles[:] = target.posture[:] = self.measured
        target.velocities[:] = self.speeds
        # The target comes to rest there without overshoot.
        self.goal = target.angles + target.velocities / _FREQUENCY
        self._place()
        self._is_moving = True

    def before(self, k: int) -> None:
        """Moves the target for the step after log row k."""
        target = self.target
        if not self.controller.needs_target:
            self.goal = self.measured.copy()
            target.angles[:], target.velocities[:] = self.measured, self.speeds
        elif self._is_moving or not np.array_equal(self.goal, target.angles):
            self._move()
        angles, velocities, pose = self.written
        angles[k + 1], velocities[k + 1] = target.angles, target.velocities
        pose[k + 1] = target.pose.ravel()

    def _move(self) -> None:
        target, step = self.target, self.timestep
        angles, velocities = target.angles, target.velocities
        pull = _FREQUENCY**2 * (self.goal - angles) - 2.0 * _FREQUENCY * velocities
        limit = np.maximum(self._fastest, np.abs(velocities))  # the robot may have been faster
        changed = np.clip(velocities + step * pull, -limit, limit)
        target.accelerations[:] = (changed - velocities) / step
        velocities[:] = changed
        angles += step * changed
        left = max(np.abs(self.goal - angles).max(), np.abs(velocities).max())
        self._is_moving = bool(left > _AT_REST)
        if not self._is_moving:
            angles[:], velocities[:], target.accelerations[:] = self.goal, 0.0, 0.0
        target.posture[:] = angles
        self._place()

    def _place(self) -> None:
        target = self.target
        self.model.update(target.angles, target.velocities)
        target.position[:] = self.model.flange_position
        target.rotation[:] = self.model.flange_rotation
        target.twist[:] = self.model.jacobian() @ target.velocities


class LiveControl:
    """The robots whose controllers and targets can be changed during a simulation."""

    def __init__(self) -> None:
        self.robots: dict[str, LiveRobot] = {}

    def begin(self, robots: dict[str, LiveRobot]) -> None:
        """Replaces the robots after a restart of the simulation, but not their controllers."""
        before, self.robots = self.robots, robots
        for name, robot in robots.items():
            if name in before:
                robot.controllers, robot.first = before[name].controllers, before[name].first
                robot.control = before[name].control
            robot.choose(robot.control)

    def before(self, k: int) -> None:
        """Moves all targets for the step after log row k."""
        for robot in self.robots.values():
            robot.before(k)


def _reason(error: DeclarationError) -> str:
    return "; ".join(problem.message for problem in error.problems)
