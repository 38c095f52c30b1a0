"""The inputs of a scene, which routes set, and their slots in `userdata` of MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from ...base.declaration import numbers
from ...base.errors import DeclarationError, Problem, UnknownName, problems_of, shown
from ...base.frames import Array, frame, frame_from, quat_from_rotation, rotation_from_quat
from .couplings import CoupledJoints
from .robot import SerialRobot
from .robot_parts import ARROW_QUANTITIES, VALUE_INPUTS
from .scene import Scene, SceneToggles
from .surroundings import Object

# Contents of the slot of a source. Most are numbers of packets. Times are in seconds, and -1 if the
# event has not occurred.
SOURCE_FIELDS = (
    "received",
    "malformed",
    "age",  # time since the last valid packet
    "wrong_size",  # included in malformed
    "last_size",  # size of the last packet of a wrong size, bytes
    "size",  # expected size of a packet, bytes
    "fault_age",  # time since the last malformed packet
    "not_frames",  # included in malformed
    "wrong_constant",  # included in malformed
    "wrong_checksum",  # included in malformed
    # Each kind of source defines numbers for the states of the robot controller and of its
    # connection; -1 if there are none.
    "robot_state",
    "link_quality",
    "lost",  # missing sequence numbers
    "late",  # packets that arrived after a later packet
    "duplicates",
    "restarts",  # restarts of the sender's sequence
    "dropped",  # packets that the kernel dropped
    "senders",  # number of concurrent senders
    "link_age",  # time since the last loss, duplicate, restart or drop
    "foreign",  # packets from other senders than the configured `sender`
    "foreign_age",  # time since the last packet of another sender
    "implausible",  # included in malformed
    "failures",  # exceptions of the receiving thread, which was then restarted
    "is_failing",  # 1 after a failure, until a packet arrives or 10 s have passed
)
# Toggles that packets can set. A value above 0.5 means on. `arrow_quantity` is an index.
OWNER_TOGGLES = ("show_arrows", "show_billboards", "show_axes", "arrow_quantity")
# Inputs of every robot, in addition to its own `inputs`.
ROBOT_INPUTS = ("joint_angles", *VALUE_INPUTS, "base_frame", "flange_check", *OWNER_TOGGLES)
_TORQUES = ("torques", "commanded_torques", "joint_accelerations")
SCENE = "toggles"  # name of the inputs of the whole scene, such as `toggles.legend`

InputKind = Literal["angles", "values", "pose", "frame", "vector", "toggle"]
# Kinds of inputs in which NaN means "no data". Other kinds move something, so NaN is an error.
BLANKABLE = ("values", "vector", "toggle", "frame")
POSE_NUMBERS = ("x", "y", "z", "qw", "qx", "qy", "qz")  # alternative to a matrix
PLANAR = ("x", "y", "yaw")  # alternative to the matrix of a planar base
_UNIT_TOLERANCE = 1e-2  # deviation of the norm of a quaternion from 1
# Maximum magnitudes of valid values. They are far above those of any robot, and far below those
# that break images, because float32 resolves 6 cm at 1e6 m.
MAX_ANGLE = 1e6  # rad (160,000 rotations), or m for prismatic joints
MAX_POSITION = 1e6  # m
MAX_TORQUE = 1e9  # Nm or N, or rad/s^2 or m/s^2 for accelerations
MAX_OTHER = 1e15  # values of any unit that are only displayed


@dataclass(frozen=True)
class Input:
    """One input of a scene, such as `lwr.joint_angles`, which is the target of a route.

    Attributes:
        name: name of the owner, for example `lwr`.
        key: name of the input of this owner, for example `joint_angles`.
        shape: shape of the values: (n,), (3,), (4, 4) or (1,).
        kind: purpose: `angles` move a robot or double, `values` are shown at joints, a `pose` moves
            a base, object or camera, a `frame` is stored, a `vector` is shown as an arrow, and a
            `toggle` switches a feature on or off.
        coupled: couplings of the joints, or None. If set, the input also accepts values of the
            independent joints only.
    """

    name: str
    key: str
    shape: tuple[int, ...]
    kind: InputKind
    coupled: CoupledJoints | None = field(default=None, compare=False)

    @property
    def target(self) -> str:
        return f"{self.name}.{self.key}"

    @property
    def count(self) -> int:
        return int(np.prod(self.shape))

    @property
    def limits(self) -> Array:
        """Maximum magnitudes of valid values, in the shape of the input."""
        if self.is_pose:
            limits = np.full(self.shape, np.inf)
            if self.shape == (4, 4):
                limits[:3, 3] = MAX_POSITION
            else:
                limits[:3] = (
                    [MAX_POSITION] * 3 if self.count > 3 else [MAX_POSITION] * 2 + [MAX_ANGLE]
                )
            return limits
        limit = {"angles": MAX_ANGLE, "vector": MAX_TORQUE, "toggle": np.inf}.get(
            self.kind, MAX_TORQUE if self.key in _TORQUES else MAX_OTHER
        )
        return np.full(self.shape, limit)

    @property
    def is_pose(self) -> bool:
        """Whether the values describe a pose."""
        return self.kind in ("pose", "frame")

    @property
    def meaning(self) -> str:
        if self.kind in ("angles", "values"):
            per_joint = f"{self.count}, one per joint"
            if self.coupled is None:
                return per_joint
            return f"{per_joint}, or {self.coupled.k} without the coupled ones"
        if self.key == "arrow_quantity":
            return f"1 number, or one of {', '.join(ARROW_QUANTITIES)}"
        return {"vector": "3: x, y, z", "toggle": "1 number"}.get(self.kind, "a 4 x 4 frame")


def list_inputs(scene: Scene) -> dict[str, Input]:
    """Returns all inputs of a scene by target, for example `lwr.joint_angles`."""
    inputs: list[Input] = []

    def add(name: str, shape: tuple[int, ...], kind: InputKind, *keys: str) -> None:
        inputs.extend(Input(name, key, shape, kind) for key in keys)

    def add_per_joint(name: str, robot: SerialRobot) -> None:
        coupled = robot.coupled if robot.couplings else None
        keys = [*VALUE_INPUTS, *robot.inputs]
        inputs.append(Input(name, "joint_angles", (robot.n,), "angles", coupled))
        inputs.extend(Input(name, key, (robot.n,), "values", coupled) for key in keys)

    for name, robot in scene.robots.items():
        add_per_joint(name, robot)
        if robot.mount is None:  # otherwise another robot moves the base
            add(name, (4, 4), "pose", "base_frame")
        add(name, (4, 4), "frame", "flange_check")
        add(name, (1,), "toggle", *OWNER_TOGGLES)
    for name, double in scene.doubles.items():
        if double.of in scene.robots and double.path is None:
            add_per_joint(name, scene.robots[double.of])
            add(name, (1,), "toggle", *OWNER_TOGGLES)
        add(name, (1,), "toggle", "visible")
    for name in scene.arrows:
        add(name, (3,), "vector", "vector")
        add(name, (1,), "toggle", "show")
    for name in scene.frames:
        add(name, (4, 4), "frame", "frame")
        add(name, (1,), "toggle", "show_axes")
    for name in [*(item.name for item in scene.objects if _can_be_moved(item)), *scene.cameras]:
        add(name, (4, 4), "pose", "frame")
    add(SCENE, (1,), "toggle", *SceneToggles.model_fields)
    return {item.target: item for item in inputs}


def inputs_of_group(
    inputs: Mapping[str, Input], group: str, key: str, members: Sequence[str]
) -> list[Input]:
    """Returns the inputs of the group's members that an input of the group sets, in order.

    Raises:
        UnknownName: no member has an input with this key.
        ValueError: the input is a frame of several members, or not all members have it.
    """
    found = {name: inputs.get(f"{name}.{key}") for name in members}
    items = [item for item in found.values() if item is not None]
    if not items:
        keys = {item.key for item in inputs.values() if item.name in members}
        raise UnknownName(f"input of {group}", key, keys)
    having = [item.name for item in items]
    if items[0].shape == (4, 4):
        if len(items) > 1:
            names = ", ".join(having)
            message = f"one frame cannot set {key} of several robots ({names})"
            raise ValueError(f"{message}; expected a single robot")
        return items
    if len(items) < len(members):
        lacking = ", ".join(name for name in members if name not in having)
        message = f"'{key}' is an input of {', '.join(having)}, but not of {lacking}"
        raise ValueError(f"{message}; expected an input that all robots of {group} have")
    return items


def share_out(items: Sequence[Input], target: str, values: Any) -> list[Any]:
    """Distributes the values of an input of a group to the corresponding inputs of its members.

    Per-joint values may be those of all joints or of the independent joints. Other values are set
    for all members. Raises DeclarationError if the number of values is wrong, or if joint angles
    are not finite.
    """
    if items[0].kind not in ("angles", "values"):
        return [values] * len(items)
    full = [item.count for item in items]
    free = [item.count if item.coupled is None else item.coupled.k for item in items]
    array = to_array(replace(items[0], coupled=None), values)
    counts = next((each for each in (full, free) if array.shape == (sum(each),)), None)
    if counts is None or not (items[0].kind in BLANKABLE or np.isfinite(array).all()):
        found = shown(values) if array.ndim != 1 or not array.size else f"{array.size} numbers"
        if counts is not None:
            found = str(array.tolist())
        each = ", ".join(f"{item.name} {item.count}" for item in items)
        fewer = f", or {sum(free)} without the coupled joints" if free != full else ""
        finite = "" if items[0].kind in BLANKABLE else "finite "
        expected = f"{sum(full)} {finite}numbers ({each}){fewer}"
        raise Problem(target, f"found {found}", expected=expected).error()
    return np.split(array, np.cumsum(counts)[:-1])


def frame_of_numbers(numbers: Array, robot: SerialRobot | None = None) -> Array:
    """Converts the numbers of a packet to a frame, shape (4, 4), or to NaN if they are not a pose.

    Args:
        numbers: 16 numbers of a 4x4 matrix in row-major order, 7 numbers (x, y, z and a unit
            quaternion w, x, y, z), or 3 numbers (x, y and yaw of a planar base), m and rad.
        robot: robot with the planar base, or None.
    """
    if len(numbers) == len(PLANAR) and robot is not None:
        return robot.planar_base.pose(numbers)
    if len(numbers) != len(POSE_NUMBERS):
        return numbers.reshape(4, 4)
    length = np.linalg.norm(numbers[3:])
    if not abs(length - 1.0) <= _UNIT_TOLERANCE:
        return np.full((4, 4), np.nan)
    return frame(rotation_from_quat(numbers[3:] / length), numbers[:3])


def numbers_of_frame(T: Array, count: int, robot: SerialRobot | None = None) -> Array:
    """Returns the numbers that describe a frame, shape (count,): inverse of `frame_of_numbers`."""
    if count == len(PLANAR) and robot is not None:
        return robot.planar_base.place(T)
    if count == len(POSE_NUMBERS):
        return np.append(T[:3, 3], quat_from_rotation(T[:3, :3]))
    return T.ravel()


def _can_be_moved(item: Object) -> bool:
    return item.shape not in ("axes", "limb")


def moving(scene: Scene) -> set[str]:
    """Returns the names of objects and cameras that routes move, which need their own bodies."""
    names = {item.name for item in scene.objects} | set(scene.cameras)
    return {
        name
        for name, _, key in (target.partition(".") for target in scene.routes)
        if key == "frame" and name in names
    }


def userdata_slots(scene: Scene) -> tuple[dict[str, slice], dict[str, int], int]:
    """Allocates slots in `userdata` of MuJoCo for all inputs and sources of a scene.

    Returns:
        Slots by name (`lwr.torques`, `sources.udp`); for each input, the index of the flag that
        stores whether it is set; and the length of `userdata`.
    """
    lengths: dict[str, int] = {}
    inputs = list_inputs(scene)
    for target, item in inputs.items():
        if item.kind != "pose" and not (item.kind == "angles" and item.name in scene.robots):
            lengths[target] = item.count
    lengths |= {f"sources.{name}": len(SOURCE_FIELDS) for name in scene.sources}
    slots = {}
    start = 0
    for key, length in lengths.items():
        slots[key] = slice(start, start + length)
        start += length
    flags = {target: start + i for i, target in enumerate(inputs)}
    return slots, flags, start + len(flags)


def to_array(item: Input, values: Any) -> Array:
    """Converts the values of an input to an array, which is empty if they are not numeric.

    The name of an arrow quantity is converted to its index. Values of coupled joints are added if
    `values` contains independent joints only.
    """
    if isinstance(values, str) and item.key == "arrow_quantity" and values in ARROW_QUANTITIES:
        values = ARROW_QUANTITIES.index(values)
    if values is None or isinstance(values, str | bytes):  # NumPy would convert "12" and None
        return np.empty(0)
    try:
        array = np.asarray(values, dtype=np.float64)
        array = array if array.ndim else array[None]
    except (TypeError, ValueError):
        return np.empty(0)
    if item.coupled is None or array.shape != (item.coupled.k,):
        return array
    return item.coupled.full(item.key, array)


def to_frame(target: str, values: Array) -> Array:
    """Returns the frame (4, 4) for an input. Raises DeclarationError with the key `target`."""
    try:
        return frame_from(values, numbers)
    except ValueError as error:
        raise DeclarationError(problems_of(error, target)) from None
