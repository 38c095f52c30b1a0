"""The tables `[dynamics]` and `[torque_control]` of a robot file.

Link inertias, joint friction and elasticity, and the parameters of the joint torque control.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, model_validator

from ...base.declaration import Declaration, numbers, of_shape
from ...base.errors import Problem, mismatch, raise_any
from ...base.frames import Array

# Relative tolerance: typed values are rounded, and a flat plate meets the bound exactly.
_ROUNDING = 1e-6
_ZERO = 1e-12  # relative; smaller moments are rounding errors, and may be negative in other axes
# kg/m3 of a link's hull: hollow aluminium with motors and gears. At 840 the hulls of the LWR's
# moving links have their true mass of 13.4 kg.
LINK_DENSITY = 840.0

_POINT_RADIUS = 0.005  # m, of the ball that replaces a point mass
_INERTIAL = ("masses", "centers_of_mass", "inertias")
_FRAMES = ("frames", "frame_origins", "mass_scale")
_PER_LINK = (*_INERTIAL, "frame_origins")
_PER_JOINT = (
    "motor_inertias",
    "viscous_friction",
    "coulomb_friction",
    "joint_stiffness",
    "joint_damping",
)


def tensors_from(value: Any) -> Array:
    """Parses inertia tensors as given in a file, (m, 3, 3), kg m2; raises ValueError for others.

    An entry is 3 x 3, or 6 numbers (Ixx, Iyy, Izz, Ixy, Ixz, Iyz of the tensor, as in URDF and
    MJCF).
    """
    if not isinstance(value, list | tuple | np.ndarray):
        raise mismatch(value, "one tensor per link")
    tensors = np.empty((len(value), 3, 3))
    for k, entry in enumerate(value):
        array = numbers(entry)
        if array.shape == (6,):
            xx, yy, zz, xy, xz, yz = array
            tensors[k] = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        elif array.shape == (3, 3):
            if np.abs(array - array.T).max() > _ROUNDING * max(float(np.abs(array).max()), 1e-300):
                found, expected = f"{link_name(k)}: found", "a symmetric 3x3"
                raise mismatch(array, expected, found)
            tensors[k] = (array + array.T) / 2
        else:
            found = " x ".join(map(str, array.shape)) or "one number"
            expected = "6 numbers (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) or 3 x 3"
            raise Problem("", f"{link_name(k)}: found {found}", expected=expected).error()
    return tensors


def link_name(k: int) -> str:
    """Returns the name of body k for messages: the base, then the links from 1."""
    return f"link {k}" if k else "the base"


def inertia_problem(tensor: Array) -> str | None:
    """Returns why no rigid body has this tensor (3, 3), kg m2, about its centre; None if one can.

    Its principal moments are positive, and none is larger than the sum of the other two (each is an
    integral of a sum of two squares).
    Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.13.
    """
    low, middle, high = np.linalg.eigvalsh(tensor)
    found = f"found principal moments {low:.4g}, {middle:.4g}, {high:.4g} kg m2"
    if low <= _ZERO * high:
        return f"{found}; expected all of them positive"
    if low + middle < high * (1 - _ROUNDING):
        return (
            f"{found}; expected the largest to be at most the sum of the others, "
            f"{low + middle:.4g} (a tensor about the centre of mass?)"
        )
    return None


def balanced_tensor(tensor: Array, mass: float) -> Array:
    """Returns a similar valid tensor (3, 3), kg m2, for one that no rigid body can have.

    Its axes are kept. Principal moments are raised to at least those of a ball of `_POINT_RADIUS`,
    and the two smaller ones by equal amounts until their sum equals the largest.
    """
    moments, axes = np.linalg.eigh(tensor)
    moments = np.maximum(moments, 0.4 * mass * _POINT_RADIUS**2)
    moments[:2] += max(moments[2] - moments[0] - moments[1], 0.0) / 2.0
    return np.asarray((axes * moments) @ axes.T)


def principal_moments(tensor: Array) -> tuple[Array, Array]:
    """Returns the principal moments (3,), kg m2, and a rotation (3, 3) with their axes as columns.

    Rounding errors in the moments of a flat body are corrected, because MuJoCo tolerates none.
    """
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    moments[2] = min(moments[2], (moments[0] + moments[1]) * (1 - 1e-12))
    return moments, axes


def rotate_tensors(tensors: Array, rotation: Array) -> Array:
    """Returns tensors (..., 3, 3) in other axes: rotation_new_old @ I @ rotation_old_new."""
    return np.asarray(rotation @ tensors @ np.swapaxes(rotation, -1, -2))


def _no_negative_mass(masses: Array | None) -> Array | None:
    for k, mass in enumerate([] if masses is None else masses):
        if mass < 0:
            found, expected = f"{link_name(k)}: found", "a mass of 0 or more"
            raise mismatch(mass, expected, found, of="kg")
    return masses


def _at_least_zero(values: Array | None) -> Array | None:
    return _bounded(values, 0.0, "0 or more")


def _above_zero(values: Array | None) -> Array | None:
    return _bounded(values, np.finfo(float).tiny, "a positive number")


def _bounded(values: Array | None, lowest: float, expected: str) -> Array | None:
    for i, value in enumerate([] if values is None else values):
        if value < lowest:
            raise mismatch(value, expected, f"joint {i + 1}: found")
    return values


def _read_tensors(value: Any) -> Any:
    return value if value is None else tensors_from(value)


_Rows = Annotated[Array | None, of_shape(None, 3)]
_Masses = Annotated[Array | None, of_shape(None), AfterValidator(_no_negative_mass)]
_Tensors = Annotated[Array | None, BeforeValidator(_read_tensors)]
_NotNegative = Annotated[Array | None, of_shape(None), AfterValidator(_at_least_zero)]
_Positive = Annotated[Array | None, of_shape(None), AfterValidator(_above_zero)]


class Dynamics(Declaration):
    """Masses, inertias, friction and elasticity of one robot; omitted values are estimated.

    Rows per link are n + 1: the base, then the links. SI units: kg, m, kg m2, Nm s/rad, Nm,
    Nm/rad; for prismatic joints kg, N s/m, N, N/m.

    Attributes:
        frames: the frame of centres, tensors and origins: `dh`, the frame of the link's DH row
            (the base's for the base), or `zero_pose`, with axes parallel to the base's at zero
            joint angles and the same origin.
        frame_origins: (n + 1, 3), offsets of the origins of these frames along their own axes,
            m; for data from a model with different origins of its link frames.
        masses: (n + 1,); 0, with a tensor of zeros, for a massless link.
        centers_of_mass: (n + 1, 3).
        inertias: about the centre of mass, per link 6 numbers (Ixx, Iyy, Izz, Ixy, Ixz, Iyz, the
            entries of the tensor as in URDF, not the products of inertia) or 3 x 3.
        inertia_repair: handling of tensors that no rigid body can have, such as identified values
            or point masses: `none`, they are an error, or `balance`, see `balanced_tensor`;
            `repaired` lists the changes. Files may still use the old name `mend`.
        mass_scale: multiplies masses and tensors of the moving links.
        density: kg/m3, used to estimate links when no masses are given.
        motor_inertias: (n,), as seen at the joint: rotor times the square of the gear ratio.
        viscous_friction: (n,), of motor and gear, on the motor side of the torque sensor.
        coulomb_friction: (n,), likewise.
        joint_stiffness: (n,), of gear and torque sensor, for `elastic_joints`.
        joint_damping: (n,), in parallel with the stiffness.
    """

    renamed = {"mend": "inertia_repair"}

    frames: Literal["dh", "zero_pose"] = "dh"
    frame_origins: _Rows = None
    masses: _Masses = None
    centers_of_mass: _Rows = None
    inertias: _Tensors = None
    inertia_repair: Literal["none", "balance"] = "none"
    mass_scale: float = Field(1.0, gt=0)
    density: float = Field(LINK_DENSITY, gt=0)
    motor_inertias: _NotNegative = None
    viscous_friction: _NotNegative = None
    coulomb_friction: _NotNegative = None
    joint_stiffness: _Positive = None
    joint_damping: _NotNegative = None

    _repaired: list[str] = PrivateAttr(default_factory=list)

    @property
    def repaired(self) -> list[str]:
        """The changes by `inertia_repair`, a line for every link."""
        return list(self._repaired)

    @model_validator(mode="after")
    def _physical(self) -> Dynamics:
        problems: list[Problem] = []
        tensors = np.empty((0, 3, 3)) if self.inertias is None else self.inertias.copy()
        for k, tensor in enumerate(tensors):
            is_massless = self.masses is not None and k < len(self.masses) and not self.masses[k]
            reason = None if is_massless and not tensor.any() else inertia_problem(tensor)
            if reason is None:
                continue
            if self.inertia_repair == "none" or self.masses is None or k >= len(self.masses):
                hint = '; inertia_repair = "balance" changes it to a similar one'
                problems.append(Problem("inertias", f"{link_name(k)}: {reason}{hint}"))
                continue
            balanced = balanced_tensor(tensor, float(self.masses[k]))
            before, after = (
                ", ".join(f"{moment:.4g}" for moment in np.linalg.eigvalsh(each))
                for each in (tensor, balanced)
            )
            changed = f"principal moments {before} are now {after} kg m2"
            self._repaired.append(f"{link_name(k)}: {changed}")
            tensors[k] = balanced
        raise_any(problems)
        if self._repaired:
            self.__dict__["inertias"] = tensors
        return self

    @model_validator(mode="after")
    def _all_or_none(self) -> Dynamics:
        given = [key for key in _INERTIAL if getattr(self, key) is not None]
        if given and len(given) < len(_INERTIAL):
            missing = [key for key in _INERTIAL if key not in given]
            raise ValueError(
                f"found {' and '.join(given)} without {' and '.join(missing)}; expected all of "
                f"{', '.join(_INERTIAL)}, or none for an estimate"
            )
        return self

    def check_counts(self, n: int) -> None:
        """Checks that every table has the number of entries that n joints require.

        Raises:
            DeclarationError: with the keys of this table.
        """
        problems = _count_problems(self, _PER_LINK, n + 1, "the base and one per joint")
        problems += _count_problems(self, _PER_JOINT, n, _ROWS)
        raise_any(problems)


class TorqueControl(Declaration):
    """The joint torque control between controllers and motors, used if `run.torque_control` is on.

    Attributes:
        inertia_ratio: of apparent to actual motor inertia; a fourth to a tenth is usual
            (Albu-Schäffer, Ott, Hirzinger 2007).
        motor_inertias: (n,), apparent inertias, instead of a common ratio; kg m2 or kg, reflected
            to the joint.
        bandwidth: of the low-pass filter of the measured torque, 1/s.
        damping: ratio, of shaped motor inertia on the spring of an elastic joint with a held link.
        friction_bandwidth: of the friction observer, 1/s; 0 for no compensation.
    """

    inertia_ratio: float = Field(0.25, gt=0, le=1)
    motor_inertias: _Positive = None
    bandwidth: float = Field(1000.0, gt=0, le=1e5)
    damping: float = Field(0.7, ge=0, le=2)
    friction_bandwidth: float = Field(100.0, ge=0, le=1e5)

    def check_counts(self, n: int) -> None:
        problems = _count_problems(self, ("motor_inertias",), n, _ROWS)
        raise_any(problems)


_ROWS = "one per row of dh_params"


def _count_problems(
    table: Declaration, keys: Sequence[str], count: int, what: str
) -> list[Problem]:
    return [
        Problem(key, found=len(value), of="entries", expected=f"{count}: {what}")
        for key in keys
        if (value := getattr(table, key)) is not None and len(value) != count
    ]


def merge_tables(file_table: Any, override: Any) -> Any:
    """Returns a robot file's `[dynamics]` with entries overridden, or all by a `Dynamics`.

    When masses, centres and tensors are all overridden, so is the frame they are given in.
    """
    if not (isinstance(file_table, Mapping) and isinstance(override, Mapping)):
        return override
    whole = set(_INERTIAL) <= set(override)
    return {
        **{key: file_table[key] for key in file_table if not (whole and key in _FRAMES)},
        **override,
    }


def is_overridden(key: str, fields: Mapping[str, Any]) -> bool:
    """Whether a dotted key of a robot is set by fields that override its file."""
    name, _, inner = key.partition(".")
    table = fields.get(name)
    if name in ("dynamics", "torque_control") and isinstance(table, Mapping) and inner:
        return inner.partition(".")[0] in table
    return name in fields
