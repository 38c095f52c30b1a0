"""`with_correct_angles`: the log without a fault of its angles that the search has found.

Late angles and angles with the wrong sign change both sides of all joints in a way that is not
linear, so other explanations of the same run are wrong. The search is repeated with correct angles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...simulate.runs.run_log import RunLog, event_of
from ...study.explanation import ALL_JOINTS, MAX_CONFIDENCE, Explanation
from .goodness import limited
from .torque_residuals import torque_residuals

_SEARCHED, _ACCURACY = (0.5, 2.0), 1e-3  # multiples of the first estimate, and s
_GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
_MIN_JOINTS = 3  # with delays, which late angles also cause
_MAX_SHARE = 0.5  # of the torques that late angles leave unexplained
_PART = 3.0  # s, duration of the part of the log that determines a delay
_REVERSED, _TOLERANCE = 200.0, 15.0  # error of the motion as recorded, %


def with_correct_angles(
    log: RunLog, name: str, explanations: Sequence[Explanation]
) -> tuple[Explanation, RunLog] | None:
    """Returns a fault of a robot's angles, and the log without it; None if there is no such fault.

    Args:
        name: the robot.
        explanations: explanations of the log.
    """
    for each in explanations:
        if each.kind == "encoder scale" and abs(each.size - _REVERSED) < _TOLERANCE:
            fault = replace(each, kind="sign", part="angles", size=-1.0, unit="", values={})
            signs = [-1.0 if joint == each.joint else 1.0 for joint in log.robots[name].names]
            return fault, _with_angles(log, name, log.of(name, "joint_angles") * signs)
    delays = [each for each in explanations if each.kind == "delay"]
    delays = [each for each in delays if each.part == "angles"] or delays
    joints = {joint for each in delays for joint in each.joints}
    return _late_angles(log, name, delays) if len(joints) >= _MIN_JOINTS else None


def _late_angles(
    log: RunLog, name: str, delays: Sequence[Explanation]
) -> tuple[Explanation, RunLog] | None:
    # The effect of a delay in the search is linear, which is inaccurate for long delays.
    part, first = _fastest_part(log, name), float(np.median([each.size for each in delays]))
    delay, misfit = _minimum(
        lambda delay: _misfit(_earlier(part, name, delay), name),
        (_SEARCHED[0] * first, _SEARCHED[1] * first),
    )
    share = float(np.exp(misfit - _misfit(part, name)))
    if share > _MAX_SHARE:
        return None
    fault = replace(
        delays[0], joint=ALL_JOINTS, part="angles", size=delay, error=_ACCURACY,
        joints=tuple(log.robots[name].names), confidence=limited(MAX_CONFIDENCE, share),
    )  # fmt: skip
    return fault, _earlier(log, name, fault.size)


def _minimum(
    function: Callable[[float], float], bounds: tuple[float, float]
) -> tuple[float, float]:
    # Golden-section search. Returns the place and the value of the minimum.
    low, high = bounds
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_left, at_right = function(left), function(right)
    while high - low > _ACCURACY:
        if at_left < at_right:
            high, right, at_right = right, left, at_left
            left = high - _GOLDEN * (high - low)
            at_left = function(left)
        else:
            low, left, at_left = left, right, at_right
            right = low + _GOLDEN * (high - low)
            at_right = function(right)
    return min((left, at_left), (right, at_right), key=lambda each: each[1])


def _fastest_part(log: RunLog, name: str) -> RunLog:
    begin, end = float(log.times[0]), float(log.times[-1])
    edges = np.linspace(begin, end, max(int((end - begin) / _PART), 1) + 1)
    pieces = np.split(log.of(name, "joint_angles"), np.searchsorted(log.times, edges[1:-1]))
    fastest = int(np.argmax([np.nansum(np.abs(np.diff(piece, axis=0))) for piece in pieces]))
    return log.between(*edges[fastest : fastest + 2].tolist())


def _with_angles(log: RunLog, name: str, angles: np.ndarray) -> RunLog:
    signals = {**log.signals, event_of(name, "joint_angles"): angles}
    return RunLog(log.robots, signals, log.times, log.name)


def _earlier(log: RunLog, name: str, delay: float) -> RunLog:
    angles = log.of(name, "joint_angles")
    columns = [np.interp(log.times + delay, log.times, column) for column in angles.T]
    earlier = _with_angles(log, name, np.stack(columns, axis=1))
    return earlier.between(None, float(log.times[-1]) - delay)


def _misfit(log: RunLog, name: str) -> float:
    # Mean logarithm of the residuals of all joints and sides, so that no joint decides alone.
    found = torque_residuals(log, name)
    sides = np.stack([found.link, found.motor]) / found.scale
    known = np.isfinite(sides)
    squares = np.where(known, sides, 0.0) ** 2
    means = squares.sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return 0.5 * float(np.log(means[means > 0.0]).mean())
