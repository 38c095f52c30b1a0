"""Base classes of controllers and of their declarations, and their inputs.

A package adds a kind of controller by an entry point in the group `sero_mj.controllers`:

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
from ...base.plugins import accept_old_names
from ...base.trust import FileOrigin, RequestedAction
from ...robots.declared.robot import SerialRobot
from .robot_model import RobotModel

if TYPE_CHECKING:
    from .robot_models import RobotModels


_NUMBERS = "one number, or one per joint"


def _one_or_more(value: Any) -> Any:
    if value is None:
        return None
    array = numbers(value)
    if array.ndim > 1 or array.size == 0:
        found, of = (array.ndim, "dimensions") if array.ndim > 1 else (0, "numbers")
        reason = "found an array with"
        raise Problem("", reason, found=found, of=of, expected=_NUMBERS).error()
    return np.atleast_1d(array)


def within(low: float, high: float, unit: str = "", note: str = "") -> AfterValidator:
    """Returns a validator for a range of values. Its error message contains `unit` and `note`."""
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
# Maximum stiffness of a controller, as a share of the stiffness of elastic joints.
# `StaticDeflection` is a contraction by this factor in every step.
SOFTEST = 0.8


class Sensed:
    """Sensor measurements of one robot, in arrays that are updated in place.

    Args:
        values: array of all measurements, shape (3, n), C-contiguous float64, used without a copy.
        motor_state: array of motor angles and velocities of elastic joints, shape (2n,), used
            without a copy. For rigid joints it is None, and the links' state is used.
        rows: leading shape of all arrays: () for one robot, (m,) for m robots.

    Attributes:
        time: time since the start, s.
        values: joint angles, velocities and torques, shape (3, n). The next four attributes are
            views of this array.
        state: joint angles, then joint velocities, shape (2n,).
        angles: joint angles, shape (n,), rad or m.
        velocities: joint velocities, shape (n,), rad/s or m/s.
        torques: torques on the link side of the gears, shape (n,), Nm or N.
        motor_state: motor angles, then motor velocities, on the link side of the gears, shape
            (2n,). A controller's springs and dampers must act on the motors. Otherwise it would not
            be passive, because elastic joints are between motors and links (Ott 2008).
        motor_angles: motor angles, shape (n,), a view of `motor_state`.
        motor_velocities: motor velocities, shape (n,), a view of `motor_state`.

    Raises:
        ValueError: `values` has another shape, type or memory layout.
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
    """The target of one robot. Each controller uses the values that it needs.

    Write to the arrays in place (`target.angles[:] = ...`).

    Attributes:
        motion: joint angles, velocities and accelerations, shape (3, n). The next three attributes
            are views of this array.
        angles: joint angles, shape (n,), rad or m.
        velocities: joint velocities, shape (n,), rad/s or m/s.
        accelerations: joint accelerations, shape (n,), rad/s2 or m/s2.
        torques: torques to be added to those of the controller, shape (n,), Nm or N.
        has_torques: whether `torques` and `wrench` are added. False is faster if both are zero.
        pose: flange pose T_world_flange, shape (4, 4), m. The next two attributes are views of it.
        position: position of the flange, shape (3,), m.
        rotation: rotation matrix of the flange, shape (3, 3).
        twist: twist of the flange in world axes, shape (6,), m/s, then rad/s.
        wrench: force and torque that the robot exerts at the flange, in world axes, shape (6,), N,
            then Nm.
        posture: target joint angles of the null space, shape (n,), rad or m.
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
        """Returns the target of one robot in a row.

        Its arrays are views of this target. If the row has several robots, pose, twist and wrench
        are new arrays.
        """
        made = Target(joints.stop - joints.start)
        pose = made.pose
        if made.posture.shape == self.posture.shape[1:]:
            pose, made.twist, made.wrench = self.pose[row], self.twist[row], self.wrench[row]
        made._take(
            self.motion[row][:, joints], self.torques[row, joints], self.posture[row, joints], pose
        )
        return made

    def set(self, other: Target) -> None:
        """Copies the values of a target with the same number of joints."""
        for key in ("motion", "torques", "posture", "pose", "twist", "wrench"):
            getattr(self, key)[...] = getattr(other, key)


class Controller:
    """Base class of controllers. Any object with the method `torques` is also a controller.

    For example::

        class Wave:
            def torques(self, sensed, target, out):
                out[:] = 5.0 * np.sin(sensed.time)

    All other methods and attributes are optional and have the defaults of this class.
    `ControllerDeclaration` describes `needs_target`, `needs_pose` and `may_be_probed`.

    Attributes:
        logged: values of additional log columns, which `ControllerDeclaration.logged` names.
        spans_robots: whether `joined` supports several robots per row.
    """

    needs_target: bool = True
    needs_pose: bool = False
    may_be_probed: bool = True
    is_in_real_time: bool = False
    origin: FileOrigin | None = None
    logged: Any = ()
    spans_robots = False

    @property
    def commanded_angles(self) -> Array | None:
        """Angles that the log stores as the robot's target, shape (n,), rad or m, or None."""
        return None

    @property
    def group(self) -> tuple[object, ...] | None:
        """Hashable key; `joined` can join controllers with equal keys. None if it cannot."""
        return None

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the motor torques of this step to `out`, shape (n,), Nm or N.

        `out` contains the torques of the last step. `sensed` and `target` must not be changed.
        """
        raise NotImplementedError

    def hold_links(self, joint_stiffness: Array) -> Array | None:
        """Prepares the controller for elastic joints with a stiffness, shape (n,), Nm/rad or N/m.

        Returns an array, shape (n,), Nm or N, to which the controller writes the torques that it
        would command at rest, in every step. `StaticDeflection` computes resting link angles from
        them. Returns None if these torques are the gravity torques.
        """
        return None

    def check(self, angles: Array) -> None:
        """Raises DeclarationError if the gains are unstable at the initial angles, shape (n,)."""

    def take_over(self, before: Any) -> None:
        """Copies the state, such as an integral, of the previous controller of the same class."""

    def begin(self, which: Bools) -> None:
        """Resets the rows that a mask selects, shape (m,)."""

    def close(self) -> None:
        """Ends programs and connections that the controller has started."""

    @classmethod
    def joined(cls, each: Sequence[Any], robots: int, model: RobotModels) -> Controller:
        """Returns one controller that computes the torques of all controllers in `each`.

        `each` lists new controllers with the same `group`, row by row, with `robots` per row.
        """
        raise NotImplementedError


class PlainController:
    """Adds the defaults of `Controller` to any object with the method `torques`."""

    group = None  # a third-party object is called alone

    def __init__(self, own: Any) -> None:
        self.own = own

    def __getattr__(self, key: str) -> Any:  # only for attributes that this class lacks
        own = self.__dict__["own"]
        return getattr(own, key) if hasattr(own, key) else getattr(_DEFAULTS, key)


_DEFAULTS = Controller()


def as_controller(controller: Any) -> Any:
    """Returns controllers and declarations unchanged. Wraps other objects in `PlainController`."""
    if isinstance(controller, Controller | ControllerDeclaration):
        return controller
    return PlainController(controller)


@dataclass(frozen=True)
class Slider:
    """A gain that can be changed while a robot is controlled.

    Attributes:
        value: current value.
        maximum: maximum value. The minimum is 0.
        text: printf format of the value, for example `%.1f Nm s/rad`.
        fields: function that takes a value, and returns the changed fields of the declaration.
        describe: function that formats the changed fields for a message.
        tip: tooltip.
        group: label of the collapsible group that contains the slider; empty for none.
    """

    label: str
    value: float
    maximum: float
    text: str
    fields: Callable[[float], dict[str, Any]]
    describe: Callable[[Mapping[str, Any]], str]
    tip: str = ""
    group: str = ""


def range_text(key: str, unit: str = "") -> Callable[[Mapping[str, Any]], str]:
    """Returns a function that formats the numbers in a field, such as `100 to 300 Nm/rad`."""

    def text(fields: Mapping[str, Any]) -> str:
        array = np.atleast_1d(fields[key])
        low, high = array.min(), array.max()
        numbers = f"{low:.4g}" if high - low < 1e-9 else f"{low:.4g} to {high:.4g}"
        return f"{numbers} {unit}".strip()

    return text


class ControllerDeclaration(Declaration, ABC):
    """Base class of controller declarations, with one subclass for each kind.

    A kind is an entry point in the group `sero_mj.controllers`. Its class has a field `kind`, a
    `Literal` of that name, and fields for its gains. A field with a number per joint accepts one
    number for all joints.

    Attributes:
        torque_limits: torque limit of each joint, Nm or N (default: the limits of the robot).
        torque_rate_limits: maximum rate of the torque of each joint, Nm/s or N/s (default: none).
        needs_target: whether the controller follows a target (default target: the initial pose).
        needs_pose: whether the controller follows a pose of the flange in addition to joint angles.
        protocol_joints: number of joints that the protocol supports; None for any number.
        may_be_probed: whether the controller may be called outside of a run, in order to compute
            its stiffness and damping for stability checks. False for external programs.
        logged: names of additional log columns, whose values are in `Controller.logged`.
        title: name in the list of controllers (default: `kind`).
        short: alternative name on the command line; empty for none.
        order: position in the list of controllers; built-in controllers have 10 to 90.
    """

    needs_target: ClassVar[bool] = True
    needs_pose: ClassVar[bool] = False
    protocol_joints: ClassVar[int | None] = None
    may_be_probed: ClassVar[bool] = True
    logged: ClassVar[tuple[str, ...]] = ()
    title: ClassVar[str] = ""
    short: ClassVar[str] = ""
    order: ClassVar[int] = 100

    torque_limits: MaybePerJoint = None
    torque_rate_limits: MaybePerJoint = None

    _origin: FileOrigin | None = PrivateAttr(None)

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        accept_old_names(cls, {"may_be_asked": "may_be_probed"})

    @property
    def is_in_real_time(self) -> bool:
        """Whether the controller needs a run in real time."""
        return False

    @property
    def origin(self) -> FileOrigin | None:
        """File that contains the declaration; None if it was made in Python."""
        return self._origin

    def set_origin(self, origin: FileOrigin) -> None:
        """Sets the file that contains the declaration, and whether this file is trusted."""
        self._origin = origin

    def actions(self, key: str = "") -> list[RequestedAction]:
        """Returns the programs and libraries that the controller would run (see `base.trust`).

        A kind that starts a program or loads code must override this.
        """
        return []

    def check_files(self) -> None:
        """Raises DeclarationError if a file that the declaration names does not exist."""

    @abstractmethod
    def make(self, model: RobotModel, timestep: float) -> Controller:
        """Returns the controller, without torque limits.

        Args:
            model: robot model that only this controller uses.
            timestep: time between two calls, s.

        Raises:
            DeclarationError: the gains do not fit the joints of the robot.
        """

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        """Returns the initial controller of a robot in live control, with default gains.

        Returns None if this kind is not available in live control, for example because gains have
        no defaults.
        """
        needed = any(field.is_required() for field in cls.model_fields.values())
        return None if needed else cls()

    def softer(self) -> Self | None:
        """Returns a copy with lower gains, to be tried if these are unstable, or None."""
        return None

    def sliders(self, robot: SerialRobot, first: Self) -> list[Slider]:
        """Returns sliders for the gains, scaled by those of the initial declaration `first`."""
        return []

    def changed(self, fields: Mapping[str, Any]) -> Self:
        """Returns a copy with changed gains. Raises DeclarationError if they are invalid."""
        declared = {key: getattr(self, key) for key in self.model_fields_set}
        changed = type(self)(**{**declared, **fields})
        changed._origin = self._origin
        return changed

    def per_joint(self, key: str, n: int) -> Array:
        """Returns a field as an array, shape (n,). Raises DeclarationError for a wrong length."""
        return per_joint(key, np.asarray(getattr(self, key)), n)


def per_joint(key: str, value: Array, n: int) -> Array:
    """Expands 1 or n numbers to shape (n,). Raises DeclarationError for another length."""
    if len(value) not in (1, n):
        raise Problem(
            key, found=len(value), of="entries", expected=f"{n} (one per joint) or 1 (for all)"
        ).error()
    return np.array(np.broadcast_to(value, n))
