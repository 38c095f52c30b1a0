"""Faults that are detected directly, without a fit: wrong signs, frozen values, and noise.

A fit needs enough data with the fault. A drive with a wrong sign may end the run before, a stuck
joint or sensor has no effect that is linear in parameters, and noise has no mean.
"""

from __future__ import annotations

import numpy as np

from ...base.frames import Array, Bools
from ...study.evidence import Evidence
from ...study.explanation import MAX_CONFIDENCE, Explanation
from .evidence_rows import evidence_at, torque_unit
from .explain_search import MIN_ROWS
from .torque_residuals import TorqueResiduals

_MIN_STUCK = 0.4  # s, minimum duration
# Duration in s below which other causes have the same effect, and the highest confidence.
_SHORT, _OF_SHORT = 1.0, 0.85
_MOVING_QUANTILE = 0.95  # of the torques with which the drives overcame friction
_NOISE_RATIO = 2.0  # minimum increase of reported noise
_FINE, _MIN_NOISE = 2e-4, 1.5e-3  # shares of the torque limit


def wrong_drives(found: TorqueResiduals, min_duration: float) -> list[Explanation]:
    """Returns drives with a wrong sign, whose joint may reach its stop before a fit is possible.

    The residual is twice the commanded torque, except for a part that friction may hold at rest,
    while the link torques match the motion. In a torque loop, a saturated drive exerts the opposite
    of the requested torque.
    """
    explanations = []
    link = found.link
    left = np.where(np.isfinite(found.motor), found.motor, found.lag)
    # While a joint reverses, its inertia is not subtracted. At rest, an end stop may hold it if the
    # link torques are unknown.
    has_links = np.isfinite(link).any()
    is_judged = np.isfinite(found.motor) | np.isnan(link) & (found.motion.slow | has_links)
    for joint, name in enumerate(found.robot.names):
        held, scale = 2.0 * float(found.coulomb[joint]), float(found.scale[joint])
        twice, error = 2.0 * found.torques.commanded[:, joint], left[:, joint]
        known, min_twice = is_judged[:, joint], max(5.0 * held, 0.04 * scale)
        if found.torque_control:
            twice = 2.0 * found.torques.requested[:, joint]
            error = twice / 2.0 - found.torques.delivered[:, joint]
            known, min_twice = np.isfinite(error), scale
        with np.errstate(invalid="ignore"):
            is_large = np.abs(twice) > min_twice
            is_wrong = np.abs(error - twice) < 0.15 * np.abs(twice) + held
            is_right = np.abs(link[:, joint]) < 0.15 * np.abs(twice)
        first, last = _longest(is_wrong & is_large & known)
        rows = slice(max(first - MIN_ROWS, 0), last)  # before the joint reaches its stop
        judged = np.isfinite(link[rows, joint])
        if (last - first) * found.step < min_duration or not judged.any():
            continue
        if is_right[rows][judged].mean() < 0.5:
            continue
        while first > 0 and abs(error[first - 1]) > held + 0.01 * scale:
            first -= 1
        evidence = evidence_at(
            found, joint, 1, error, _less(error, twice, first, last), "sign", "drive"
        )
        is_short = (last - first) * found.step < _SHORT and last < len(found.times) - 1
        confidence = _OF_SHORT if is_short else MAX_CONFIDENCE
        explanations.append(Explanation(
            name, "sign", "drive", -1.0, "", np.nan, confidence, float(found.times[first]),
            None if last >= len(found.times) - 1 else float(found.times[last - 1]),
            False, {}, (name,), evidence=evidence,
        ))  # fmt: skip
    return explanations


def stuck_joints(found: TorqueResiduals) -> list[Explanation]:
    """Returns joints that do not move although the torque exceeds their friction."""
    explanations = []
    coulomb = found.coulomb
    if "coulomb_friction" in found.undeclared:  # no more than the drives needed while moving
        moving = np.where(found.motion.slow, 0.0, np.abs(found.lag))
        coulomb = np.quantile(np.nan_to_num(moving), _MOVING_QUANTILE, axis=0)
    for joint, name in enumerate(found.robot.names):
        least = max(0.025 * float(found.scale[joint]), 3.0 * float(coulomb[joint]))
        first, last = _longest(found.motion.slow[:, joint] & np.isfinite(found.lag[:, joint]))
        if (last - first) * found.step < _MIN_STUCK:
            continue
        lag, sensed = found.lag[first:last, joint], found.link[first:last, joint]
        sensed = sensed[np.isfinite(sensed)]
        excess = np.abs(lag) > least
        is_sensor = len(sensed) > 0 and np.sqrt(np.mean(sensed**2)) > 0.3 * np.sqrt(np.mean(lag**2))
        if np.ptp(lag) < least or excess.mean() < 0.3 or is_sensor:
            continue
        # Before, friction may explain that the joint is at rest.
        begin = first if first > 0 else int(np.argmax(excess))
        before = found.lag[:, joint]  # what holds the joint exerts all of it
        evidence = evidence_at(
            found, joint, 1, before, _less(before, before, begin, last), "stuck", "joint"
        )
        is_short = (last - begin) * found.step < _SHORT
        confidence = _OF_SHORT if is_short else MAX_CONFIDENCE
        explanations.append(Explanation(
            name, "stuck", "joint", float(lag[np.argmax(np.abs(lag))]), torque_unit(found, joint),
            np.nan, confidence, float(found.times[begin]),
            None if last >= len(found.times) - 1 else float(found.times[last - 1]),
            begin == 0, {}, (name,), evidence=evidence,
        ))  # fmt: skip
    return explanations


