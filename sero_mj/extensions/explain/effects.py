"""Effects of faults on the residuals of a robot's torques: `JointEffect` and `CommonEffect`.

Each effect is linear in its parameters. A `JointEffect` concerns one joint, and a `CommonEffect`
all joints, for example a payload. `Search` fits the parameters. See `explain` for the formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ...base.frames import Array, frame
from ...robots.assemble.robot_dynamics import GRAVITY
from ...study.explanation import ALL_JOINTS, BASE, COMMANDS, FLANGE, LINKS, Kind, Part
from .base_parameters import standard_parameters, standard_torques
from .torque_residuals import DELAYS, OF_MOTORS, TorqueResiduals

# Prior standard deviations: of a gain, of a torque as a share of the torque limit, and of a factor
# that is 1 if the value of an effect is exact, with the valid range of the factor.
_GAIN, SHARE, _FACTOR = 1.0, 0.1, 1.3
_DELAY_RANGE, _LEVEL_RANGE = (0.4, 2.0), (0.8, 1.25)
_MAX_GAIN = 2.6  # maximum deviation from 1
MIN_SIGN = 1.7  # minimum deviation from 1 of a gain that is reported as a wrong sign
_TRIED_DELAYS = (0.003, 0.008, 0.02, 0.04, 0.07, 0.1)  # s, then refined
# Tried torques at which a drive saturates, as shares of the largest command, then refined.
_TRIED_LEVELS = np.geomspace(0.05, 0.95, 20)
_LEVEL_STEPS = (0.93, 0.98, 0.995, 1.005, 1.02, 1.07)
_MIN_RANGE = 0.1  # rad or m, of the angles at which a spring is visible
_MIN_INERTIA = 0.15  # share of the declared motor inertia
_MAX_SIGN = 0.9  # magnitude of the mean sign of a torque at which backlash is visible
_MAX_OFFSET = 0.2  # rad or m, of an encoder offset with a linear effect
# Prior standard deviations in SI units.
_PAYLOAD = np.array([5.0, *3 * [1.0], *6 * [0.3]])
_MASSES, _ENCODER, _FORCE, _TILT = 0.5, 0.1, 50.0, 2.0
_COMPLIANCE, _BACKLASH, _CENTER = 1e-3, 0.01, 1.0
_CLOCK = np.array([0.05, 0.01])  # s and s/s
_NO_LIMIT = (-np.inf, np.inf)


@dataclass(frozen=True)
class Size:
    """The reported size of a fault, see `Explanation`."""

    size: float
    error: float
    unit: str
    values: Mapping[str, float] = field(default_factory=dict)


SizeOf = Callable[[Array, Array, int], Size]


@dataclass(frozen=True, eq=False)
class Effect:
    """The effect of a kind of fault on the residuals.

    Attributes:
        priors: prior standard deviations of the parameters, shape (p,), or (n, p) by joint.
        size: converts the parameters and their standard errors, shape (p,) each, and the index of
            the joint (-1 for all joints) to the reported size.
        is_constant: whether the fault exists during the whole run.
        allowed: range of the first parameter.
        min_size: minimum reported size.
    """

    kind: Kind
    part: Part
    priors: Array
    size: SizeOf
    is_constant: bool = field(default=False, kw_only=True)
    allowed: tuple[float, float] = field(default=_NO_LIMIT, kw_only=True)
    min_size: float = field(default=0.0, kw_only=True)


@dataclass(frozen=True, eq=False)
class JointEffect(Effect):
    """A fault of one joint.

    Attributes:
        columns: for each parameter, the change of the residuals of link and motor per unit of the
            parameter, shape (K, n) each.
        least: minimum magnitude of the first parameter of each joint, shape (n,); None for 0.
        lowest: minimum of the first parameter of each joint, shape (n,); None for no minimum.
        variants: function that converts the fitted first parameter to effects with other values to
            try, for effects that are not linear in their value, such as delays; None for others.
    """

    columns: Sequence[tuple[Array, Array]] = ()
    least: Array | None = None
    lowest: Array | None = None
    variants: Callable[[float], Sequence[JointEffect]] | None = None


@dataclass(frozen=True, eq=False)
class CommonEffect(Effect):
    """A fault that affects all joints.

    Attributes:
        place: `FLANGE`, `LINKS`, `BASE`, `COMMANDS`, or the name of a joint.
        torques: effects on one side of the joints per unit of each parameter, shape (K, n, p).
        side: 0 for the link side, 1 for the motor side.
    """

    place: str = LINKS
    torques: Array = field(default_factory=lambda: np.zeros((0, 0, 1)))
    side: int = 0


def joint_effects(found: TorqueResiduals, true: Array, late: Array) -> list[JointEffect]:
    """Returns the effects of faults of single joints.

    Args:
        found: the residuals.
        true: torques that a correct sensor would measure, shape (K, n), Nm or N.
        late: these torques with each of the D `DELAYS`, minus those without a delay, shape
            (D, K, n).
    """
    zero, one = np.zeros_like(found.link), np.ones_like(found.link)
    has_link = bool(np.isfinite(found.link).any())
    # Joint torque control regulates the measured torque, including the error of the sensor.
    in_motor = 0.0 if found.torque_control else 1.0
    sensor: Part = "torque sensor" if has_link else "sensor or drive"
    torque = SHARE * found.scale[:, None]
    gain = np.full((found.robot.n, 1), _GAIN)
    effects: list[JointEffect] = []
    if has_link or not found.torque_control:
        effects += [
            _gain("torque sensor", [(true, -in_motor * true)], gain),
            JointEffect("bias", sensor, torque, _same, columns=[(one, -in_motor * one)]),
            *(_delayed("torque sensor", late, (1.0, -in_motor), d) for d in _TRIED_DELAYS),
        ]
    if has_link:
        effects.append(_spring(found))
    if np.isfinite(found.motor).any():
        commanded = found.torques.commanded
        effects.append(_gain("drive", [(zero, -commanded)], gain))
        late_commands = found.torques.late_commanded
        effects += [_delayed("drive", late_commands, (0.0, -1.0), d) for d in _TRIED_DELAYS]
        if has_link:
            effects.append(JointEffect("bias", "drive", torque, _same, columns=[(zero, -one)]))
        effects += _of_motors(found, true)
    return effects


def _of_motors(found: TorqueResiduals, true: Array) -> list[JointEffect]:
    zero, signs, velocities = np.zeros_like(found.link), found.motion.signs, found.motion.velocities
    torque, ones = SHARE * found.scale[:, None], np.ones((found.robot.n, 1))
    declared = found.dynamics.motor_inertias
    effects = []
    if OF_MOTORS[0] not in found.undeclared:
        inertia = [(zero, found.motion.accelerations)]
        effects.append(JointEffect(
            "motor inertia", "drive", ones, _scaled(1.0, "kg m2"), is_constant=True,
            columns=inertia, least=_MIN_INERTIA * declared, lowest=-declared,
        ))  # fmt: skip
    if found.torque_control:
        return effects
    past = (found.times - found.times[0])[:, None] / (found.times[-1] - found.times[0])
    load = np.abs(np.nan_to_num(true)) * signs
    friction, drift = ([(zero, signs * part), (zero, velocities * part)] for part in (1.0, past))
    two = torque.repeat(2, axis=1)
    return [
        *effects,
        JointEffect("friction", "joint", two, _friction, columns=friction),
        JointEffect("friction drift", "joint", two, _friction, is_constant=True, columns=drift),
        JointEffect("load friction", "joint", 0.3 * ones, _percent, is_constant=True,
                    columns=[(zero, load)]),
        *(_saturated(found, level) for level in _TRIED_LEVELS),
    ]  # fmt: skip


def _gain(part: Part, columns: Sequence[tuple[Array, Array]], priors: Array) -> JointEffect:
    return JointEffect("gain", part, priors, _of_gain, columns=columns,
                       allowed=(-_MAX_GAIN, _MAX_GAIN))  # fmt: skip


def _delayed(part: Part, late: Array, sides: tuple[float, float], delay: float) -> JointEffect:
    # `sides` are the factors of the change in the residuals of link and motor.
    delay = float(np.clip(delay, DELAYS[0], DELAYS[-1]))
    k = min(int(np.searchsorted(DELAYS, delay, side="right")) - 1, len(DELAYS) - 2)
    share = (delay - DELAYS[k]) / (DELAYS[k + 1] - DELAYS[k])
    change = late[k] + share * (late[k + 1] - late[k])
    return JointEffect(
        "delay", part, np.full((change.shape[1], 1), _FACTOR),
        lambda factor, error, joint: Size(delay * float(factor[0]), delay * float(error[0]), "s"),
        columns=[(sides[0] * change, sides[1] * change)], allowed=_DELAY_RANGE,
        variants=lambda factor: [_delayed(part, late, sides, delay * factor)],
    )  # fmt: skip


def _saturated(found: TorqueResiduals, share: float) -> JointEffect:
    # A drive that exerts at most a share of the largest commanded torque.
    commanded = found.torques.commanded
    level = share * np.nanmax(np.abs(commanded), axis=0, initial=0.0)
    excess = commanded - np.clip(commanded, -level, level)

    def size(factor: Array, error: Array, joint: int) -> Size:
        return Size(float(level[joint]), float(error[0] * level[joint]), "Nm")

    return JointEffect(
        "saturation", "drive", np.full((found.robot.n, 1), _FACTOR),
        size, is_constant=True, columns=[(np.zeros_like(excess), excess)], allowed=_LEVEL_RANGE,
        variants=lambda _: [_saturated(found, share * step) for step in _LEVEL_STEPS],
    )  # fmt: skip


def _spring(found: TorqueResiduals) -> JointEffect:
    # A cable or spring along the joint: a torque that depends on its angle only.
    angles = found.motion.links[0]
    low, high = np.nanmin(angles, axis=0), np.nanmax(angles, axis=0)
    x = 2.0 * (angles - low) / np.maximum(high - low, 1e-9) - 1.0
    x = np.where(high - low > _MIN_RANGE, x, np.nan)
    zero = np.zeros_like(x)
    priors = SHARE * found.scale[:, None].repeat(4, axis=1)
    return JointEffect("spring", "joint", priors, _of_spring, is_constant=True,
                       columns=[(x**power, zero) for power in range(4)])  # fmt: skip


def common_effects(found: TorqueResiduals) -> list[CommonEffect]:
    """Returns the effects of faults that concern all joints."""
    effects = _of_link_side(found) if np.isfinite(found.link).any() else []
    if not np.isfinite(found.motor).any():
        return effects
    rate = -found.torques.late_commanded[0] / DELAYS[0]
    past = (found.times - found.times[0])[:, None]
    clock = np.stack([rate, rate * past], axis=-1)
    gravity = found.by_gravity @ [0.0, 0.0, -GRAVITY]
    return [
        *effects,
        CommonEffect("clock", "commands", _CLOCK, _of_clock, is_constant=True, place=COMMANDS,
                     torques=-clock, side=1, min_size=2e-5),
        CommonEffect("gravity compensation", "drive", np.array([_GAIN]), _percent, place=COMMANDS,
                     torques=gravity[..., None], side=1, min_size=2.0),
    ]  # fmt: skip


def _of_link_side(found: TorqueResiduals) -> list[CommonEffect]:
    robot, torques = found.robot, found.torques
    dynamics = found.dynamics
    effects = [
        CommonEffect("payload", "flange", _PAYLOAD, _of_payload, place=FLANGE,
                     torques=torques.payload, min_size=0.03),
        CommonEffect("masses", "links", np.array([_MASSES]), _percent, place=LINKS,
                     torques=torques.model[..., None], is_constant=True, min_size=0.5),
        CommonEffect("tilt", "base", np.full(3, _TILT), _of_tilt, place=BASE,
                     torques=found.by_gravity, is_constant=True, min_size=0.1),
        _pushed(found, robot.flange_link, robot.T_n_flange, "flange", FLANGE),
        *(_late_angles(found, k) for k in range(4, len(DELAYS), 5)),
    ]  # fmt: skip
    angles = found.motion.links[0]
    bodies, parameters = standard_torques(robot, *found.motion.links), standard_parameters(robot)
    for joint, name in enumerate(robot.names):
        by_angle = found.by_angle[:, :, [joint]]
        torque = torques.model[:, [joint], None]
        unit = "deg" if robot.types[joint] == "revolute" else "m"
        scale = 180.0 / np.pi if unit == "deg" else 1.0
        effects += [
            CommonEffect("encoder", "encoder", np.array([_ENCODER]), _scaled(scale, unit),
                         place=name, torques=-by_angle, allowed=(-_MAX_OFFSET, _MAX_OFFSET),
                         min_size=scale * 5e-4),
            CommonEffect("encoder scale", "encoder", np.array([_GAIN]), _percent,
                         place=name, is_constant=True, min_size=1.0,
                         torques=-by_angle * angles[:, [joint], None]),
            CommonEffect("elasticity", "joint", np.array([_COMPLIANCE]), _of_elasticity,
                         place=name, torques=_by_deflection(found, joint), is_constant=True,
                         allowed=(0.0, np.inf)),
        ]  # fmt: skip
        if abs(np.nanmean(np.sign(torque))) < _MAX_SIGN:
            effects.append(CommonEffect(
                "backlash", "joint", np.array([_BACKLASH]), _scaled(2.0 * scale, unit),
                place=name, torques=-by_angle * np.sign(torque), is_constant=True,
                allowed=(0.0, np.inf), min_size=scale * 2e-4,
            ))  # fmt: skip
        mass, center = float(dynamics.masses[joint + 1]), dynamics.centers[joint + 1]
        if mass > 0.0:
            own = slice(10 * joint, 10 * joint + 10)
            effects += _of_link(name, mass, bodies[:, :, own], parameters[own])
            effects.append(_pushed(found, joint + 1, frame(center), "link", name))
    return effects


def _late_angles(found: TorqueResiduals, k: int) -> CommonEffect:
    # Angles of the log that are late by about `DELAYS[k]` relative to the torques.
    delay = float(DELAYS[k])
    return CommonEffect(
        "delay", "angles", np.array([_FACTOR]), _scaled(delay, "s"), place=ALL_JOINTS,
        torques=-found.torques.late_model[k, :, :, None], is_constant=True,
        allowed=_DELAY_RANGE, min_size=0.002,
    )  # fmt: skip


def _by_deflection(found: TorqueResiduals, joint: int) -> Array:
    # The link of an elastic joint is behind its encoder by torque / stiffness.
    change = found.by_angle[:, :, joint] * found.torques.measured[:, [joint]]
    change += found.by_acceleration[:, :, joint] * found.torques.curvature[:, [joint]]
    return -change[..., None]


def _of_link(name: str, mass: float, body: Array, parameters: Array) -> list[CommonEffect]:
    # `body` are the torques (K, n, 10) per unit of the parameters of the link.
    whole = body @ parameters
    return [
        CommonEffect("link mass", "link", np.array([_MASSES]), _scaled(mass, "kg"), place=name,
                     torques=whole[..., None], is_constant=True, min_size=0.02),
        CommonEffect("link center", "link", np.full(3, _CENTER), partial(_of_center, mass),
                     place=name, torques=body[..., 1:4], is_constant=True, min_size=0.001),
    ]  # fmt: skip


def _pushed(
    found: TorqueResiduals, link: int, point: Array, part: Part, place: str
) -> CommonEffect:
    # A constant force at the origin of a frame on a link; the links exert the opposite.
    robot, angles = found.robot, found.motion.links[0]
    J = robot.kinematics.jacobian(angles, robot.base_frame, point, link)[:, :3]
    return CommonEffect("force", part, np.full(3, _FORCE), _of_force, place=place,
                        torques=-np.swapaxes(J, 1, 2), min_size=0.5)  # fmt: skip


def _same(parameters: Array, errors: Array, joint: int) -> Size:
    return Size(float(parameters[0]), float(errors[0]), "Nm")


def _scaled(factor: float, unit: str) -> SizeOf:
    return lambda parameters, errors, joint: Size(
        factor * float(parameters[0]), factor * float(errors[0]), unit
    )


_percent = _scaled(100.0, "%")


def _of_gain(parameters: Array, errors: Array, joint: int) -> Size:
    # Of two runs, the second may have the wrong sign.
    size = float(parameters[0])
    return Size(1.0 + (size if size < MIN_SIGN else -size), float(errors[0]), "")


def _friction(parameters: Array, errors: Array, joint: int) -> Size:
    values = {"viscous": float(parameters[1])}
    return Size(float(parameters[0]), float(errors[0]), "Nm", values)


def _of_spring(parameters: Array, errors: Array, joint: int) -> Size:
    x = np.linspace(-1.0, 1.0, 41)
    torque = np.polynomial.polynomial.polyval(x, parameters)
    return Size(float(torque[np.argmax(np.abs(torque))]), float(np.linalg.norm(errors)), "Nm")


def _of_payload(parameters: Array, errors: Array, joint: int) -> Size:
    values = _vector(parameters[1:4] / parameters[0])
    return Size(float(parameters[0]), float(errors[0]), "kg", values)


def _of_tilt(parameters: Array, errors: Array, joint: int) -> Size:
    gravity = np.array([0.0, 0.0, -GRAVITY]) + parameters
    angle = np.degrees(np.arctan2(np.hypot(*gravity[:2]), -gravity[2]))
    error = np.degrees(np.hypot(*errors[:2]) / GRAVITY)
    return Size(float(angle), float(error), "deg", _vector(gravity / np.linalg.norm(gravity)))


def _of_force(parameters: Array, errors: Array, joint: int) -> Size:
    size, error = float(np.linalg.norm(parameters)), float(np.linalg.norm(errors))
    return Size(size, error, "N", _vector(parameters))


def _of_center(mass: float, parameters: Array, errors: Array, joint: int) -> Size:
    shift = parameters / mass
    size, error = float(np.linalg.norm(shift)), float(np.linalg.norm(errors)) / mass
    return Size(size, error, "m", _vector(shift))


def _of_elasticity(parameters: Array, errors: Array, joint: int) -> Size:
    compliance = max(float(parameters[0]), 1e-9)
    return Size(1.0 / compliance, float(errors[0]) / compliance**2, "Nm/rad")


def _of_clock(parameters: Array, errors: Array, joint: int) -> Size:
    return Size(float(parameters[1]), float(errors[1]), "s/s", {"offset": float(parameters[0])})


def _vector(values: Array) -> dict[str, float]:
    return dict(zip("xyz", values.tolist(), strict=True))
