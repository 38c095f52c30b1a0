"""The tables `[dynamics]` and `[torque_control]` of a robot file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, model_validator

from ...base.declaration import Declaration, numbers, of_shape
from ...base.errors import Problem, mismatch, raise_any
from ...base.frames import Array

# Relative tolerance: typed values are rounded, and flat bodies are exactly at the bound.
_ROUNDING = 1e-6
_ZERO = 1e-12  # relative: smaller moments are rounding errors
# kg/m3 of the hull of a link: hollow aluminum with motors and gears. With 840, the hulls of the
# moving links of the LWR have their true mass of 13.4 kg.
LINK_DENSITY = 840.0

_POINT_RADIUS = 0.005  # m, radius of the ball that replaces a point mass
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
    """Parses inertia tensors from a file, and returns them as an array (m, 3, 3), kg m2.

    Each entry is 3 x 3 numbers or 6 numbers (Ixx, Iyy, Izz, Ixy, Ixz, Iyz of the tensor, as in URDF
    and MJCF). Raises ValueError for other entries.
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
    """Returns the name of body k for messages, where body 0 is the base."""
    return f"link {k}" if k else "the base"


def inertia_problem(tensor: Array) -> str | None:
    """Returns why an inertia tensor (3, 3), kg m2, is invalid, or None if it is valid.

    The tensor is about the center of mass. Its principal moments must be positive, and none may
    exceed the sum of the other two, because each is an integral of a sum of two squares.
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
    """Returns a valid tensor (3, 3), kg m2, with the principal axes of an invalid one.

    Principal moments are raised to at least those of a ball with `_POINT_RADIUS`. Then the two
    smaller ones are raised by equal amounts until their sum equals the largest.
    """
    moments, axes = np.linalg.eigh(tensor)
    moments = np.maximum(moments, 0.4 * mass * _POINT_RADIUS**2)
    moments[:2] += max(moments[2] - moments[0] - moments[1], 0.0) / 2.0
    return np.asarray((axes * moments) @ axes.T)


def principal_moments(tensor: Array) -> tuple[Array, Array]:
    """Returns the principal moments (3,), kg m2, and a rotation (3, 3) with their axes as columns.

    Corrects rounding errors in the moments of flat bodies, which MuJoCo would reject.
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
    """Masses, inertias, friction and elasticity of one robot. Missing values are estimated.

    Values per link have n + 1 rows: the base, then the links. Values are in SI units: kg, m, kg m2,
    Nm s/rad, Nm and Nm/rad, and for prismatic joints kg, N s/m, N and N/m.

    Attributes:
        frames: reference frame of centers of mass and tensors: `dh` for the frame of the DH row of
            the link, or `zero_pose` for a frame with the same origin whose axes are parallel to
            those of the base at zero joint angles.
        frame_origins: offsets (n + 1, 3) of the origins of these frames along their own axes, m,
            for data of a model whose link frames have other origins.
        masses: masses (n + 1,), kg; 0 and a zero tensor for a massless link.
        centers_of_mass: centers of mass (n + 1, 3), m.
        inertias: inertia tensors about the center of mass, kg m2, each with 3 x 3 or 6 numbers
            (Ixx, Iyy, Izz, Ixy, Ixz, Iyz, the entries of the tensor as in URDF, not the products of
            inertia).
        inertia_repair: treatment of invalid tensors, such as identified values or point masses:
            `none` reports an error, `balance` replaces them, see `balanced_tensor`.
        mass_scale: factor of the masses and tensors of the moving links.
        density: density for estimates if no masses are declared, kg/m3.
        motor_inertias: motor inertias (n,) at the joint: rotor inertia times the squared gear
            ratio, kg m2.
        viscous_friction: viscous friction (n,) of motor and gear, on the motor side of the torque
            sensor, Nm s/rad.
        coulomb_friction: Coulomb friction (n,) of motor and gear, Nm.
        joint_stiffness: stiffness (n,) of gear and torque sensor, for `elastic_joints`, Nm/rad.
        joint_damping: damping (n,) in parallel with the stiffness, Nm s/rad.
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
        """Descriptions of the tensors that `inertia_repair` replaced."""
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
        """Raises DeclarationError if an array has the wrong number of entries for n joints."""
        problems = _count_problems(self, _PER_LINK, n + 1, "the base and one per joint")
        problems += _count_problems(self, _PER_JOINT, n, _ROWS)
        raise_any(problems)


class TorqueControl(Declaration):
    """Parameters of the joint torque control, which is active if `run.torque_control` is true.

    Attributes:
        inertia_ratio: ratio of apparent to actual motor inertia, typically between 1/4 and 1/10
            (Albu-Schäffer, Ott, Hirzinger 2007).
        motor_inertias: apparent motor inertias (n,) at the joint, kg m2 or kg, instead of a common
            ratio.
        bandwidth: bandwidth of the low-pass filter of the measured torque, 1/s.
        damping: damping ratio of the apparent motor inertia on the spring of an elastic joint whose
            link is held.
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
        Problem(key, found=len(value), of="entries", expected=f"{count}: {what}")
        for key in keys
        if (value := getattr(table, key)) is not None and len(value) != count
    ]


def merge_tables(file_table: Any, override: Any) -> Any:
    """Returns the table of a robot file with overridden entries.

    If masses, centers and tensors are all overridden, their reference frame is, too.
    """
    if not (isinstance(file_table, Mapping) and isinstance(override, Mapping)):
        return override
    whole = set(_INERTIAL) <= set(override)
    return {
        **{key: file_table[key] for key in file_table if not (whole and key in _FRAMES)},
        **override,
    }


def is_overridden(key: str, fields: Mapping[str, Any]) -> bool:
    """Whether a dotted key is among the fields that override a robot file."""
    name, _, inner = key.partition(".")
    table = fields.get(name)
    if name in ("dynamics", "torque_control") and isinstance(table, Mapping) and inner:
        return inner.partition(".")[0] in table
    return name in fields
