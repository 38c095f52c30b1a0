"""`LiveControl`: controllers, gains and targets of simulated robots, changed while they run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from ..base.errors import DeclarationError
from ..base.frames import Array
from ..robots.assemble.robot import SerialRobot
from .control.cartesian_control import CartesianImpedance
from .control.controller import ControllerDeclaration, Target
from .control.joint_control import GravityCompensation, JointImpedance, largest_share
from .control.robot_model import RobotModel

Control = Literal["gravity", "joint", "cartesian"]
CONTROLS: tuple[Control, ...] = get_args(Control)
CONTROL_NAMES = ("gravity compensation", "joint impedance", "Cartesian impedance")
# Stiffness of joint impedance at first: by it the limit of a joint's torque is reached 0.2 rad (m)
# off; where there is none, the joint alone would swing at so many 1/s.
_PER_LIMIT, _SWINGS = 5.0, 13.0
_TRANSLATION, _ROTATION, _NULLSPACE = 2000.0, 100.0, 10.0  # N/m, Nm/rad, Nm/rad
_DAMPING = 0.7
_HALVINGS = 8  # of a first stiffness that the step does not hold
# The target goes to where it is wanted as a critically damped mass of this frequency would, 1/s,
# and at most at this share of the joints' velocity limits: never jumps.
_FREQUENCY = 20.0
_SHARE = 0.7
_UNDECLARED = {"revolute": 1.5, "prismatic": 0.5}  # rad/s and m/s
_RESTS = 1e-9  # rad and rad/s (m, m/s)


@dataclass(eq=False)
class LiveRobot:
    """What is changed of one robot, and by what.

    Attributes:
        robot: as it stands in the world at first.
        model: for itself.
        timestep: of the controllers, s.
        target: of its controller.
        measured: its angles, (n,), rad or m; a view.
        speeds: likewise, per second.
        written: the log's columns of target angles, velocities and pose, (T, ...); views.
        use: changes its controller; raises DeclarationError where the step does not hold it.
        control: which controller it has.
        gains: declarations of all of them, with the gains of now.
        goal: where its target is wanted, (n,), rad or m.
    """

    robot: SerialRobot
    model: RobotModel
    timestep: float
    target: Target
    measured: Array
    speeds: Array
    written: list[Array]
    use: Callable[[ControllerDeclaration], None]
    control: Control = "gravity"
    gains: dict[Control, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        robot = self.robot
        self.goal: Array = self.measured.copy()
        undeclared = [_UNDECLARED[kind] for kind in robot.types]
        limits = undeclared if robot.velocity_limits is None else robot.velocity_limits
        self._fastest: Array = _SHARE * np.minimum(limits, 1e3)
        self._is_moving = True
        if not self.gains:
            self.gains = {
                "gravity": GravityCompensation(),
                "joint": JointImpedance(stiffness=self._first_stiffness(), damping=_DAMPING),
                "cartesian": CartesianImpedance(
                    stiffness=[_TRANSLATION] * 3 + [_ROTATION] * 3,
                    damping=_DAMPING,
                    nullspace_stiffness=_NULLSPACE,
                ),
            }

    def _first_stiffness(self) -> Array:
        self.model.update(self.measured, np.zeros(self.robot.n))
        by_inertia = _SWINGS**2 * np.diagonal(self.model.mass())
        stiffness = np.minimum(_PER_LIMIT * self.robot.torque_bounds, 5000.0)
        stiffness = np.where(np.isfinite(self.robot.torque_bounds), stiffness, by_inertia)
        digits = 10.0 ** np.floor(np.log10(np.maximum(stiffness, 1e-6)) - 1)
        return np.asarray(np.minimum(np.round(stiffness / digits) * digits, 5000.0))

    def choose(self, control: Control) -> str:
        """Changes the controller; the target is where the robot is then.

        Args:
            control: one of `CONTROLS`.

        Returns:
            why it cannot be; empty where it is.
        """
        self._stand()
        before = self.gains[control]
        for halving in range(_HALVINGS):
            declared = self.gains[control]
            if halving:
                declared = _changed(declared, {"stiffness": declared.stiffness / 2})
            try:
                self.gains[control] = declared
                self.use(declared)
            except DeclarationError as error:
                if control == "gravity" or halving == _HALVINGS - 1:
                    self.gains[control] = before
                    return _reason(error)
                continue
            break
        self.control = control
        return ""

    def change(self, values: Mapping[str, Any], text: Callable[[Mapping[str, Any]], str]) -> str:
        """Changes gains of the controller in use, at once; refuses what the step cannot hold.

        Args:
            values: gains by the fields of its declaration.
            text: writes some of them for the message.

        Returns:
            why they are refused, and the largest that the step holds; empty where they are not.
        """
        now = self.gains[self.control]
        try:
            declared = _changed(now, values)
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
                    self.use(_changed(now, part(share)))
                except DeclarationError:
                    return False
                return True

            largest = text(part(0.99 * largest_share(holds)))
            self.use(now)
            return f"refused: {_reason(error)}. At most {largest} holds here"
        self.gains[self.control] = declared
        return ""

    def _stand(self) -> None:
        """Puts the target to where the robot is, at its velocity, and lets it come to rest."""
        target = self.target
        target.angles[:] = target.posture[:] = self.measured
        target.velocities[:] = self.speeds
        # From there the target comes to rest without overshoot.
        self.goal = target.angles + target.velocities / _FREQUENCY
        self._place()
        self._is_moving = True

    def before(self, k: int) -> None:
        """Moves the target for the step that leads on from row k of the log."""
        target = self.target
        if self.control == "gravity":
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
        most = np.maximum(self._fastest, np.abs(velocities))  # it may come from a faster robot
        faster = np.clip(velocities + step * pull, -most, most)
        target.accelerations[:] = (faster - velocities) / step
        velocities[:] = faster
        angles += step * faster
        left = max(np.abs(self.goal - angles).max(), np.abs(velocities).max())
        self._is_moving = bool(left > _RESTS)
        if not self._is_moving:
            angles[:], velocities[:], target.accelerations[:] = self.goal, 0.0, 0.0
        target.posture[:] = angles
        self._place()

    def _place(self) -> None:
        """Moves the target's pose to its angles."""
        target = self.target
        self.model.update(target.angles, target.velocities)
        target.position[:] = self.model.flange_position
        target.rotation[:] = self.model.flange_rotation
        target.twist[:] = self.model.jacobian() @ target.velocities


class LiveControl:
    """The robots of a simulation whose controllers and targets are changed while it runs.

    Attributes:
        robots: by name.
    """

    def __init__(self) -> None:
        self.robots: dict[str, LiveRobot] = {}

    def begin(self, robots: dict[str, LiveRobot]) -> None:
        """Goes on with a simulation that has begun anew, and the controllers of before."""
        before, self.robots = self.robots, robots
        for name, robot in robots.items():
            if name in before:
                robot.control, robot.gains = before[name].control, before[name].gains
            robot.choose(robot.control)

    def before(self, k: int) -> None:
        """Moves all targets for the step that leads on from row k of the log."""
        for robot in self.robots.values():
            robot.before(k)


def _changed(declared: ControllerDeclaration, values: Mapping[str, Any]) -> ControllerDeclaration:
    """Returns a declaration with other gains; raises DeclarationError for what they cannot be."""
    given = {key: getattr(declared, key) for key in declared.model_fields_set}
    return type(declared)(**{**given, **values})


def _reason(error: DeclarationError) -> str:
    """What is wrong, without the place in a file that there is none of."""
    return "; ".join(problem.message for problem in error.problems)