def stuck_sensors(found: TorqueResiduals) -> list[Explanation]:
    """Returns torque sensors with a constant value while the model torque changes."""
    explanations = []
    for joint, (name, (begin, end, value)) in enumerate(
        zip(found.robot.names, found.noise.held, strict=True)
    ):
        rows = (found.times >= begin) & (found.times <= end)
        expected, least = found.torques.model[rows, joint], 0.001 * found.scale[joint]
        if end - begin < _MIN_STUCK or not len(expected) or np.ptp(expected) < least:
            continue
        model = found.torques.model[:, joint]
        before, edges = found.torques.measured[:, joint] - model, np.flatnonzero(rows)[[0, -1]]
        after = _less(before, value - model, int(edges[0]), int(edges[1]) + 1)
        explanations.append(Explanation(
            name, "stuck", "torque sensor", value, torque_unit(found, joint), np.nan,
            MAX_CONFIDENCE, begin, None if end >= found.times[-1] else end,
            begin <= found.times[0], {}, (name,),
            evidence=evidence_at(found, joint, 0, before, after, "stuck", "torque sensor"),
        ))  # fmt: skip
    return explanations


def noisy_sensors(a: TorqueResiduals, b: TorqueResiduals | None) -> list[Explanation]:
    """Returns torque sensors that become noisy, or are noisier than those of `b` or others."""
    explanations = []
    rough = np.maximum(a.noise.roughness, _FINE * a.scale)
    for joint, name in enumerate(a.robot.names):
        scale, values = float(a.scale[joint]), rough[:, joint]
        least = _MIN_NOISE * scale
        found = _rougher(np.log(values))
        begin, size, normal = None, 0.0, 0.0
        if found is not None and np.median(values[found:]) > least:
            begin, size = found, float(np.median(values[found:]))
            normal = float(np.median(values[:found]))
        elif b is not None:
            other = max(float(np.median(b.noise.roughness[:, joint])), _FINE * scale)
            size, normal = float(np.median(values)), other
            begin = 0 if size > max(_NOISE_RATIO * other, least) else None
        elif a.robot.n > 2:
            others = np.delete(np.median(rough, axis=0), joint)
            of_others = np.median(others), scale * np.median(others / np.delete(a.scale, joint))
            size, normal = float(np.median(values)), float(of_others[1])
            begin = 0 if size > max(3.0 * max(of_others), least) else None
        if begin is None or not np.isfinite(size):
            continue
        after = _less(values, np.full_like(values, size - normal), begin, len(values))
        evidence = Evidence(name, "link", a.noise.times, values, after, "time", "s", a.noise.times,
                            torque_unit(a, joint))  # fmt: skip
        explanations.append(Explanation(
            name, "noise", "torque sensor", size, torque_unit(a, joint), np.nan, MAX_CONFIDENCE,
            float(a.noise.times[begin]) if begin else float(a.times[0]), None, begin == 0, {},
            (name,), evidence=evidence,
        ))  # fmt: skip
    return explanations


def _less(values: Array, effect: Array, first: int, last: int) -> Array:
    # Values (K,) without an effect (K,) in the rows from `first` to before `last`.
    result = values.copy()
    result[first:last] -= effect[first:last]
    return result


def _rougher(levels: Array) -> int | None:
    """Returns the window at which log roughness rises by at least log `_NOISE_RATIO`, if any."""
    count, least = len(levels), 3
    if count < 2 * least or not np.isfinite(levels).all():
        return None
    splits = np.arange(least, count - least + 1)
    errors = [((levels[:k] - levels[:k].mean()) ** 2).sum()
              + ((levels[k:] - levels[k:].mean()) ** 2).sum() for k in splits]  # fmt: skip
    k = int(splits[int(np.argmin(errors))])
    before, after = levels[:k], levels[k:]
    spread = np.sqrt(min(errors) / max(count - 2, 1)) + 0.05
    jump = after.mean() - before.mean()
    sure = jump > 5.0 * spread * np.sqrt(1.0 / k + 1.0 / (count - k))
    return k if jump > np.log(_NOISE_RATIO) and jump > 2.0 * spread and sure else None


def _longest(rows: Bools) -> tuple[int, int]:
    """Returns the first row of the longest run of true values, and the row after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]])))
    if not len(edges):
        return 0, 0
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest])
