"""`RobotDeclaration`: the fields of a robot and their validation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    PrivateAttr,
    ValidationInfo,
    field_validator,
    model_validator,
)

from ...base.declaration import Declaration, Frame, Name, Rgba, Vector, of_shape
from ...base.errors import Problem, mismatch, raise_any
from ...base.frames import Array
from ..importers.joint_names import BASE, link_of_parent
from ..kinematics.dh import COLUMNS
from .couplings import Coupling, coupled_joints, coupling_problems
from .dynamics import Dynamics, TorqueControl
from .fixed_rows import fixed_row_problem
from .limbs import limb_problems
from .robot_parts import (
    IN_DEGREES,
    MAX_JOINTS,
    PER_JOINT,
    VALUE_INPUTS,
    ArrowQuantity,
    BillboardLines,
    Children,
    Columns,
    JointNames,
    Limits,
    LinkFrame,
    LinkGeometries,
    LinkGeometry,
    OwnInputs,
    Ranges,
    TorqueLimits,
    TreeFrames,
    check_colors,
    check_line_values,
    dh_rows,
    frame_label,
    frame_labels,
    split_largest,
)
from .surroundings import Object, check_mjcf

# Values of the fields of the DH table in robots with `joint_frames`. Other values are errors.
_OF_TABLE: dict[str, Any] = {
    "dh_params": np.zeros((0, 4)),
    "dh_params_deg": None,
    "dh_columns": [*COLUMNS],
    "length_unit": "m",
    "dh_base_frame": np.eye(4),
}
_OTHER_CONVENTIONS = {  # other names of the two conventions
    "modified": "craig", "proximal": "craig", "classic": "standard", "distal": "standard",
}  # fmt: skip
_COUPLING_TOLERANCE = 1e-4  # rounding error of joint values in files, rad or m
_UP = np.array([0.0, 0.0, 1.0])


def _unit(direction: Array) -> Array:
    length = np.linalg.norm(direction)
    if length == 0.0:
        raise mismatch(direction.tolist(), "a nonzero vector")
    return np.asarray(direction / length)


class RobotDeclaration(Declaration):
    """The fields of a robot, with the names and defaults of the `SerialRobot` proto of the paper.

    Frames are 4x4 row-major arrays, lengths are in m, angles in rad, and torques in Nm (forces in N
    for prismatic joints). A robot has n joints (1 to 128), of which k are independent: they are not
    coupled to another joint. The joints form a chain, or a tree if `parents` is set.

    Attributes:
        name: name of the robot in routes, for example `lwr` in `lwr.joint_angles`.
        description: description in one line, shown by `sero-mj list`.
        note: note about the data, such as `approximate`, shown below the legend.
        dh_convention: convention of the DH table, `craig` (modified) or `standard`, or `none` if
            the robot has `joint_frames`. It must be declared.
        dh_params: DH table, shape (n, 4), one row per joint.
        dh_params_deg: DH table with alpha and theta in degrees, instead of `dh_params`.
        dh_columns: order of the four columns (default: alpha, a, theta, d).
        length_unit: unit of a and d in the DH table, `m` or `mm`. Other lengths are in m.
        dh_base_frame: pose of frame 0 of the DH table in the base frame (T_base_0).
        joint_frames: poses T_parent_i of all joints at joint value zero, shape (n, 4, 4), instead
            of a DH table. The z axis of frame i is the axis of joint i.
        parents: names of the parent joint of each joint, or `base`, for branching robots. If a
            joint is named `base`, use its link instead, for example `link2` (default: the previous
            joint).
        joint_types: type of each joint, `revolute` or `prismatic` (default: all revolute). Declare
            leading rows of a DH table that have no joint as `dh_base_frame`.
        joint_names: names of the joints in the robot's original file and in messages, with any
            printable characters (default: J1, J2, ...).
        link_names: n + 1 names of the base and the links in the robot's original file. They can be
            used instead of the frame names `base`, `link1`, ...
        link_frames: poses of all links of the original file by name, which relate ROS transforms
            (`tf`) to the robot.
        limbs: names of the joints of each limb, for routes and panels of branching robots. The
            remaining joints form limbs automatically.
        couplings: couplings by joint name, for example `{ to = "J3", ratio = 1, offset = 0 }`.
            Inputs and initial values (`joint_angles`, `torques`, ...) may then have k values
            instead of n.
        position_limits: lower and upper position limits, shape (n, 2), rad or m.
        position_limits_deg: lower and upper position limits in degrees, shape (n, 2).
        velocity_limits: velocity limits, shape (n,), rad/s or m/s.
        velocity_limits_deg: velocity limits in degrees per second, shape (n,).
        torque_limits: torque limits, shape (n,), Nm or N; inf for joints without a limit. The text
            `"largest"`, for all or single joints, means inf and sets `scale_by_largest`.
        scale_by_largest: whether arrows and billboards of joints without a torque limit are scaled
            by the largest torque so far. The torques are not limited.
        dynamics: masses, inertias and friction. Missing values are estimated.
        torque_control: parameters of the joint torque control in simulation.
        elastic_joints: whether simulated joints have the elasticity `dynamics.joint_stiffness`.
        acceleration_limits: accelerations at which arrows have full width, shape (n,), rad/s2 or
            m/s2.
        directory: folder of the mesh files.
        filenames: visual geometry of the base and the n links, each given by a file name, a table,
            or a list of these (default: shapes generated from the joint frames).
        collisions: collision geometry of the base and the n links, in the format of `filenames`.
            Meshes are replaced by their convex hulls (default: one hull of the visual geometry per
            link).
        colors: named colors for `filenames`, as red, green, blue and opacity, from 0 to 1.
        mjcf: MJCF model with the same joints, which provides the link geometry instead of
            `filenames` and `collisions`: a file relative to `directory`, text, or an object.
        mesh_scale: unit of the mesh files in m.
        mount: frame of another robot on which the base is mounted, for example `arm/flange`, or a
            joint whose link carries the base, `icub/l_elbow` (default: placed in the world).
        base_frame: pose of the base in the world, or in the frame `mount` of a mounted robot.
        free_base: whether the base moves freely in simulation, starting at `base_frame`: `true` for
            motion in space, `planar` for motion in a plane, like a mobile platform. Without
            simulation, an input moves the base, as for any robot.
        base_normal: normal of the plane of a `planar` base, in the base frame.
        base_joint: name of the joint of a free or planar base in the original file of the robot.
        mirrored: whether the robot is mirrored at the xz plane of its base, for example to get a
            left arm from a right one. Equal joint values result in mirrored poses, and equal
            torques hold them. With S = diag(1, -1, 1, 1), each frame T becomes S T S, so joints
            rotate in the negative direction about the z axes of their frames.
        flange_frame: pose of the flange in the frame of its link (T_n_flange).
        flange_on: name of the joint whose link carries the flange (default: the last joint).
        joint_angles: initial joint angles, shape (n,), used until data arrives.
        joint_angles_deg: initial joint angles in degrees, shape (n,).
        children: objects that are fixed to the flange or to another frame of the robot.
        enable_touch_sensor: whether a click on the robot toggles its features.
        stale_after: time without a packet after which the robot is shown gray, in seconds.
        offsets_to_center_of_joints: offsets of arrows and billboards in the joint frames, shape
            (n, 3), m (default: centers of the generated housings).
        show_axes: whether coordinate axes are shown at the base, each joint and the flange.
        axes_size: length of the axes in m (default: in proportion to generated shapes).
        axes_transparency: transparency of the axes, from 0 (opaque) to 1 (invisible).
        show_arrows: whether round arrows are shown.
        arrow_quantity: quantity that the arrows show: `torques`, `torque_error` (commanded minus
            measured torques), `joint_accelerations`, `singularity`, `torque_without_gravity`
            (measured torques minus gravity torques of the model), or `torque_without_friction`
            (measured torques minus the friction declared in `dynamics`).
        arrow_dead_band: fraction of the limit below which no arrow is shown, to hide noise.
        arrow_radius: radius of the round arrows in m (default: clear of generated shapes).
        fit_arrows: whether the radius of each arrow is fitted to the geometry of the adjacent
            links, instead of `arrow_radius`. Axes without `axes_size` then scale with the reach.
        arrow_width_scale: arrow width per torque for joints without a torque limit, m per Nm. If a
            joint has a limit, its arrow has a width of 0.45 times `arrow_radius` at the limit,
            scaled by the ratio of this value to its default of 0.01.
        torques: initial measured torques, n or k values, Nm or N; None for no data.
        commanded_torques: initial commanded torques, n or k values, Nm or N; None for no data.
        joint_accelerations: initial accelerations, n or k values, rad/s2 or m/s2; None for no data.
        show_billboards: whether billboards are shown.
        billboard_scale: text height as a fraction of 0.7 times the image height.
        billboard_values: initial billboard values, n or k values; None for no data.
        billboard_lines: quantities that the lines of the billboards show (default: one line per
            input with a route).
        inputs: names of additional per-joint inputs for billboards, such as `temperatures`.
        flange_tolerance: maximum distance between the received frame `flange_check` and the flange,
            m.
        flange_tolerance_deg: maximum angle between the received frame and the flange, degrees.
    """

    checked_alone: ClassVar[frozenset[str]] = frozenset(
        {
            *("description", "note", "enable_touch_sensor", "stale_after"),
            *("show_axes", "axes_size", "axes_transparency"),
            *("show_arrows", "arrow_radius", "fit_arrows", "arrow_width_scale", "arrow_quantity"),
            *("arrow_dead_band", "show_billboards", "billboard_scale"),
            *("flange_tolerance", "flange_tolerance_deg"),
        }
    )
    name: Name = "robot"
    description: str = ""
    note: str = ""
    dh_convention: Literal["craig", "standard", "none"]
    dh_columns: Columns = [*COLUMNS]
    length_unit: Literal["m", "mm"] = "m"
    dh_params_deg: Annotated[Array | None, of_shape(None, 4)] = None
    joint_frames: TreeFrames = None
    dh_params: Annotated[Array, of_shape(None, 4)] = np.zeros((1, 4))
    dh_base_frame: Frame = Field(default_factory=lambda: np.eye(4))
    joint_types: list[Literal["revolute", "prismatic"]] | None = None
    joint_names: JointNames | None = None
    link_names: list[str] | None = None
    link_frames: dict[str, LinkFrame] = {}
    parents: list[str] | None = None
    couplings: dict[str, Coupling] = {}
    limbs: dict[Name, list[str]] = {}
    position_limits: Ranges = None
    position_limits_deg: Ranges = None
    velocity_limits: Limits = None
    velocity_limits_deg: Limits = None
    torque_limits: TorqueLimits = None
    scale_by_largest: bool = False
    dynamics: Dynamics = Field(default_factory=Dynamics)
    torque_control: TorqueControl = Field(default_factory=TorqueControl)
    elastic_joints: bool = False
    acceleration_limits: Limits = None
    directory: str = ""
    colors: dict[str, Rgba] = {}
    filenames: list[LinkGeometries] = []
    collisions: list[LinkGeometries] | None = None
    mjcf: Any = None
    mesh_scale: float = Field(1.0, gt=0)
    mount: str | None = None
    mirrored: bool = False
    free_base: bool | Literal["planar"] = False
    base_joint: Name = "free_base"
    base_normal: Annotated[Array, of_shape(3), AfterValidator(_unit)] = _UP
    base_frame: Frame = Field(default_factory=lambda: np.eye(4))
    flange_frame: Frame = Field(default_factory=lambda: np.eye(4))
    flange_on: str | None = None
    joint_angles: Vector | None = None
    joint_angles_deg: Vector | None = None
    children: Children = []
    enable_touch_sensor: bool = True
    stale_after: float = Field(0.5, gt=0)
    offsets_to_center_of_joints: Annotated[Array | None, of_shape(None, 3)] = None
    show_axes: bool = False
    axes_size: float = Field(0.2, gt=0)
    axes_transparency: float = Field(0.0, ge=0, le=1)
    show_arrows: bool = False
    arrow_radius: float = Field(0.1, gt=0)
    fit_arrows: bool = False
    arrow_width_scale: float = Field(0.01, gt=0)
    arrow_quantity: ArrowQuantity = "torques"
    arrow_dead_band: float = Field(0.002, ge=0, lt=1)
    torques: Vector | None = None
    commanded_torques: Vector | None = None
    joint_accelerations: Vector | None = None
    show_billboards: bool = False
    billboard_scale: float = Field(0.05, gt=0, le=0.5)
    billboard_values: Vector | None = None
    inputs: OwnInputs = []
    billboard_lines: BillboardLines = None
    flange_tolerance: float = Field(0.001, gt=0)
    flange_tolerance_deg: float = Field(0.5, gt=0)

    _model: Path | None = PrivateAttr(None)  # robot file, for problems detected later
    # Files and keys of the tables that declare the robot in group models, outer ones first.
    _declared: tuple[tuple[Path, str], ...] = PrivateAttr(())

    @field_validator("dh_convention", mode="before")
    @classmethod
    def _name_of_convention(cls, name: object) -> object:
        if isinstance(name, str) and (ours := _OTHER_CONVENTIONS.get(name.lower())):
            raise mismatch(name, f"{ours!r}, the name of this convention in sero-mj")
        return name

    @field_validator("dh_params")
    @classmethod
    def _joint_count(cls, rows: Array, info: ValidationInfo) -> Array:
        if "dh_params_deg" not in info.data:
            raise ValueError("")  # invalid dh_params_deg was already reported
        if info.data.get("joint_frames") is not None or "joint_frames" not in info.data:
            return np.zeros((0, 4))
        columns = info.data.get("dh_columns", [*COLUMNS])
        return dh_rows(rows, info.data.get("dh_params_deg"), columns)

    @field_validator("joint_types", mode="before")
    @classmethod
    def _rows_have_joints(cls, types: Any, info: ValidationInfo) -> Any:
        if isinstance(types, list) and (problem := fixed_row_problem(types, info.data)) is not None:
            raise problem.error()
        return types

    @field_validator(*PER_JOINT)
    @classmethod
    def _one_per_joint(cls, value: Any, info: ValidationInfo) -> Any:
        n = _count(info.data)
        if value is None or n is None:
            return value
        if info.field_name in ("joint_angles", "joint_angles_deg", *VALUE_INPUTS):
            if not {"couplings", "joint_names"} <= info.data.keys():
                return value  # invalid couplings were already reported
            if info.data["couplings"] and info.field_name == "joint_angles_deg":
                return np.rad2deg(_with_coupled(np.deg2rad(value), info))
            if info.data["couplings"]:
                return _with_coupled(value, info)
        if len(value) != n:
            raise mismatch(len(value), f"{n}, {_each(info.data)}", of="entries")
        return value

    @field_validator("parents")
    @classmethod
    def _parents_come_before(cls, parents: list[str] | None, info: ValidationInfo) -> Any:
        names, problems = _known_names(info.data), list[Problem]()
        if parents is None or names is None:
            return parents
        if len(parents) != _count(info.data):
            expected = f"{_count(info.data)}, {_each(info.data)}"
            raise mismatch(len(parents), expected, of="entries")
        branch = [0]  # links between the base and the previous joint
        for i, parent in enumerate(parents):
            link = link_of_parent(parent, names)
            if link is None:
                problems.append(Problem(str(i), "no joint", found=parent, available=[BASE, *names]))
            elif link not in branch:
                reason = f"{names[i]} does not continue the branch of its parent {parent}"
                problems.append(Problem(str(i), reason, expected="joints in depth-first order"))
            branch = [*branch[: branch.index(link) + 1 if link in branch else 1], i + 1]
        raise_any(problems)
        return parents

    @field_validator("link_names")
    @classmethod
    def _names_of_links(cls, names: list[str] | None, info: ValidationInfo) -> list[str] | None:
        n = _count(info.data)
        if names is not None and n is not None and len(names) != n + 1:
            raise mismatch(len(names), f"{n + 1}, one for the base and one per link", of="entries")
        return names

    @field_validator("flange_on", "couplings", "limbs")
    @classmethod
    def _joints_exist(cls, value: Any, info: ValidationInfo) -> Any:
        names = _known_names(info.data)
        if value is None or names is None:
            return value
        if info.field_name == "couplings":
            raise_any(coupling_problems(names, value))
        elif info.field_name == "limbs":
            raise_any(limb_problems(names, value))
        elif value not in names:
            raise Problem("", "no joint", found=value, available=names).error()
        return value

    @field_validator("dynamics", "torque_control")
    @classmethod
    def _tables_suit_the_joints(
        cls, table: Dynamics | TorqueControl, info: ValidationInfo
    ) -> Dynamics | TorqueControl:
        n = _count(info.data)
        if n is not None:
            table.check_counts(n)
        return table

    @field_validator(*IN_DEGREES)
    @classmethod
    def _degrees_suit_the_joints(cls, limits: Array | None, info: ValidationInfo) -> Any:
        key = IN_DEGREES[str(info.field_name)]
        if limits is not None and info.data.get(key) is not None:
            raise ValueError(f"found both {key} and {info.field_name}; expected one of them")
        if limits is not None and "prismatic" in (info.data.get("joint_types") or []):
            raise ValueError(f"is for revolute joints only. Use {key} instead, in rad and m")
        return limits

    @model_validator(mode="before")
    @classmethod
    def _largest_instead_of_limits(cls, fields: Any) -> Any:
        if isinstance(fields, Mapping):
            limits, is_largest = split_largest(fields.get("torque_limits"))
            if is_largest:
                return {**fields, "torque_limits": limits, "scale_by_largest": True}
        return fields

    @model_validator(mode="before")
    @classmethod
    def _frames_instead_of_a_table(cls, fields: Any) -> Any:
        if isinstance(fields, Mapping) and fields.get("joint_frames") is not None:
            # Setting a field of an existing robot validates all fields again.
            as_without = {
                key
                for key in _OF_TABLE.keys() & fields
                if np.array_equal(fields[key], _OF_TABLE[key])
            }
            left = {key: value for key, value in fields.items() if key not in as_without}
            return {"dh_convention": "none", **left}
        return fields

    @model_validator(mode="after")
    def _frames_or_a_table(self) -> Self:
        given = sorted(_OF_TABLE.keys() & self.model_fields_set)
        if self.joint_frames is not None and (given or self.dh_convention != "none"):
            found = given[0] if given else f"dh_convention = '{self.dh_convention}'"
            raise ValueError(f"found {found} with joint_frames; expected only one of them")
        if self.joint_frames is None and self.dh_convention == "none":
            found = "found 'none' without joint_frames"
            raise Problem("dh_convention", found, expected="'craig' or 'standard'").error()
        return self

    @model_validator(mode="after")
    def _from_degrees(self) -> Self:
        if {"dh_params", "dh_params_deg"} <= self.model_fields_set:
            raise ValueError("found both dh_params and dh_params_deg; expected one of them")
        for in_degrees, key in IN_DEGREES.items():
            limits = getattr(self, in_degrees)
            if limits is not None:
                self.__dict__[key] = np.deg2rad(limits)  # avoids another validation
                self.__dict__[in_degrees] = None
        self.__dict__["dh_params_deg"] = None
        if self.length_unit == "mm":
            metres = [0.001 if column in ("a", "d") else 1.0 for column in self.dh_columns]
            self.__dict__ |= {"dh_params": self.dh_params * metres, "length_unit": "m"}
        for rows in (self.dh_params, self.dh_base_frame, self.joint_frames):
            if rows is not None:
                rows.setflags(write=False)  # `kinematics` is cached, so these must not change
        return self

    @field_validator("billboard_lines")
    @classmethod
    def _lines_have_values(cls, lines: Any, info: ValidationInfo) -> Any:
        check_line_values(lines, info.data.get("inputs", []))
        return lines

    @model_validator(mode="after")
    def _base_is_free_or_mounted(self) -> Self:
        if self.free_base and self.mount is not None:
            free = "true" if self.free_base is True else f'"{self.free_base}"'
            raise mismatch(
                self.mount, "only one of them", f"found {free} with mount =", key="free_base"
            )
        return self

    @field_validator("link_frames")
    @classmethod
    def _links_to_be_on_exist(
        cls, links: dict[str, LinkFrame], info: ValidationInfo
    ) -> dict[str, LinkFrame]:
        known = frame_labels(_count(info.data) or MAX_JOINTS)[:-1]
        problems = [
            Problem(f"{name}.on", "no frame", found=link.on, available=known)
            for name, link in links.items()
            if link.on not in known
        ]
        raise_any(problems)
        return links

    @field_validator("children")
    @classmethod
    def _frames_to_be_on_exist(cls, children: list[Object], info: ValidationInfo) -> list[Object]:
        names = _known_names(info.data)
        if names is not None:
            frames = frame_labels(_count(info.data) or 0)
            known = names, info.data.get("link_names")
            children = [
                child.model_copy(update={"on": frame_label(child.on, *known)}) for child in children
            ]
            problems = [
                Problem(f"{k}.on", "no frame", found=child.on, available=frames)
                for k, child in enumerate(children)
                if child.on not in frames
            ]
            raise_any(problems)
        return children

    @model_validator(mode="after")
    def _can_be_mirrored(self) -> Self:
        pieces = [child.name for child in self.children if child.mjcf or child.urdf]
        if self.mirrored and pieces:
            raise Problem(
                "mirrored",
                f"the child '{pieces[0]}' is from MJCF or URDF, and cannot be mirrored",
                expected="only shapes and meshes as children",
            ).error()
        return self

    @field_validator("mjcf")
    @classmethod
    def _is_mjcf_alone(cls, mjcf: Any, info: ValidationInfo) -> Any:
        if mjcf is not None and (info.data.get("filenames") or info.data.get("collisions")):
            raise ValueError("found mjcf with filenames or collisions; expected only one of them")
        return check_mjcf(mjcf)

    @field_validator("filenames", "collisions")
    @classmethod
    def _one_per_link(cls, links: list[list[LinkGeometry]] | None, info: ValidationInfo) -> Any:
        n = _count(info.data)
        if links is None or not any(links):
            # [""], the default of the proto, means no geometry.
            return links if info.field_name == "collisions" else []
        if n is not None and len(links) != n + 1:
            expected = f"{n + 1}, one for the base and one per joint"
            raise mismatch(len(links), expected, of="entries")
        check_colors(links, info.data.get("colors", {}))
        return links


def _count(fields: Mapping[str, Any]) -> int | None:
    rows = fields.get("joint_frames")
    if rows is None:
        rows = fields.get("dh_params")
    return None if rows is None or not len(rows) else len(rows)


def _each(fields: Mapping[str, Any]) -> str:
    by_frames = fields.get("joint_frames") is not None
    return "one per frame of joint_frames" if by_frames else "one per row of dh_params"


def _joint_names(fields: Mapping[str, Any]) -> list[str]:
    names: list[str] | None = fields["joint_names"]
    return names or [f"J{i + 1}" for i in range(_count(fields) or 0)]


def _known_names(fields: Mapping[str, Any]) -> list[str] | None:
    is_known = _count(fields) is not None and "joint_names" in fields
    return _joint_names(fields) if is_known else None


def _with_coupled(values: Array, info: ValidationInfo) -> Array:
    """Returns the angles of all n joints, given n or k angles.

    Values of other quantities are returned unchanged. Raises ValueError if an angle contradicts its
    coupling, or if the number of values is neither n nor k.
    """
    names = _joint_names(info.data)
    coupled = coupled_joints(names, info.data["couplings"])
    if len(values) not in (coupled.n, coupled.k):
        count = f"{coupled.n}, {_each(info.data)}, or {coupled.k} without the coupled joints"
        raise mismatch(len(values), count, of="entries")
    if info.field_name in VALUE_INPUTS:
        return values
    if len(values) == coupled.k:
        return coupled.positions(values)
    right = coupled.positions(values[coupled.independent])
    for name, found, expected in zip(names, values, right, strict=True):
        if abs(found - expected) > _COUPLING_TOLERANCE:
            raise ValueError(
                f"found {found:g} for {name}; expected {expected:g} because of its coupling"
            )
    return values
