"""What controllers share: what they get, the method that computes torques, and their gains.

A package adds a kind by an entry point in the group `sero_mj.controllers`:

    [project.entry-points."sero_mj.controllers"]
    pd = "my_package:PD"
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, PrivateAttr

from ...base.declaration import Declaration, numbers
from ...base.errors import Problem
from ...base.frames import Array, Bools
from ...base.trust import FileOrigin, RequestedAction
from ...robots.declared.robot import SerialRobot
from .robot_model import RobotModel

if TYPE_CHECKING:
    from .robot_models import RobotModels


def _one_or_more(value: Any) -> Any:
    if value is None:
        return None
    array = numbers(value)
    if array.ndim > 1 or array.size == 0:
        raise Problem(
            found=array.ndim, of="levels of lists", expected="one number or one per joint"
        ).error()
    return np.atleast_1d(array)


def within(low: float, high: float, unit: str = "", note: str = "") -> AfterValidator:
    """Returns a validator for arrays of numbers."""
    unit = unit and f" {unit}"

    def validate(array: Array) -> Array:
        bad = (array < low) | (array > high)
        if bad.any():
            raise Problem(found=array[bad][0], expected=f"{low:g} to {high:g}{unit}{note}").error()
        return array

    return AfterValidator(validate)


PerJoint = Annotated[Array, BeforeValidator(_one_or_more)]
MaybePerJoint = Annotated[Array | None, BeforeValidator(_one_or_more)]
Ratio = Annotated[PerJoint, within(0.0, 2.0, "(a ratio; 1 is critical damping)")]
DEFAULT_RATIO: Array = np.array([0.7])
# Of the stiffness of elastic joints: what a spring before them may have. `StaticDeflection` is a
# contraction by this factor in every step.
SOFTEST = 0.8


class Sensed:
    """What the sensors of one robot measure; the buffers are the same ones at every step.

    Args:
        values: (3, n), row after row in memory, to be used in place: what a simulation or a
            receiver writes is then seen without a copy.
        motor_state: (2n,), angles, then velocities of the motors where joints are elastic, to be
            used in place; those of the links when None.
        rows: () for one robot; (m,) for m of them, which are then the first axis of all.

    Attributes:
        time: s since the start.
        values: (3, n): angles, velocities, torques; the others are views of it.
        state: (2n,), angles, then velocities, so that one operation takes both.
        angles: (n,), rad or m.
        velocities: (n,), per second.
        torques: (n,), Nm or N, as the sensors on the link side of the gears read them.
        motor_state: (2n,), angles, then velocities of the motors, on the link's side of the gear.
            Springs and dampers act on these: with those of the links the control would not be
            passive, because the elastic joint is between them and the motors (Ott 2008).
        motor_angles: (n,), the first half of it.
        motor_velocities: (n,), the second.

    Raises:
        ValueError: the values are not (3, n), float64 and row after row.
    """

    __slots__ = (
        "angles",
        "motor_angles",
        "motor_state",
        "motor_velocities",
        "state",
        "time",
        "torques",
        "values",
        "velocities",
    )

    def __init__(
        self,
        n: int,
        values: Array | None = None,
        motor_state: Array | None = None,
        rows: tuple[int, ...] = (),
    ) -> None:
        self.time = 0.0
        self.values: Array = np.zeros((*rows, 3, n)) if values is None else values
        shape, kind = self.values.shape, self.values.dtype
        if shape != (*rows, 3, n) or kind != np.float64 or not self.values.flags.c_contiguous:
            gaps = "" if self.values.flags.c_contiguous else " with gaps"
            expected = f"{(*rows, 3, n)} float64 without gaps"
            raise ValueError(f"found {shape} {kind}{gaps}; expected {expected}")
        self.state: Array = self.values.reshape(*rows, 3 * n)[..., : 2 * n]
        self.angles: Array = self.values[..., 0, :]
        self.velocities: Array = self.values[..., 1, :]
        self.torques: Array = self.values[..., 2, :]
        self.motor_state: Array = self.state if motor_state is None else motor_state
        self.motor_angles: Array = self.motor_state[..., :n]
        self.motor_velocities: Array = self.motor_state[..., n:]


class Target:
    """The target of one robot; a controller reads what it needs and ignores the rest.

    Write into the arrays (`target.angles[:] = ...`): controllers keep them.

    Attributes:
        motion: (3, n), angles, velocities and accelerations.
        angles: (n,), rad or m; a view of `motion`, as are the two that follow.
        velocities: (n,), per second.
        accelerations: (n,), per second squared.
        torques: (n,), Nm or N, added to what the controller computes.
        has_torques: whether `torques` and `wrench` are added; false, and faster, where both are
            zero all the time.
        pose: (4, 4), T_world_flange, m.
        position: (3,), a view of it.
        rotation: (3, 3), a view of it.
        twist: (6,), of the flange in world axes: m/s, then rad/s.
        wrench: (6,), at the flange in world axes, that the robot is to exert: N, then Nm.
        posture: (n,), rad or m, where the null space is drawn to.
    """

    def __init__(self, n: int, rows: tuple[int, ...] = ()) -> None:
        self.has_torques = True
        self.twist: Array = np.zeros((*rows, 6))
        self.wrench: Array = np.zeros((*rows, 6))
        pose: Array = np.zeros((*rows, 4, 4))
        pose[:] = np.eye(4)
        self._take(np.zeros((*rows, 3, n)), np.zeros((*rows, n)), np.zeros((*rows, n)), pose)

    def _take(self, motion: Array, torques: Array, posture: Array, pose: Array) -> None:
        self.motion, self.torques, self.posture, self.pose = motion, torques, posture, pose
        self.angles: Array = motion[..., 0, :]
        self.velocities: Array = motion[..., 1, :]
        self.accelerations: Array = motion[..., 2, :]
        self.position: Array = pose[..., :3, 3]
        self.rotation: Array = pose[..., :3, :3]

    def part(self, row: int, joints: slice) -> Target:
        """The target of one of the robots in a row: views, but for the pose if there are others."""
        made = Target(joints.stop - joints.start)
        pose = made.pose
        if made.posture.shape == self.posture.shape[1:]:
            pose, made.twist, made.wrench = self.pose[row], self.twist[row], self.wrench[row]
        made._take(
            self.motion[row][:, joints], self.torques[row, joints], self.posture[row, joints], pose
        )
        return made

    def set(self, other: Target) -> None:
        """Takes over the values of another target of as many joints."""
        for key in ("motion", "torques", "posture", "pose", "twist", "wrench"):
            getattr(self, key)[...] = getattr(other, key)


class Controller:
    """Computes torques. Any object with the method `torques` is a controller as well.

    ```python
    class Wave:
        def torques(self, sensed, target, out):
            out[:] = 5.0 * np.sin(sensed.time)
    ```

    The other methods and attributes are optional powers, with what holds where they are missing.

    Attributes:
        needs_target: see `ControllerDeclaration`, as the two that follow.
        needs_pose: whether it follows the flange's pose.
        may_be_asked: whether it may be asked for torques of states that are not those of a run.
        logged: numbers for the log, as many as its declaration has names in `logged`.
        spans_robots: whether `joined` takes several robots of a row.
    """

    needs_target: bool = True
    needs_pose: bool = False
    may_be_asked: bool = True
    is_in_real_time: bool = False
    origin: FileOrigin | None = None
    logged: Any = ()
    spans_robots = False

    @property
    def commanded_angles(self) -> Array | None:
        """(n,) for the log as the robot's target, rad or m; None for none."""
        return None

    @property
    def group(self) -> tuple[object, ...] | None:
        """What controllers have in common that `joined` can make one of; None if called alone."""
        return None

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the motor torques of this step.

        Args:
            sensed: what the sensors say; not to be changed.
            target: what is asked for; not to be changed.
            out: (n,), Nm or N, to be written; holds the last step's.
        """
        raise NotImplementedError

    def hold_links(self, joint_stiffness: Array) -> Array | None:
        """Prepares for elastic joints, once.

        Args:
            joint_stiffness: (n,), Nm/rad or N/m.

        Returns:
            (n,), Nm or N: what it commands at rest, written at every step; from this the resting
            positions of the links are found. None if they are those of gravity.
        """
        return None

    def check(self, angles: Array) -> None:
        """Refuses gains for which the time step is too long.

        Args:
            angles: (n,), rad or m, where the robot starts.

        Raises:
            DeclarationError: names the joint that would shake most.
        """

    def take_over(self, before: Any) -> None:
        """Takes over what the controller before, of the same class, has built up: an integral."""

    def begin(self, which: Bools) -> None:
        """Begins anew with some of the rows, (m,)."""

    def close(self) -> None:
        """Ends what it has started."""

    @classmethod
    def joined(cls, each: Sequence[Any], robots: int, model: RobotModels) -> Controller:
        """One controller that is the same as several of one `group`, which have made no step.

        Args:
            each: of the robots of the first row, of the second, and so on.
        """
        raise NotImplementedError


class PlainController:
    """Any object with the method `torques`, with the defaults of `Controller` for what it lacks."""

    group = None  # a third-party object is called alone

    def __init__(self, own: Any) -> None:
        self.own = own

    def __getattr__(self, key: str) -> Any:  # only for what this class does not have
        own = self.__dict__["own"]
        return getattr(own, key) if hasattr(own, key) else getattr(_DEFAULTS, key)


_DEFAULTS = Controller()


def as_controller(controller: Any) -> Any:
    """The controller or declaration itself, or a `PlainController` of any other object."""
    if isinstance(controller, Controller | ControllerDeclaration):
        return controller
    return PlainController(controller)


@dataclass(frozen=True)
class Slider:
    """A gain that can be changed while a robot is controlled.

    Attributes:
        label: what a user reads.
        value: of now.
        most: the greatest; the least is 0.
        text: printf's format of the value, `%.1f Nm s/rad`.
        fields: returns the declaration's fields that have another value then.
        words: writes these fields for a message.
        tip: what it is, where the label does not say it.
        group: label of the folded group that it stands in; empty for none.
    """

    label: str
    value: float
    most: float
    text: str
    fields: Callable[[float], dict[str, Any]]
    words: Callable[[Mapping[str, Any]], str]
    tip: str = ""
    group: str = ""


def range_text(key: str, unit: str = "") -> Callable[[Mapping[str, Any]], str]:
    """Returns what writes the smallest to the largest number of a field, with their unit."""

    def text(fields: Mapping[str, Any]) -> str:
        array = np.atleast_1d(fields[key])
        low, high = array.min(), array.max()
        numbers = f"{low:.4g}" if high - low < 1e-9 else f"{low:.4g} to {high:.4g}"
        return f"{numbers} {unit}".strip()

    return text


class ControllerDeclaration(Declaration, ABC):
    """Base of the declarations of controllers, one class for each kind.

    A kind is an entry point in the group `sero_mj.controllers`; its class has a field `kind`, a
    `Literal` of that name, and its gains. Numbers per joint may be one for all.

    Attributes:
        torque_limits: (n,), Nm or N, where they are below those of the robot.
        torque_rate_limits: (n,), Nm/s or N/s; None for none.
        needs_target: whether it holds a pose, so that a robot without a target stays where it is.
        needs_pose: whether it follows the flange's pose, and not only joint angles.
        protocol_joints: number of joints that its protocol is for; None for any number.
        may_be_asked: whether it may be asked for torques of states that are not those of a run, as
            is done to find its gains.
        logged: names of numbers of its own that the log keeps; what it makes has them as `logged`,
            an array. Where that has `commanded_angles` as well, (n,) or None, the log keeps these
            as the robot's target.
        title: what a user reads who chooses among controllers; its `kind` when empty.
        short: another name for it on the command line; none when empty.
        order: among those that can be chosen, lowest first; sero-mj's own have 10 to 90.
    """

    needs_target: ClassVar[bool] = True
    needs_pose: ClassVar[bool] = False
    protocol_joints: ClassVar[int | None] = None
    may_be_asked: ClassVar[bool] = True
    logged: ClassVar[tuple[str, ...]] = ()
    title: ClassVar[str] = ""
    short: ClassVar[str] = ""
    order: ClassVar[int] = 100

    torque_limits: MaybePerJoint = None
    torque_rate_limits: MaybePerJoint = None

    _origin: FileOrigin | None = PrivateAttr(None)

    @property
    def is_in_real_time(self) -> bool:
        """Whether the run waits for the wall clock."""
        return False

    @property
    def origin(self) -> FileOrigin | None:
        """The file that it was read from; None if it was made in Python."""
        return self._origin

    def set_origin(self, origin: FileOrigin) -> None:
        """Says which file it was read from, and whether that file is trusted."""
        self._origin = origin

    def actions(self, key: str = "") -> list[RequestedAction]:
        """Returns what it starts or loads, see `base.trust`; nothing by default.

        A kind that starts a program or loads code has to override this.
        """
        return []

    def check_files(self) -> None:
        """Checks that the files that it names exist, without opening them.

        Raises:
            DeclarationError: one does not exist.
        """

    @abstractmethod
    def make(self, model: RobotModel, timestep: float) -> Controller:
        """The controller, without torque limits.

        Args:
            model: what it knows of its robot; it has it for itself.
            timestep: s between two calls.

        Raises:
            DeclarationError: gains that do not fit the robot's joints.
        """

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        """The controller that a robot to play with has at first.

        Returns:
            one with default gains; None where it cannot be chosen there, as where gains have no
            defaults.
        """
        needed = any(field.is_required() for field in cls.model_fields.values())
        return None if needed else cls()

    def softer(self) -> Self | None:
        """One that a longer time step holds; None where nothing can be done about that."""
        return None

    def sliders(self, robot: SerialRobot, first: Self) -> list[Slider]:
        """The gains that can be changed while it runs."""
        return []

    def changed(self, fields: Mapping[str, Any]) -> Self:
        """A declaration with other gains.

        Raises:
            DeclarationError: what they cannot be.
        """
        declared = {key: getattr(self, key) for key in self.model_fields_set}
        changed = type(self)(**{**declared, **fields})
        changed._origin = self._origin
        return changed

    def per_joint(self, key: str, n: int) -> Array:
        """A field as (n,) numbers.

        Raises:
            DeclarationError: it has neither one nor n.
        """
        return per_joint(key, np.asarray(getattr(self, key)), n)


def per_joint(key: str, value: Array, n: int) -> Array:
    """One number for all joints or n of them as (n,) numbers; raises DeclarationError."""
    if len(value) not in (1, n):
        raise Problem(
            key, found=len(value), of="entries", expected=f"{n}, one per joint, or one for all"
        ).error()
    return np.array(np.broadcast_to(value, n))
