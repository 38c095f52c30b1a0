"""`with_next`: the experiment that confirms each explanation or distinguishes it from others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...base.frames import Array
from ...study.explanation import LOGGED, Explanation, Kind
from .link_torques import torques_by_angle
from .torque_residuals import TorqueResiduals

_ANGLE, _TRAVEL = 40.0, 100.0  # change of a pose, deg or mm
_SHARE = 0.5  # maximum change of a pose as a share of the joint's range
_LONG = 300.0  # s, minimum duration for slow changes
_FASTER = 2.0  # factor of velocities
_MIN_TORQUE = 1e-3  # minimum change of a torque limit share by a change of the pose

# The fields are explained in `_Fields`.
_OF_SENSOR = "hold {joint} at rest without contact in two poses: {pose}"
_OF_LOAD = "hold still in several poses: {pose}, and rotate the flange"
_LEVELS = "hold different torques at rest ({pose}), then move {joint} slowly without load"
_CONSTANT = "move {joint} at constant velocity in both directions, at {slow} and {fast}"
_OF_LINK = "move all joints through large angles, slowly and then fast, with and without the load"
_NEXT: Mapping[Kind, str] = {
    "sign": "check the sign and the wiring, then " + _LEVELS,
    "gain": _LEVELS,
    "bias": _OF_SENSOR,
    "delay": "repeat the motion with {joint} faster, up to {fast}",
    "noise": "record {joint} at rest, with the drives on and off",
    "friction": _CONSTANT + ", then reverse fast",
    "payload": _OF_LOAD + ". Repeat without a load",
    "masses": _OF_LINK,
    "encoder": "move {joint} slowly through its whole range, and check its zero position",
    "encoder scale": "move {joint} slowly through its whole range, and check both end positions",
    "stuck": "release the brake of {joint}, and move it slowly by {shift} in both directions",
    "tilt": "hold still in several poses far from upright: {pose}; measure the tilt of the base",
    "link mass": _OF_LINK,
    "link center": _OF_LINK,
    "elasticity": "hold {joint} still under different loads, and measure the angle of the link",
    "backlash": "move {joint} slowly through the pose in which its torque changes its sign",
    "spring": "move {joint} slowly through its whole range in both directions",
    "force": "repeat the motion without contact. To exclude a payload, rotate the flange",
    "motor inertia": _CONSTANT + ", then reverse fast",
    "friction drift": "repeat the same motion for at least {long}, and record temperatures",
    "load friction": "repeat the same motion with another load at the flange",
    "saturation": "command {joint} more than this torque while it moves slowly",
    "clock": "record the same motion for at least {long}, with time stamps of the sender",
    "gravity compensation": "hold still in several poses: {pose}; check the settings of the drives",
    "swap": "move one joint after the other, and check its column",
    "order": "move one joint after the other, and check its column",
    "scale": "move {joint} by a known angle, and check its unit",
    "unexplained": "repeat the motion without contact, then move one joint after the other",
}  # fmt: skip
_OF_SENSORS: Mapping[Kind, str] = {
    "stuck": "check the connection of the torque sensor, then repeat the motion",
}
_OF_LOGGED: Mapping[Kind, str] = {
    "sign": "move {joint} alone in its positive direction, and check the signs of its columns",
    "delay": "check the time stamps of the signals, then move faster, up to {fast}",
}


@dataclass(frozen=True)
class _Fields:
    """Fields of the texts.

    Attributes:
        joint: name of the joint that is concerned most.
        pose: which joint to move by which angle to change the torque of `joint`.
        shift: a change of the angle of `joint` within its range.
        slow: the usual velocity of `joint` in the run.
        fast: a velocity of `joint` above that of the run.
        long: duration for slow changes.
    """

    joint: str
    pose: str
    shift: str
    slow: str
    fast: str
    long: str


def with_next(explanations: Iterable[Explanation], found: TorqueResiduals) -> list[Explanation]:
    """Returns explanations with the experiment that decides about each of them."""
    return [replace(each, next=_text(each, found)) for each in explanations]


def _text(explanation: Explanation, found: TorqueResiduals) -> str:
    kind = explanation.kind
    text = _NEXT[kind]
    if explanation.part in LOGGED:
        text = _OF_LOGGED.get(kind, text)
    elif explanation.part == "torque sensor":
        text = _OF_SENSORS.get(kind, text)
    return text.format(**vars(_fields(explanation, found)))


def _fields(explanation: Explanation, found: TorqueResiduals) -> _Fields:
    names = found.robot.names
    concerned = [explanation.joint, *([explanation.evidence.joint] if explanation.evidence else []),
                 *explanation.joints]  # fmt: skip
    joint = next((names.index(each) for each in concerned if each in names), 0)
    mover = _mover(found, joint)
    move = f"move {names[mover]} by at least {_shift(found, mover)}"
    slow, fast = _velocities(found, joint)
    return _Fields(names[joint], move, _shift(found, joint), slow, fast, f"{_LONG / 60.0:.0f} min")


def _mover(found: TorqueResiduals, joint: int) -> int:
    # The joint whose angle changes the gravity torque of another joint most.
    known = np.isfinite(found.motion.links[0]).all(axis=1)
    if not np.isfinite(found.link).any() or not known.any():
        return joint
    pose = found.motion.links[0][known].mean(axis=0, keepdims=True)
    still = np.zeros_like(pose)
    changes = np.abs(torques_by_angle(found.robot, pose, still, still)[0, joint])
    shares = np.array([_amount(found, k) for k in range(found.robot.n)]) * changes
    best = int(np.argmax(shares))
    return best if shares[best] > _MIN_TORQUE * found.scale[joint] else joint


def _amount(found: TorqueResiduals, joint: int) -> float:
    # A change of the joint's value within its range, rad or m.
    low, high = found.robot.plausible_limits[joint]
    wanted = np.radians(_ANGLE) if _is_revolute(found, joint) else 1e-3 * _TRAVEL
    return float(min(wanted, _SHARE * (high - low))) if np.isfinite(high - low) else float(wanted)


def _shift(found: TorqueResiduals, joint: int) -> str:
    amount = _amount(found, joint)
    if _is_revolute(found, joint):
        return f"{np.degrees(amount):.0f} deg"
    return f"{1e3 * amount:.0f} mm"


def _velocities(found: TorqueResiduals, joint: int) -> tuple[str, str]:
    # A usual velocity of a joint, and a faster one than in the run.
    speeds = np.abs(found.motion.velocities[:, joint])
    known: Array = speeds[np.isfinite(speeds)]
    is_revolute = _is_revolute(found, joint)
    least = np.radians(5.0) if is_revolute else 0.01
    highest = max(float(known.max(initial=0.0)), least)
    slow, fast = 0.5 * highest, _FASTER * highest
    factor, unit = (180.0 / np.pi, "deg/s") if is_revolute else (1e3, "mm/s")
    return f"{factor * slow:.2g} {unit}", f"{factor * fast:.2g} {unit}"


def _is_revolute(found: TorqueResiduals, joint: int) -> bool:
    return found.robot.types[joint] == "revolute"
