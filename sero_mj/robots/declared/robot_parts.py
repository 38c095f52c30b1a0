"""Types of robot fields, such as limits, link geometry and billboard lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from ...base.declaration import Declaration, Frame, Name, Vector, numbers, of_shape
from ...base.errors import Problem, mismatch, nearest
from ...base.frames import Array, frame_from
from ..importers.joint_names import identifiers, is_joint_name
from ..kinematics.dh import COLUMNS, Column
from .surroundings import FinishName, MeshFile, Object, check_shape_size

# Packets select these quantities by index, so new ones must be added at the end.
ArrowQuantity = Literal[
    "torques", "torque_error", "joint_accelerations", "singularity", "torque_without_gravity",
    "torque_without_friction",
]  # fmt: skip
ARROW_QUANTITIES: tuple[str, ...] = get_args(ArrowQuantity)
# Per-joint inputs of every robot and double, in addition to joint angles and its own `inputs`.
VALUE_INPUTS = ("torques", "commanded_torques", "joint_accelerations", "billboard_values")
BILLBOARD_VALUES = (
    "torques",
    "commanded_torques",
    "torque_error",
    "joint_accelerations",
    "joint_angles",
    "billboard_values",
)
MAX_JOINTS = 128
LARGEST = "largest"  # torque limit of joints whose arrows scale with their largest torque so far
_MAX_CHILDREN = 2000  # the maximum number of objects of a scene
# Fields in degrees, and the corresponding fields in radians.
IN_DEGREES = {
    "position_limits_deg": "position_limits",
    "velocity_limits_deg": "velocity_limits",
    "joint_angles_deg": "joint_angles",
}
# Fields with one entry per joint.
PER_JOINT = (
    "joint_types",
    "joint_names",
    "position_limits",
    "position_limits_deg",
    "velocity_limits",
    "velocity_limits_deg",
    "torque_limits",
    "joint_angles",
    "joint_angles_deg",
    "offsets_to_center_of_joints",
    "acceleration_limits",
    "torques",
    "commanded_torques",
    "joint_accelerations",
    "billboard_values",
)


class Posed(Declaration):
    """Base class of declarations with initial joint angles in rad or degrees."""

    joint_angles: Vector | None = None
    joint_angles_deg: Vector | None = None

    @model_validator(mode="after")
    def _angles_from_degrees(self) -> Self:
        if self.joint_angles_deg is not None:
            if self.joint_angles is not None:
                raise ValueError("found both joint_angles and joint_angles_deg; expected only one")
            # This avoids another validation.
            self.__dict__["joint_angles"] = np.deg2rad(self.joint_angles_deg)
            self.__dict__["joint_angles_deg"] = None
        return self

    def check_degrees(self, types: Mapping[str, Sequence[str]]) -> list[Problem]:
        """Returns a problem if `joint_angles_deg` is set, but a robot has prismatic joints.

        `types` contains the joint types of each robot, by robot name.
        """
        sliding = [name for name, of_joints in types.items() if "prismatic" in of_joints]
        if "joint_angles_deg" not in self.model_fields_set or not sliding:
            return []
        message = f"is for revolute joints only, but {sliding[0]} has prismatic joints"
        return [Problem("joint_angles_deg", f"{message}. Use joint_angles instead, in rad and m")]


def _is_permutation(columns: list[str]) -> list[str]:
    if sorted(columns) != sorted(COLUMNS):
        raise ValueError(f"found {columns}; expected alpha, a, theta, d in any order")
    return columns


def _differ(names: list[str]) -> list[str]:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"'{name}' appears twice; expected different names")
    return names


def _tree_frames(value: Any) -> Any:
    if value is None:
        return None
    if not isinstance(value, list | tuple | np.ndarray):
        raise mismatch(value, "a list of frames, one per joint")
    if not 1 <= len(value) <= MAX_JOINTS:
        raise mismatch(len(value), f"1 to {MAX_JOINTS}, one per joint", of="frames")
    found = np.empty((len(value), 4, 4))
    for i, entry in enumerate(value):
        try:
            found[i] = frame_from(entry, numbers)
        except ValueError as error:
            raise ValueError(f"joint {i + 1}: {error}") from None
    return found


def _limits_of_shape(*shape: int | None) -> BeforeValidator:
    shaped: Any = of_shape(*shape).func

    def validate(value: Any) -> Any:
        try:
            array = np.asarray(value)
        except ValueError:
            array = np.empty(0)
        if array.dtype.kind != "f" or not np.isinf(array).any():
            return shaped(value)
        finite = shaped(np.where(np.isinf(array), 0.0, array))
        array = array.reshape(finite.shape)
        return np.where(np.isinf(array), array, finite)

    return BeforeValidator(validate)


def _are_ordered(limits: Array | None) -> Array | None:
    if limits is not None and (limits[:, 0] >= limits[:, 1]).any():
        row = int(np.flatnonzero(limits[:, 0] >= limits[:, 1])[0])
        expected = "a lower limit below the upper limit"
        raise mismatch(limits[row].tolist(), expected, f"row {row + 1} is")
    return limits


def _are_positive(limits: Array | None) -> Array | None:
    if limits is not None and (limits <= 0).any():
        raise mismatch(limits.tolist(), "positive numbers")
    return limits


def _no_words(limits: Any) -> Any:
    entries = limits if isinstance(limits, list | tuple) else [limits]
    if words := [entry for entry in entries if isinstance(entry, str)]:
        expected = f'a number, inf for no limit, or "{LARGEST}"'
        raise mismatch(words[0], expected)
    return limits


def split_largest(limits: Any) -> tuple[Any, bool]:
    """Replaces "largest" by None, or by inf in a list. Also returns whether it was replaced."""
    if isinstance(limits, str) and limits == LARGEST:
        return None, True
    if isinstance(limits, list | tuple):
        is_word = [isinstance(entry, str) and entry == LARGEST for entry in limits]
        if any(is_word):
            return [np.inf if word else entry
                    for entry, word in zip(limits, is_word, strict=True)], True  # fmt: skip
    return limits, False


def _children_differ(children: list[Object]) -> list[Object]:
    names = [child.name for child in children]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"two children have the name '{name}'")
    for child in children:
        if child.shape == "limb":
            raise ValueError(f"{child.name}: found a limb; expected limbs only in scene objects")
    return children


def _differ_from_standard(names: list[str]) -> list[str]:
    taken = {*BILLBOARD_VALUES, *VALUE_INPUTS, "base_frame", "flange_check", "flange_frame"}
    for name in names:
        if name in taken or name.startswith("show_") or name == "arrow_quantity":
            raise mismatch(name, "another name", "every robot already has an input or value")
    return names


Columns = Annotated[list[Column], AfterValidator(_is_permutation)]
JointNames = Annotated[list[Annotated[str, AfterValidator(is_joint_name)]], AfterValidator(_differ)]
OwnInputs = Annotated[list[Name], AfterValidator(_differ), AfterValidator(_differ_from_standard)]
Ranges = Annotated[Array | None, _limits_of_shape(None, 2), AfterValidator(_are_ordered)]
Limits = Annotated[Array | None, _limits_of_shape(None), AfterValidator(_are_positive)]
_Limit = float | Literal["largest"]
TorqueLimits = Annotated[
    Array | None,
    _limits_of_shape(None),
    BeforeValidator(_no_words, json_schema_input_type=_Limit | list[_Limit] | None),
    AfterValidator(_are_positive),
]
TreeFrames = Annotated[
    Array | None,
    BeforeValidator(_tree_frames, json_schema_input_type=list[list[Any] | dict[str, Any]] | None),
]
Children = Annotated[
    list[Object], Field(max_length=_MAX_CHILDREN), AfterValidator(_children_differ)
]


def _scales(value: Any) -> Any:
    if value is None:
        return None
    scale = numbers(value)
    if scale.shape not in ((), (3,)) or (scale == 0).any():
        raise mismatch(value, "a nonzero number, or three nonzero numbers for x, y and z")
    return np.broadcast_to(scale, 3).copy()


class LinkGeometry(Declaration):
    """The mesh file or primitive shape of a link.

    Attributes:
        file: mesh file, relative to the `directory` of the robot.
        shape: primitive shape instead of a file, or `generated` for shapes from the joint frames.
        size: full lengths and radii of the shape in m, in the order of an object's `size`.
        color: name of one of the `colors` of the robot.
        opacity: factor for the opacity of the color, from 0 (invisible) to 1.
        finish: surface finish, `plastic`, `metal` or `rubber`.
        frame: pose of the geometry in the frame of the link (T_link_geometry).
        scale: unit of the mesh file in m, as one number or three for x, y and z (default: the
            `mesh_scale` of the robot).
    """

    file: MeshFile | None = None
    shape: Literal["box", "sphere", "cylinder", "capsule", "ellipsoid", "generated"] | None = None
    size: Vector | None = None
    color: str | None = None
    opacity: float = Field(1.0, ge=0, le=1)
    finish: FinishName = "plastic"
    frame: Frame = Field(default_factory=lambda: np.eye(4))
    scale: Annotated[
        Array | None, BeforeValidator(_scales, json_schema_input_type=float | list[float] | None)
    ] = None

    @model_validator(mode="after")
    def _one_kind(self) -> LinkGeometry:
        if (self.file is None) == (self.shape is None):
            found = "neither file nor shape" if self.file is None else "both file and shape"
            raise ValueError(f"found {found}; expected one of them")
        if self.shape is not None and self.shape != "generated":
            check_shape_size(self.shape, self.size)
        elif self.size is not None:
            raise ValueError("`size` is only for primitive shapes. Use `scale` for a mesh")
        return self


class LinkFrame(Declaration):
    """The pose of a link that the original file of a robot defines.

    Attributes:
        on: name of the reference frame, `base`, `link1`, ...
        frame: pose of the link in the reference frame.
    """

    on: str = "base"
    frame: Frame = Field(default_factory=lambda: np.eye(4))


class BillboardLine(Declaration):
    """One line of a joint's billboard.

    Attributes:
        value: per-joint input to be shown, which may be one of the robot's `inputs`. `torque_error`
            is the commanded minus the measured torque.
        label: text before the number if a billboard has several lines.
        unit: text after the number (default: the SI unit of the value).
        decimals: number of decimals (default: depends on the value).
        scale: factor for the displayed value, for example 57.2958 for degrees.
    """

    value: str
    label: str = ""
    unit: str | None = None
    decimals: int | None = Field(None, ge=0, le=9)
    scale: float = 1.0


def frame_labels(n: int) -> list[str]:
    """Returns the frame names of a robot with n joints: `base`, `link1`, ..., `flange`."""
    return ["base", *(f"link{i + 1}" for i in range(n)), "flange"]


def frame_label(label: str, joints: Sequence[str], links: Sequence[str] | None) -> str:
    """Converts the name of a joint or an original link to the frame name, for example `link3`.

    A joint refers to the link that it moves. Other names are returned unchanged.
    """
    labels = frame_labels(len(joints))
    if label in labels:
        return label
    if label in joints:
        return labels[1 + joints.index(label)]
    if links and label in links:
        return labels[links.index(label)]
    joint = identifiers(joints).get(label)
    return label if joint is None else labels[1 + joint]


def as_link_geometry(value: Any) -> Any:
    """Converts the declared geometry of a link (file name, table, or list) to a list of tables."""
    if isinstance(value, str):
        return [{"file": value}] if value else []
    if isinstance(value, Mapping | LinkGeometry):
        return [value]
    if isinstance(value, list):
        return [{"file": entry} if isinstance(entry, str) else entry for entry in value]
    return value


LinkGeometries = Annotated[
    list[LinkGeometry],
    BeforeValidator(
        as_link_geometry, json_schema_input_type=str | LinkGeometry | list[str | LinkGeometry]
    ),
]


def as_billboard_lines(value: Any) -> Any:
    """Replaces names in a list of billboard lines by tables."""
    if isinstance(value, list):
        return [{"value": line} if isinstance(line, str) else line for line in value]
    return value


BillboardLines = Annotated[
    list[BillboardLine] | None,
    BeforeValidator(as_billboard_lines, json_schema_input_type=list[str | BillboardLine]),
]


def check_colors(links: list[list[LinkGeometry]], colors: Mapping[str, Any]) -> None:
    """Raises DeclarationError if a color of the link geometry is not declared in `colors`."""
    for part in (part for link in links for part in link):
        if part.color is not None and part.color not in colors:
            found = f"{part.file or part.shape}: no color"
            raise Problem("", found, found=part.color, available=colors).error()


def check_line_values(lines: list[BillboardLine] | None, own: list[str]) -> None:
    """Raises DeclarationError if a billboard line shows an unknown value.

    `own` contains the names of the robot's additional inputs.
    """
    for k, line in enumerate(lines or []):
        known = [*BILLBOARD_VALUES, *own]
        if line.value not in known:
            near = nearest(line.value, known)
            choices = f"{', '.join(map(repr, known[:-1]))} or {known[-1]!r}"
            hint = f"did you mean '{near}'?" if near else "to use your own value, add it to inputs"
            raise mismatch(line.value, f"{choices}; {hint}", key=f"{k}.value")


def dh_rows(rows: Array, in_degrees: Array | None, columns: list[str]) -> Array:
    """Returns the rows of a DH table in rad, shape (n, 4), from `rows` or else `in_degrees`.

    Raises DeclarationError if angles are implausible in rad, or if the number of rows is invalid.
    """
    angles = [columns.index("alpha"), columns.index("theta")]
    if in_degrees is not None:
        rows = in_degrees.copy()
        rows[:, angles] = np.deg2rad(rows[:, angles])
    elif (np.abs(rows[:, angles]) > 2 * np.pi + 1e-6).any():
        largest = float(np.abs(rows[:, angles]).max())
        raise mismatch(
            largest,
            "alpha and theta in rad, or dh_params_deg for degrees",
            "found an angle of",
            of="rad",
        )
    if not 1 <= len(rows) <= MAX_JOINTS:
        raise mismatch(len(rows), f"1 to {MAX_JOINTS}", of="rows")
    return rows
