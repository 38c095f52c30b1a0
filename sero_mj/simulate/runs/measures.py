"""Measures of a run over time: errors, velocities, torques, forces, and poses of free bodies."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ...base.frames import Array
from ...robots.declared.mounts import base_frames, carriers
from .run_log import RunLog, event_of

STEP_LATENESS = "step_lateness"  # log signal: delay at the beginning of a step, s


def _actual_signal(log: RunLog, robot: str, signal: str) -> str:
    known = f"actual_{signal}"
    return known if log.has(robot, known) else f"joint_{signal}"


def _actual(log: RunLog, robot: str, signal: str) -> Array:
    return log.of(robot, _actual_signal(log, robot, signal))


def _position_error(log: RunLog, robot: str) -> Array:
    return np.asarray(log.of(robot, "target_angles") - _actual(log, robot, "angles"))


def _velocity_error(log: RunLog, robot: str) -> Array:
    return np.asarray(log.of(robot, "target_velocities") - _actual(log, robot, "velocities"))


def _flange(log: RunLog, robot: str, signal: str | None = None) -> Array:
    """Returns T_world_flange, (T, 4, 4), for the angles in a signal (default: actual angles).

    The robots that carry this robot are in their actual poses.
    """
    signal = signal or _actual_signal(log, robot, "angles")
    if (robot, signal) not in log.derived:
        declared = log.robots[robot]
        below = {name: _actual(log, name, "angles") for name in carriers(log.robots, robot)}
        logged = {name: event_of(name, "base_frame") for name in (robot, *below)}
        placed = {name: log.signals[e] for name, e in logged.items() if e in log.signals}
        base = base_frames(log.robots, below, placed)[robot]
        poses = declared.fwd_kin_base_to_flange(log.of(robot, signal))
        log.derived[robot, signal] = np.asarray(base @ poses)
    return log.derived[robot, signal]


def _poses(log: RunLog, robot: str) -> tuple[Array, Array]:
    event = event_of(robot, "target_pose")
    target = log.signals[event] if event in log.signals else _flange(log, robot, "target_angles")
    return target, _flange(log, robot)


def _flange_error(log: RunLog, robot: str) -> Array:
    target, actual = _poses(log, robot)
    return np.asarray(np.linalg.norm(target[:, :3, 3] - actual[:, :3, 3], axis=1)[:, None])


def _orientation_error(log: RunLog, robot: str) -> Array:
    target, actual = _poses(log, robot)
    turn = np.einsum("tji,tjk->tik", target[:, :3, :3], actual[:, :3, :3])
    sin = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0],
         turn[:, 1, 0] - turn[:, 0, 1]], axis=1,
    )  # fmt: skip
    cos = 0.5 * (np.trace(turn, axis1=1, axis2=2) - 1.0)
    return np.asarray(np.arctan2(np.linalg.norm(sin, axis=1), cos)[:, None])


def _flange_travel(log: RunLog, robot: str) -> Array:
    at = _flange(log, robot)[:, :3, 3]
    return np.asarray(np.linalg.norm(at - at[0], axis=1)[:, None])


def _flange_coordinate(axis: int) -> Callable[[RunLog, str], Array]:
    def measure(log: RunLog, robot: str) -> Array:
        return _flange(log, robot)[:, axis, 3:]

    return measure


def _torque_share(log: RunLog, robot: str) -> Array:
    return np.asarray(log.of(robot, "commanded_torques") / log.torque_limits(robot))


def _contact_force(log: RunLog, robot: str) -> Array:
    return np.asarray(np.linalg.norm(log.signals[event_of(robot, "contact_force")], axis=-1))[
        :, None
    ]


def _drift(log: RunLog, robot: str) -> Array:
    angles = _actual(log, robot, "angles")
    return np.asarray(angles - angles[0])


def _free_pose(log: RunLog, name: str) -> Array:
    """Returns T_world_base of a free base, or T_world_object of a free object, (T, 4, 4)."""
    return log.signals[event_of(name, "base_frame" if name in log.robots else "frame")]


def _height(log: RunLog, name: str) -> Array:
    return _free_pose(log, name)[:, 2, 3:]


def _displacement(log: RunLog, name: str) -> Array:
    at = _free_pose(log, name)[:, :3, 3]
    return np.asarray(np.linalg.norm(at - at[0], axis=1)[:, None])


def _step_lateness(log: RunLog, name: str) -> Array:
    event = event_of(name, STEP_LATENESS)  # only logged in real time
    return log.signals[event] if event in log.signals else np.zeros((len(log.times), 1))


def _real_time_factor(log: RunLog, name: str) -> Array:
    """Returns simulated time divided by elapsed time up to each row; 1 in the first row."""
    late, times = _step_lateness(log, name), log.times[:, None]
    return np.asarray(np.divide(times, times + late, out=np.ones_like(times), where=times > 0.0))


def _tilt(log: RunLog, name: str) -> Array:
    up = _free_pose(log, name)[:, :3, 2]
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(up, up[0]), axis=1), up @ up[0])[:, None])


# Unit of each measure, and its function, which returns shape (T, n) for joints, or (T, 1).
MEASURES: Mapping[str, tuple[str, Callable[[RunLog, str], Array]]] = {
    "position_error": ("rad", _position_error),
    "velocity_error": ("rad/s", _velocity_error),
    "flange_error": ("m", _flange_error),
    "orientation_error": ("rad", _orientation_error),
    "flange_travel": ("m", _flange_travel),
    "flange_x": ("m", _flange_coordinate(0)),
    "flange_y": ("m", _flange_coordinate(1)),
    "flange_z": ("m", _flange_coordinate(2)),
    "velocity": ("rad/s", lambda log, robot: _actual(log, robot, "velocities")),
    "angle": ("rad", lambda log, robot: _actual(log, robot, "angles")),
    "drift": ("rad", _drift),
    "torque": ("Nm", lambda log, robot: log.of(robot, "torques")),
    "commanded_torque": ("Nm", lambda log, robot: log.of(robot, "commanded_torques")),
    "torque_error": ("Nm", lambda log, robot: log.torque_error(robot)),
    "torque_share": ("of the limit", _torque_share),
    "external_torque": ("Nm", lambda log, robot: log.of(robot, "external_torques")),
    "saturated": ("share of the time", lambda log, robot: log.of(robot, "saturated")),
    "contact_force": ("N", _contact_force),
    "height": ("m", _height),
    "displacement": ("m", _displacement),
    "tilt": ("rad", _tilt),
    "step_lateness": ("s", _step_lateness),
    "real_time_factor": ("s/s", _real_time_factor),
}
# Measures with a value per joint; others have one value per robot or object.
PER_JOINT = (
    "position_error", "velocity_error", "velocity", "angle", "drift", "torque", "commanded_torque",
    "torque_error", "torque_share", "external_torque", "saturated",
)  # fmt: skip
# Measures that can be negative.
SIGNED = (
    *(name for name in PER_JOINT if name != "saturated"), "height", "flange_x", "flange_y",
    "flange_z",
)  # fmt: skip
# Measures of free bases and free objects.
OF_FREE = ("height", "displacement", "tilt")
# Measures that require a target.
NEED_TARGET = ("position_error", "velocity_error", "flange_error", "orientation_error")
# Measures that require a controller that runs in real time.
NEED_REAL_TIME = ("step_lateness", "real_time_factor")
