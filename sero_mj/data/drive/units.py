"""Units in routes: their SI factors, and the units that inputs accept.

A dimension consists of the exponents of m, kg, s and rad. Angles have their own exponent, so that
degrees are not confused with millimeters. Plain numbers have exponents of zero and match any unit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...robots.declared.inputs import PLANAR, Input
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene

Dimension = tuple[int, ...]

NONE: Dimension = (0, 0, 0, 0)
LENGTH: Dimension = (1, 0, 0, 0)
_MASS: Dimension = (0, 1, 0, 0)
_TIME: Dimension = (0, 0, 1, 0)
_ANGLE: Dimension = (0, 0, 0, 1)
_FORCE: Dimension = (1, 1, -2, 0)
_TORQUE: Dimension = (2, 1, -2, 0)
_SPEED: Dimension = (1, 0, -1, 0)
_ANGULAR_VELOCITY: Dimension = (0, 0, -1, 1)

# Units by name, with the size in SI units and the dimension.
UNITS: dict[str, tuple[float, Dimension]] = {
    "rad": (1.0, _ANGLE),
    "mrad": (1e-3, _ANGLE),
    "deg": (np.pi / 180.0, _ANGLE),
    "rpm": (np.pi / 30.0, _ANGULAR_VELOCITY),
    "m": (1.0, LENGTH),
    "cm": (1e-2, LENGTH),
    "mm": (1e-3, LENGTH),
    "N": (1.0, _FORCE),
    "kN": (1e3, _FORCE),
    "mN": (1e-3, _FORCE),
    "Nm": (1.0, _TORQUE),
    "kNm": (1e3, _TORQUE),
    "mNm": (1e-3, _TORQUE),
    "Nmm": (1e-3, _TORQUE),
    "kg": (1.0, _MASS),
    "g": (1e-3, _MASS),
    "s": (1.0, _TIME),
    "ms": (1e-3, _TIME),
    "us": (1e-6, _TIME),
}
_NAMES: dict[Dimension, str] = {
    NONE: "a plain number",
    LENGTH: "a length (m)",
    _MASS: "a mass (kg)",
    _TIME: "a time (s)",
    _ANGLE: "an angle (rad)",
    _FORCE: "a force (N)",
    _TORQUE: "a torque (Nm)",
    _SPEED: "a velocity (m/s)",
    _ANGULAR_VELOCITY: "an angular velocity (rad/s)",
    (1, 0, -2, 0): "an acceleration (m/s2)",
    (0, 0, -2, 1): "an angular acceleration (rad/s2)",
}
_ARROWS: dict[str, Dimension] = {
    "force": _FORCE,
    "torque": _TORQUE,
    "velocity": _SPEED,
    "angular_velocity": _ANGULAR_VELOCITY,
}
# Dimensions of per-joint inputs, for revolute and for prismatic joints.
_JOINTS: dict[str, tuple[Dimension, Dimension]] = {
    "joint_angles": (_ANGLE, LENGTH),
    "torques": (_TORQUE, _FORCE),
    "commanded_torques": (_TORQUE, _FORCE),
    "gravity_torques": (_TORQUE, _FORCE),
    "friction_torques": (_TORQUE, _FORCE),
    "joint_velocities": (_ANGULAR_VELOCITY, _SPEED),
    "joint_accelerations": ((0, 0, -2, 1), (1, 0, -2, 0)),
}


def describe(dimension: Dimension) -> str:
    """Returns a dimension as text, such as `an angle (rad)` or `m2 kg s-3`."""
    units = zip(("m", "kg", "s", "rad"), dimension, strict=True)
    plain = " ".join(f"{unit}{'' if e == 1 else e}" for unit, e in units if e)
    return _NAMES.get(dimension, plain)


def units_of(scene: Scene, item: Input) -> list[Dimension]:
    """Returns the unit of each number of an input or output, or `NONE` if any unit is accepted.

    Arrows with their own `unit` accept any unit.
    """
    if item.kind == "vector":
        arrow = scene.arrows[item.name]
        return [_ARROWS[arrow.kind] if arrow.unit is None else NONE] * item.count
    if item.kind in ("angles", "values") and item.key in _JOINTS:
        revolute, prismatic = _JOINTS[item.key]
        kinematics = robot_of(scene, item).kinematics
        return [revolute if is_revolute else prismatic for is_revolute in kinematics.revolute]
    if item.is_pose and item.shape != (4, 4):
        return [LENGTH] * 2 + ([_ANGLE] if item.count == len(PLANAR) else [LENGTH] + [NONE] * 4)
    return [NONE] * item.count


def wrong_unit(units: Sequence[Dimension], taken: Sequence[Dimension], target: str) -> str:
    """Returns a message on the first unit that differs from the units `taken`; "" if none does."""
    for i, want in enumerate(taken):
        have = units[i if len(units) > 1 else 0]
        if any(have) and any(want) and have != want:
            differ = len({*units}) > 1 or len({*taken}) > 1
            where = f" at index {i}" if differ else ""
            return f"is {describe(have)}, but {target} takes {describe(want)}{where}"
    return ""


def robot_of(scene: Scene, item: Input) -> SerialRobot:
    """Returns the robot to which a per-joint input belongs, also if it is an input of a double."""
    double = scene.doubles.get(item.name)
    return scene.robots[item.name if double is None else double.of]
