"""The tables `[dynamics]` and `[torque_control]` of a robot file, and checks of inertia tensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, model_validator

from ...base.declaration import Declaration, numbers, of_shape
from ...base.errors import Problem, mismatch, raise_any
from ...base.frames import Array

# Relative tolerance, because typed values are rounded and flat bodies are exactly at the bound.
_ROUNDING = 1e-6
_ZERO = 1e-12  # Relative to the largest moment, smaller moments are rounding errors.
# Density of the convex hull of a link, kg/m3, for hollow aluminum with motors and gears. With 840,
# the hulls of the moving links of the LWR have their true mass of 13.4 kg.
LINK_DENSITY = 840.0

_POINT_RADIUS = 0.005  # radius of the ball that replaces a point mass, m
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
    """Converts inertia tensors from a file to an array, shape (m, 3, 3), kg m2.

    Each entry is a 3 x 3 matrix or a list of 6 numbers: the tensor entries Ixx, Iyy, Izz, Ixy, Ixz
    and Iyz, as in URDF and MJCF. Raises ValueError for other entries.
    """
    if not isinstance(value, list | tuple | np.ndarray):
        raise mismatch(value, "a list with one tensor per link")
    tensors = np.empty((len(value), 3, 3))
    for k, entry in enumerate(value):
        array = numbers(entry)
        if array.shape == (6,):
            xx, yy, zz, xy, xz, yz = array
            tensors[k] = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
        elif array.shape == (3, 3):
            if np.abs(array - array.T).max() > _ROUNDING * max(float(np.abs(array).max()), 1e-300):
                found, expected = f"{link_name(k)}: found", "a symmetric 3 x 3 matrix"
                raise mismatch(array, expected, found)
            tensors[k] = (array + array.T) / 2
        else:
            found = " x ".join(map(str, array.shape)) or "one number"
            expected = "6 numbers (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) or a 3 x 3 matrix"
            raise Problem("", f"{link_name(k)}: found {found}", expected=expected).error()
    return tensors


def link_name(k: int) -> str:
    """Returns the name of body k of a robot for messages: `the base` or, for example, `link 2`."""
    return f"link {k}" if k else "the base"


def inertia_problem(tensor: Array) -> str | None:
    """Returns the reason why an inertia tensor (3, 3) about the center of mass is invalid, or None.

    The principal moments must be positive, and none may exceed the sum of the other two.
    Source: Featherstone, Rigid Body Dynamics Algorithms, 2008, section 2.13.
    """
    low, middle, high = np.linalg.eigvalsh(tensor)
    found = f"found principal moments {low:.4g}, {middle:.4g}, {high:.4g} kg m2"
    if low <= _ZERO * high:
        return f"{found}; expected positive moments"
    if low + middle < high * (1 - _ROUNDING):
        return (
            f"{found}; expected the largest moment to be at most the sum of the other two, "
            f"{low + middle:.4g}. Is the tensor about the center of mass?"
        )
    return None


def balanced_tensor(tensor: Array, mass: float) -> Array:
    """Returns a similar, valid inertia tensor (3, 3) with the same principal axes, in kg m2.

    The principal moments are raised to at least those of a ball with a radius of 5 mm. If the two
    smaller ones then sum to less than the largest, both are raised by the same amount.
    """
    moments, axes = np.linalg.eigh(tensor)
    moments = np.maximum(moments, 0.4 * mass * _POINT_RADIUS**2)
    moments[:2] += max(moments[2] - moments[0] - moments[1], 0.0) / 2.0
    return np.asarray((axes * moments) @ axes.T)


def principal_moments(tensor: Array) -> tuple[Array, Array]:
    """Returns the principal moments (3,), kg m2, and their axes as columns of a rotation matrix.

    The moments of flat bodies are corrected for rounding errors, which MuJoCo would reject.
    """
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    moments[2] = min(moments[2], (moments[0] + moments[1]) * (1 - 1e-12))
    return moments, axes


def rotate_tensors(tensors: Array, rotation: Array) -> Array:
    """Returns inertia tensors (..., 3, 3) in new axes, R_new_old @ I @ R_old_new."""
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
    """Masses, inertias, friction and elasticity of one robot. Missing values are estimated.

    Arrays with one row per link have n + 1 rows, for the base and the n links. Values are in SI
    units. For prismatic joints, the units are kg, N s/m, N and N/m instead of kg m2, Nm s/rad, Nm
    and Nm/rad.

    Attributes:
        frames: reference frames of centers of mass and tensors: `dh` for the frames of the DH
            table, or `zero_pose` for frames with the same origins whose axes are parallel to those
            of the base at zero joint angles.
        frame_origins: offsets of the frame origins along the axes of these frames, shape
            (n + 1, 3), m, for data from a model whose link frames have different origins.
        masses: masses, shape (n + 1,), kg. A massless link has mass 0 and a zero tensor.
        centers_of_mass: centers of mass, shape (n + 1, 3), m.
        inertias: inertia tensors about the centers of mass, kg m2: 3 x 3 matrices, or the 6 tensor
            entries Ixx, Iyy, Izz, Ixy, Ixz, Iyz as in URDF (not the products of inertia).
        inertia_repair: treatment of physically invalid tensors: `none` reports an error, `balance`
            replaces each by a similar valid tensor.
        mass_scale: factor for the masses and tensors of the moving links.
        density: density for mass estimates if no masses are declared, kg/m3.
        motor_inertias: rotor inertias times the squared gear ratios, shape (n,), kg m2.
        viscous_friction: viscous friction of motors and gears, on the motor side of the torque
            sensors, shape (n,), Nm s/rad.
        coulomb_friction: Coulomb friction of motors and gears, shape (n,), Nm.
        joint_stiffness: stiffness of gears and torque sensors, shape (n,), Nm/rad, for
            `elastic_joints`.
        joint_damping: damping in parallel with the joint stiffness, shape (n,), Nm s/rad.
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
        """Descriptions of the tensors that `inertia_repair` has replaced."""
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
                hint = ' Set inertia_repair = "balance" to replace it by a similar valid tensor.'
                hint = hint if reason.endswith("?") else f".{hint}"
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
        """Raises DeclarationError if the length of an array does not match n joints."""
        problems = _count_problems(self, _PER_LINK, n + 1, "one for the base and one per joint")
        problems += _count_problems(self, _PER_JOINT, n, _ROWS)
        raise_any(problems)


