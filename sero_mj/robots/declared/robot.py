"""`SerialRobot`: a robot declared by a Denavit-Hartenberg table and link geometry (Fig. 3).

Robots from URDF and MJCF may have joint frames instead of a table, and their joints may branch.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ...base import paths
from ...base.errors import DeclarationError
from ...base.frames import (
    MIRROR,
    Array,
    Ints,
    rotation_to_z,
)
from ...base.toml_file import located
from ..importers.importer import read_robot_file
from ..importers.joint_names import link_of_parent
from ..importers.mjcf_file import is_file_name
from ..kinematics.dh import DhTable
from ..kinematics.joint_tree import JointFrames, JointTree, PlanarBase
from .couplings import CoupledJoints, coupled_joints
from .degrees import degrees_warning
from .dynamics import is_overridden, merge_tables
from .joint_ranges import display_ranges, plausible_limits
from .limbs import all_limbs, find_limbs
from .robot_declaration import RobotDeclaration
from .robot_parts import IN_DEGREES, frame_label, frame_labels
from .shapes import clear_radii, housing_radii
from .surroundings import set_directory
from .torque_units import TorqueUnit, torque_units

log = logging.getLogger(__name__)

_AXES_OF_REACH = 0.2
_LIMBS_IN_REPR, _NAMES_IN_REPR = 8, 8


class SerialRobot(RobotDeclaration):
    """A robot like the `SerialRobot` proto of the paper, with derived quantities.

    `RobotDeclaration` documents the fields.
    """

    def frame_label(self, label: str) -> str:
        """Converts the name of a joint or an original link to a frame name such as `link3`."""
        others = [child.name for child in self.children]
        return label if label in others else frame_label(label, self.names, self.link_names)

    def __repr__(self) -> str:
        count = f"{self.n} joint{'s' * (self.n != 1)}"
        free = self.coupled.k
        count += f", {free} of them independent" if free < self.n else ""
        kind = "frames of joints" if self.dh is None else f"{self.dh_convention} DH"
        lines = [f"SerialRobot '{self.name}': {count}, {kind}, reach {self.reach:.4g} m"]
        limbs = self.limb_joints
        for limb, joints in list(limbs.items())[:_LIMBS_IN_REPR] if len(limbs) > 1 else []:
            lines.append(f"  {limb}: {_shortened([self.names[i] for i in joints])}")
        if len(limbs) > _LIMBS_IN_REPR:
            lines.append(f"  and {len(limbs) - _LIMBS_IN_REPR} more limbs")
        if len(limbs) <= 1:
            lines.append(f"  joints: {_shortened(self.names)}")
        return "\n".join(lines)

    __str__ = __repr__

    @classmethod
    def from_model(cls, model: str, **overrides: Any) -> SerialRobot:
        """Reads a robot file and overrides its fields.

        Args:
            model: name of an included robot (`lwr`), folder with a `robot.toml`, or path of a TOML
                file or of a file that an importer can read.
            **overrides: fields of `SerialRobot`, which override those of the file.

        Raises:
            UnknownName: no robot has this name.
            DeclarationError: the file or the overrides are invalid.
        """
        path = paths.find_model(model)
        return build_robot({"name": paths.model_name(path), **overrides}, path)

    @classmethod
    def from_urdf(
        cls,
        path: Path | str,
        packages: Mapping[str, Path | str] | None = None,
        arguments: Mapping[str, Any] | None = None,
        **overrides: Any,
    ) -> SerialRobot:
        """Reads a URDF file, or a xacro file if the package `xacro` is installed.

        If possible, a serial chain is converted to a Denavit-Hartenberg table with the same frames,
        and otherwise to `joint_frames`. Links that are fixed to each other are merged. Losses, such
        as missing meshes, are logged as warnings.

        Args:
            path: URDF or xacro file.
            packages: folders of ROS packages by name, for `package://NAME/...`. Other packages are
                searched for in the folders above the file and in paths from the environment.
            arguments: values of xacro arguments by name.
            **overrides: fields of `SerialRobot`, which override those of the file.

        Raises:
            DeclarationError: the file or the overrides are invalid.
        """
        path = Path(path)
        return build_robot({"name": paths.model_name(path), **overrides}, path, packages, arguments)

    @classmethod
    def from_mjcf(cls, source: Any, **overrides: Any) -> SerialRobot:
        """Reads a robot from MJCF, with all hinge and slide joints that actuators drive.

        Args:
            source: file name, text that starts with `<`, `mujoco.MjSpec`, PyMJCF element, or
                dm_control composer entity.
            **overrides: fields of `SerialRobot`, which override those of the model.

        Raises:
            DeclarationError: the model is invalid or has no joints.
        """
        if isinstance(source, Path) or is_file_name(source):
            path = Path(source)
            return build_robot({"name": paths.model_name(path), **overrides}, path)
        from ..importers.mjcf_robot import mjcf_tables  # most robots do not need MuJoCo here

        tables, warnings = mjcf_tables(source, Path())
        for warning in warnings:
            log.warning("%s", warning)
        return cls(**{**tables, **overrides})

    @cached_property
    def kinematics(self) -> JointTree:
        """The joint tree, computed from the DH table or the joint frames."""
        revolute = np.array([kind == "revolute" for kind in self.types])
        table: JointTree
        if self.joint_frames is not None:
            table = JointFrames(self.joint_frames, revolute, parents=self.carriers)
        else:
            assert self.dh_convention != "none"
            rows, columns = self.dh_params, tuple(self.dh_columns)
            root = None if np.array_equal(self.dh_base_frame, np.eye(4)) else self.dh_base_frame
            table = DhTable.from_rows(rows, self.dh_convention, columns, revolute)
            table = replace(table, parents=self.carriers, root=root)
        return table.mirrored() if self.mirrored else table

    @property
    def dh(self) -> DhTable | None:
        """The Denavit-Hartenberg table; None for a robot with joint frames."""
        table = self.kinematics
        return table if isinstance(table, DhTable) else None

    @property
    def carriers(self) -> Ints | None:
        """Index of the parent frame of each joint, shape (n,), 0 for the base; None for a chain."""
        if self.parents is None:
            return None
        return np.array([link_of_parent(each, self.names) for each in self.parents], np.intp)

    @property
    def planar_base(self) -> PlanarBase:
        """The plane and zero pose of the motion of a `planar` base."""
        normal = self.base_normal * ([1, -1, 1] if self.mirrored else 1)
        return PlanarBase(self.base_frame, rotation_to_z(np.eye(3), normal).T)

    @property
    def flange_link(self) -> int:
        """Index of the link that carries the flange, 1 to n."""
        return self.n if self.flange_on is None else self.names.index(self.flange_on) + 1

    @property
    def flange_joints(self) -> Ints:
        """Indices of the joints that move the flange, starting at the base."""
        return np.flatnonzero(self.kinematics.moves[self.flange_link])

    @property
    def has_geometry(self) -> bool:
        """Whether the geometry of the links is declared. If not, shapes are generated."""
        return bool(self.filenames) or self.mjcf is not None

    @property
    def is_foreign(self) -> bool:
        """Whether the robot is from URDF or MJCF, so its base may be above its lowest point."""
        return self.mjcf is not None or (
            self._model is not None and self._model.suffix in paths.robot_endings()
        )

    @property
    def T_n_flange(self) -> Array:
        """Pose of the flange in the frame of its link, shape (4, 4), m, mirrored if required."""
        return MIRROR @ self.flange_frame @ MIRROR if self.mirrored else self.flange_frame

    @property
    def link_poses(self) -> dict[str, tuple[int, Array]]:
        """Link index and pose T_link_original (4, 4) of each link of the original file, by name."""
        links = {label: i for i, label in enumerate(frame_labels(self.n))}
        return {
            name: (links[at.on], MIRROR @ at.frame @ MIRROR if self.mirrored else at.frame)
            for name, at in self.link_frames.items()
        }

    @property
    def child_frames(self) -> list[Array]:
        """Poses (4, 4) of `children` in their reference frames, m, mirrored if required."""
        frames = [child.frame for child in self.children]
        return [MIRROR @ T @ MIRROR for T in frames] if self.mirrored else frames

    @property
    def n(self) -> int:
        return len(self.dh_params if self.joint_frames is None else self.joint_frames)

    @property
    def types(self) -> list[str]:
        return list(self.joint_types or ["revolute"] * self.n)

    @property
    def names(self) -> list[str]:
        return self.joint_names or [f"J{i + 1}" for i in range(self.n)]

    @property
    def limb_joints(self) -> dict[str, list[int]]:
        """Joint indices of each declared or automatically detected limb, by name."""
        carriers = np.arange(self.n) if self.carriers is None else self.carriers
        followed = {name: coupling.to for name, coupling in self.couplings.items()}
        found = find_limbs(self.names, carriers.tolist(), followed)
        return all_limbs(self.names, found, self.limbs)

    @property
    def torque_bounds(self) -> Array:
        """Torque limits, shape (n,), Nm or N; infinite for joints without a limit."""
        return np.full(self.n, np.inf) if self.torque_limits is None else self.torque_limits

    @property
    def torque_units(self) -> list[TorqueUnit]:
        """Units in which the torques or forces of the n joints are displayed."""
        return torque_units(self.torque_bounds, [kind == "revolute" for kind in self.types])

    @property
    def arrow_radii(self) -> Array:
        """Arrow radii of the joints, shape (n,), m.

        By default, the arrows are clear of the generated shapes. If `fit_arrows` is
        true, the compiled scene uses radii that fit the geometry instead.
        """
        if self.has_geometry or "arrow_radius" in self.model_fields_set:
            return np.full(self.n, self.arrow_radius)
        return clear_radii(self.kinematics, self.housing_radii)

    @property
    def housing_radii(self) -> Array:
        """Radii of the generated joint housings, shape (n,), m."""
        return housing_radii(self.kinematics, self.T_n_flange, self.strokes, self.flange_link)

    @property
    def axes_length(self) -> float:
        """Length of the coordinate axes in m, by default in proportion to the robot."""
        if self.fit_arrows and "axes_size" not in self.model_fields_set:
            return _AXES_OF_REACH * self.reach
        if self.has_geometry or "axes_size" in self.model_fields_set:
            return self.axes_size
        return 4.0 * float(self.housing_radii[0])

    @property
    def plausible_limits(self) -> Array:
        """Position limits, shape (n, 2), rad or m; infinite for missing limits and placeholders."""
        return plausible_limits(self.position_limits, self.n)

    @property
    def display_ranges(self) -> Array:
        """Finite joint ranges, shape (n, 2), rad or m, for sliders, example motions and learning.

        A limit that is missing or at least 1000 rad or m is replaced by ±π rad for a revolute joint
        and by ±1 m for a prismatic joint. The limits of coupled joints also limit their driving
        joint.
        """
        return display_ranges(self.position_limits, self.types, self.home, self.coupled)

    @property
    def strokes(self) -> Array:
        """Upper limits of the prismatic joints, shape (n,), m; zero for joints without one."""
        upper = np.maximum(self.plausible_limits[:, 1], 0.0)
        return np.where(np.isfinite(upper) & ~self.kinematics.revolute, upper, 0.0)

    @property
    def reach(self) -> float:
        """Distance between base and flange in m, with all links aligned.

        Prismatic joints with position limits are fully extended. For a branching robot, this is the
        distance of the farthest link.
        """
        limits = self.plausible_limits
        tree, ends = self.kinematics, np.where(np.isfinite(limits), limits, 0.0).T
        along = tree.path_lengths(tree.distances(ends).max(axis=0))
        along[self.flange_link] += np.linalg.norm(self.flange_frame[:3, 3])
        return float(along.max())

    @property
    def offsets(self) -> Array:
        """Offsets of arrows and billboards from the joint frames, shape (n, 3), m.

        The default is the center of the generated housing. In the Craig convention, this is the
        frame origin. In the standard convention, the origin is at the other end of the offset d.
        Offsets of a mirrored robot are in frames whose z axes are the positive joint axes.
        """
        offsets = np.zeros((self.n, 3))
        if self.offsets_to_center_of_joints is not None:
            offsets = self.offsets_to_center_of_joints
        elif self.dh is not None and self.dh_convention == "standard" and not self.has_geometry:
            offsets[:, 2] = np.where(self.dh.revolute, self.dh.d, 0.0)
        if self.mirrored:
            turns = self.kinematics.revolute[:, None]
            offsets = offsets * np.where(turns, [1, 1, -1], [1, -1, 1])
        return offsets

    @property
    def home(self) -> Array:
        """Initial joint values, shape (n,), rad or m, by default zero for independent joints."""
        if self.joint_angles is not None:
            return self.joint_angles
        if not self.couplings:
            return np.zeros(self.n)
        return self.coupled.positions(np.zeros(self.coupled.k))

    @cached_property
    def coupled(self) -> CoupledJoints:
        return coupled_joints(self.names, self.couplings)

    def fwd_kin_base_to_flange(self, joint_angles: Any | None = None) -> Array:
        """Returns the pose of the flange in the base frame, shape (..., 4, 4), in m.

        Args:
            joint_angles: values of all joints, shape (..., n), or of the independent joints, shape
                (..., k), rad or m (default: the initial values).
        """
        q = self.home if joint_angles is None else np.asarray(joint_angles, np.float64)
        if self.couplings and q.shape[-1:] == (self.coupled.k,):
            q = self.coupled.full("joint_angles", q)
        return np.asarray(self.kinematics.frame(self.flange_link, q) @ self.T_n_flange)


def _shortened(names: Sequence[str]) -> str:
    if len(names) <= _NAMES_IN_REPR:
        return ", ".join(names)
    half = _NAMES_IN_REPR // 2
    return ", ".join([*names[:half], "...", *names[-half:]])


def warn_of_degrees(robot: SerialRobot, pose: Array, where: str = "") -> None:
    """Logs a warning if a declared pose (n,) of a robot is probably in degrees."""
    if len(pose) == robot.n and (warning := degrees_warning(robot, pose)):
        log.warning("%sjoint_angles of %s Use joint_angles_deg.", where, warning)


def _with_radians(robot: SerialRobot) -> SerialRobot:
    if robot.joint_angles is not None:
        warn_of_degrees(robot, robot.joint_angles)
    return robot


def build_robot(
    fields: Mapping[str, Any],
    model: Path | None = None,
    packages: Mapping[str, Path | str] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> SerialRobot:
    """Builds a robot from fields, which override those of a robot file.

    Args:
        fields: fields of `SerialRobot`. `dynamics` and `torque_control` override single entries of
            the tables in the file.
        model: robot file, or None.
        packages: folders of ROS packages by name, for URDF.
        arguments: values of xacro arguments by name.

    Raises:
        DeclarationError: the robot is invalid. Problems in the file include its name and the line.
    """
    if model is None:
        return _with_radians(SerialRobot(**fields))
    described = read_robot_file(model, packages, arguments)
    below = dict(described.tables)
    for warning in described.warnings:
        log.warning("%s", paths.without_temporary(f"{model}: {warning}"))
    if isinstance(below.setdefault("directory", ""), str):
        below["directory"] = str(model.parent / below["directory"])
    set_directory(below.get("children"), model.parent)
    for key in (*IN_DEGREES.values(), "dh_params"):  # rad replaces deg, and deg replaces rad
        if key in fields or f"{key}_deg" in fields:
            below.pop(key, None)
            below.pop(f"{key}_deg", None)
            if key == "dh_params":
                below.pop("length_unit", None)
    whole = {**below, **fields}
    for key in ("dynamics", "torque_control"):
        if key in below and key in fields:
            whole[key] = merge_tables(below[key], fields[key])
    try:
        robot = SerialRobot(**whole)
        robot._model = model
        return _with_radians(robot)
    except DeclarationError as error:
        placed = located(error.problems, model, described.lines)
        raise DeclarationError(
            [
                problem if is_overridden(problem.key, fields) else there
                for problem, there in zip(error.problems, placed, strict=True)
            ]
        ) from None
