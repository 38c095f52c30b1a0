"""The inputs of a scene, which routes can set, and their slots in `userdata`."""

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

# Contents of a source's slot.
SOURCE_FIELDS = (
    "received",
    "malformed",
    "age",  # s since the last valid packet, -1 when there was none
    "wrong_size",  # count, included in malformed
    "last_size",  # bytes of the last packet of a wrong size
    "size",  # bytes expected
    "fault_age",  # s since the last malformed packet, -1 when there was none
    "not_frames",  # count, included in malformed
    "wrong_constant",  # count, included in malformed
    "wrong_checksum",  # count, included in malformed
    "robot_state",  # of a robot's controller, and of the link to it, as numbers that the kind of
    "link_quality",  # source defines; -1 for those that define none, and before the first packet
    "lost",  # missing sequence numbers
    "late",  # out of order: arrived after a later packet
    "duplicates",
    "restarts",  # of the sender's sequence
    "dropped",  # by the kernel, for sources that must not lose any
    "senders",  # concurrent senders
    "link_age",  # s since one of these counts rose, except senders; -1 when none has
    "foreign",  # packets from other senders than the configured `sender`
    "foreign_age",  # s since the last of these, -1 when there was none
    "implausible",  # count, included in malformed
    "failures",  # of reception: exceptions, after which it restarted
    "is_failing",  # 1 until packets arrive after the last failure, or 10 s have passed
)
# Toggles that a packet can set; a value above 0.5 is on. `arrow_quantity` is an index.
OWNER_TOGGLES = ("show_arrows", "show_billboards", "show_axes", "arrow_quantity")
# Inputs of every robot, in addition to its own `inputs`.
ROBOT_INPUTS = ("joint_angles", *VALUE_INPUTS, "base_frame", "flange_check", *OWNER_TOGGLES)
_TORQUES = ("torques", "commanded_torques", "joint_accelerations")
SCENE = "toggles"  # `toggles.legend` switches for the whole scene

InputKind = Literal["angles", "values", "pose", "frame", "vector", "toggle"]
# Kinds in which NaN means "no data"; the others move something, so NaN is an error.
BLANKABLE = ("values", "vector", "toggle", "frame")
POSE_NUMBERS = ("x", "y", "z", "qw", "qx", "qy", "qz")  # in the place of a matrix
PLANAR = ("x", "y", "yaw")  # in the place of that of a planar base
_UNIT_TOLERANCE = 1e-2  # of a quaternion's length
# Largest magnitudes of values that are applied; a packet with a larger one is garbage. They are far
# above what any robot has, and far below where pictures fail: at 1e6 m, float32 resolves 6 cm.
MAX_ANGLE = 1e6  # rad, or m for prismatic joints: 160,000 turns
MAX_POSITION = 1e6  # m
MAX_TORQUE = 1e9  # Nm or N, also of forces, and rad/s^2 of accelerations
MAX_OTHER = 1e15  # of numbers of any unit that are only displayed


@dataclass(frozen=True)
class Input:
    """One input of a scene, the target of a route.

    Attributes:
        shape: of its values: (n,), (3,), (4, 4) or (1,).
        kind: `angles` move a robot or double, `values` are shown at joints, a `pose` moves a
            base, an object or a camera, a `frame` is stored, a `vector` is shown by an arrow, a
            `toggle` turns a feature on or off.
        coupled: couplings of the joints, if any; values of the independent joints then suffice.
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
        """Largest magnitude of each value that is applied, in the input's shape."""
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
        """Whether it is a pose: as a matrix, or as the numbers that a route has instead."""
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
    """Returns all inputs of a scene by `name.key`."""
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
        if robot.mount is None:  # else its carrier moves it
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
    """Returns the members' inputs for an input of their group, in order.

    Raises:
        UnknownName: no member has such an input.
        ValueError: not all of them have it, or several have it and it is a frame.
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
            raise ValueError(f"there is one frame, and {key} of {names}; expected one of these")
        return items
    if len(items) < len(members):
        lacking = ", ".join(name for name in members if name not in having)
        message = f"'{key}' is an input of {', '.join(having)}, but not of {lacking}"
        raise ValueError(f"{message}; expected it in all of {group}")
    return items


def share_out(items: Sequence[Input], target: str, values: Any) -> list[Any]:
    """Distributes values of all or of the independent joints to the inputs of a group's members.

    A switch applies to all. Raises ValueError for a wrong number of values, or one that moves
    something and is not finite.
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
        finite = "" if items[0].kind in BLANKABLE else " finite numbers"
        raise Problem(
            target, f"found {found}", expected=f"{sum(full)}{finite}: {each}{fewer}"
        ).error()
    return np.split(array, np.cumsum(counts)[:-1])


def frame_of_numbers(numbers: Array, robot: SerialRobot | None = None) -> Array:
    """Returns the frame (4, 4) that a packet's numbers describe; of NaN if they are no pose.

    Args:
        numbers: a matrix row by row, (16,); x, y, z and a unit quaternion w, x, y, z, (7,); or x, y
            and yaw of a planar base, (3,); m and rad.
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
    """Returns so many numbers (count,) for a frame, the inverse of `frame_of_numbers`."""
    if count == len(PLANAR) and robot is not None:
        return robot.planar_base.place(T)
    if count == len(POSE_NUMBERS):
        return np.append(T[:3, 3], quat_from_rotation(T[:3, :3]))
    return T.ravel()


def _can_be_moved(item: Object) -> bool:
    return item.shape not in ("axes", "limb")


def moving(scene: Scene) -> set[str]:
    """Returns the objects and cameras that a route moves, which therefore need their own body."""
    names = {item.name for item in scene.objects} | set(scene.cameras)
    return {
        name
        for name, _, key in (target.partition(".") for target in scene.routes)
        if key == "frame" and name in names
    }


def userdata_slots(scene: Scene) -> tuple[dict[str, slice], dict[str, int], int]:
    """Allocates a slot in `userdata` for every input and source.

    Returns:
        slots by name (`lwr.torques`, `sources.udp`), for every input the index of the flag that it
        was set, and the length of `userdata`.
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
    """Returns the values of an input as an array (k,) or more; empty if not numeric.

    The name of an arrow quantity is converted to its index, and missing coupled joints are added.
    """
    if isinstance(values, str) and item.key == "arrow_quantity" and values in ARROW_QUANTITIES:
        values = ARROW_QUANTITIES.index(values)
    if values is None or isinstance(values, str | bytes):  # numpy would read "12" and None
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
    """Returns a frame (4, 4); raises ValueError with the name of the input if it is invalid."""
    try:
        return frame_from(values, numbers)
    except ValueError as error:
        raise DeclarationError(problems_of(error, target)) from None