class TorqueControl(Declaration):
    """Parameters of the simulated joint torque control, which `run.torque_control` activates.

    Attributes:
        inertia_ratio: ratio of apparent to actual motor inertia, typically between 1/4 and 1/10
            (Albu-Schäffer, Ott, Hirzinger 2007).
        motor_inertias: apparent motor inertias at the joints, shape (n,), kg m2 or kg, instead of
            `inertia_ratio`.
        bandwidth: bandwidth of the low-pass filter of the measured torque, 1/s.
        damping: damping ratio of the oscillation of the apparent motor inertia on the joint spring
            if the link is fixed.
        friction_bandwidth: bandwidth of the friction observer, 1/s; 0 for no compensation.
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
        Problem(key, found=len(value), of="entries", expected=f"{count}, {what}")
        for key in keys
        if (value := getattr(table, key)) is not None and len(value) != count
    ]


def merge_tables(file_table: Any, override: Any) -> Any:
    """Returns a table of a robot file in which the entries of `override` replace those of the file.

    If masses, centers and tensors are all replaced, the reference frame of the file does not apply.
    """
    if not (isinstance(file_table, Mapping) and isinstance(override, Mapping)):
        return override
    whole = set(_INERTIAL) <= set(override)
    return {
        **{key: file_table[key] for key in file_table if not (whole and key in _FRAMES)},
        **override,
    }


def is_overridden(key: str, fields: Mapping[str, Any]) -> bool:
    """Whether `fields`, which override a robot file, contain a value for a dotted key."""
    name, _, inner = key.partition(".")
    table = fields.get(name)
    if name in ("dynamics", "torque_control") and isinstance(table, Mapping) and inner:
        return inner.partition(".")[0] in table
    return name in fields
