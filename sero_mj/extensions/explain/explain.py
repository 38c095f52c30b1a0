"""Diagnoses faults of joints from their torques: kind of difference, size, onset.

Every kind has a distinct signature in the residuals of both sides of a joint (`TorqueResiduals`),
with the links' torques x required by the model and the commanded ones u:

    torque sensor   sign, gain g     link (g - 1) x      motor -(g - 1) x
                    bias b           link b              motor -b
                    delay d          link -d dx/dt       motor  d dx/dt
                    noise            roughness of what is measured
    drive           sign, gain g                         motor -(g - 1) u
                    bias b                               motor -b
                    delay d                              motor  d du/dt
    joint           friction                             motor f sign(dq) + v dq
                    stuck            the joint stands, and more acts on it than its friction holds
    flange          payload          link: linear in ten parameters, of all joints together
    links           masses s         link s x, of all joints together, all along
    encoder         offset o         link -o dx/dq, of all joints together

Each is fitted with every begin, and then with every end. The kind and the times with the lowest
Bayesian information criterion (Schwarz 1978) are selected; the odds against the others are the
confidence. The explanation is subtracted, and the rest is searched again. Differences below 0.05 %
of a joint's torque limit are not reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...base.errors import UsageError
from ...base.frames import Array, Bools
from ...simulate.runs.run_log import RunLog
from ...study.explanation import FLANGE, LINKS, MAX_CONFIDENCE, OF_ONE_RUN, Explanation
from .explain_search import LEAST_ROWS, Search
from .torque_residuals import TorqueResiduals, torque_residuals

_APPROXIMATE = (
    "gain",
    "bias",
    "friction",
    "unexplained",
)  # what these resemble, the other way round
_STANDS, _RUNS_OFF, _RUNS_OFF_FAST = 0.4, 0.2, 0.03  # s
_ENDING, _FAST = 0.6, 0.004  # s, the end of a run, and the low-pass width there
_ONSET_TOLERANCE = 0.1  # s, apparent lead of an onset due to the slower low-pass filter
_MIN_ERROR = 0.05  # of the torque limit; minimum error of a runaway drive
_NOISE_RATIO = 2.0  # noise over that before; above, it is reported
_FINE, _MIN_NOISE = 2e-4, 1.5e-3  # of the torque limit


def explain_run(log: RunLog, robot: str, found: TorqueResiduals | None = None) -> list[Explanation]:
    """Diagnoses a robot in a run, see `explain`; raises UsageError for too little data.

    `found` are its residuals, if they are known.
    """
    found = found or torque_residuals(log, robot)
    # A run aborted by a runaway joint ends too early for the low-pass filter.
    end = log.between(float(log.times[-1]) - _ENDING, None)
    looped = found.torque_control
    try:
        ending = torque_residuals(end, robot, torque_control=looped, window=_FAST)
    except UsageError:  # too few rows
        return explain(found)
    return explain(found, ending)


def explain(found: TorqueResiduals, ending: TorqueResiduals | None = None) -> list[Explanation]:
    """Diagnoses a robot from its commanded and measured torques and its model.

    Without a model of the links (see `TorqueResiduals.has_model`) only the first two are used: then
    payloads are not detected, and biases of sensor and drive are indistinguishable.

    Args:
        found: residuals of a run.
        ending: of its last moments, with a faster low-pass filter; for runaway drives.

    Returns:
        explanations in the order of the joints, the most certain of a joint first; empty for no
        difference.
    """
    found = _by_known_links(found)
    noise = _noise(found, None)
    without = _outside_of_fits(found, noise)
    if ending is None:
        return Search(found, without, noise).explanations([*without, *noise])
    ending = _by_known_links(ending)
    noise_at_end = _noise(ending, None)
    has = {each.joint for each in without}
    fast = [each for each in _wrong_drives(ending, _RUNS_OFF_FAST) if each.joint not in has]
    fast = _unlike_fits(fast, ending, noise_at_end)
    without += _unlike_fits(fast, found, noise)
    told = Search(found, without, noise).explanations([*without, *noise])
    last = Search(ending, without, noise_at_end).explanations([])
    return _with_drives_that_run_off(told, last, found, ending)


def explain_pair(a: TorqueResiduals, b: TorqueResiduals) -> list[Explanation]:
    """Explains the difference of two runs; sizes are those of the first minus the second.

    For gains only the difference is observable: 0.2 if one sensor is correct and the other has a
    gain of 0.8. Of other faults it is known which run has them: those of the second are looked for
    in the difference the other way round, and take the place of what else would explain a joint.

    Args:
        a: of a run.
        b: of another one, at the same times.
    """
    of_a, of_b = (_outside_of_fits(each, _noise(each, None)) for each in (a, b))
    first = _explain_first(a, b, of_a, of_b)
    second = [
        replace(each, is_second=True)
        for each in _explain_first(b, a, of_b, of_a)
        if each.kind in OF_ONE_RUN and not _is_rather_of(a, b, each, first)
    ]
    told = [each for each in first if not any(_is_instead(other, each) for other in second)]
    joints = a.robot.names
    return sorted(
        [*told, *second],
        key=lambda each: joints.index(each.joint) if each.joint in joints else -1,
    )


def _is_rather_of(
    a: TorqueResiduals, b: TorqueResiduals, fault: Explanation, first: Sequence[Explanation]
) -> bool:
    """Whether a fault that is found in the second run `b` is one of the first, which has it too.

    A wrong sign explains the difference either way round; the run that its model fits worse has it.
    """
    same = [each for each in first if (each.joint, each.kind) == (fault.joint, fault.kind)]
    if not same:
        return any(each.joint == fault.joint and each.kind in OF_ONE_RUN for each in first)
    joint = a.robot.names.index(fault.joint)
    is_known = a.has_model and b.has_model and fault.part == "torque sensor"
    own, other = ((each.link if is_known else each.motor)[:, joint] for each in (a, b))
    return bool(np.nanmean(own**2) >= np.nanmean(other**2))


def _is_instead(fault: Explanation, other: Explanation) -> bool:
    """Whether a fault of the second run explains what another one of the first would."""
    if other.joint != fault.joint or other.kind not in (*_APPROXIMATE, fault.kind):
        return False
    ends = [np.inf if each.end is None else each.end for each in (fault, other)]
    begins = fault.begin <= other.begin + _ONSET_TOLERANCE
    return begins and ends[1] <= ends[0] + _ONSET_TOLERANCE


def _explain_first(
    a: TorqueResiduals,
    b: TorqueResiduals,
    mine: Sequence[Explanation],
    theirs: Sequence[Explanation],
) -> list[Explanation]:
    """Explains the difference of two runs by faults of the first, where that makes a difference.

    `mine` and `theirs` are found in `a` and `b` by themselves, outside of fits.
    """
    known = {(each.joint, each.part) for each in theirs}
    told = [each for each in mine if (each.joint, each.part) not in known]
    difference = replace(a, link=a.link - b.link, motor=a.motor - b.motor, lag=a.lag - b.lag)
    noise = _noise(a, b)
    found = Search(difference, [*mine, *theirs], noise).explanations([*told, *noise])
    return [
        replace(each, size=each.size - 1.0, is_difference=True) if each.kind == "gain" else each
        for each in found
    ]


def explain_runs(
    a: RunLog, b: RunLog, robots: tuple[str, str], offset: float = 0.0
) -> list[Explanation]:
    """Explains the difference of two runs, see `explain_pair`; `offset` (s) is added to `b`.

    Raises:
        UsageError: one of them has too little data, or no torques.
    """
    first = torque_residuals(a, robots[0])
    second = torque_residuals(b, robots[1], times=first.times - offset)
    moved = replace(second, times=first.times, noise=second.noise.later(offset))
    return explain_pair(first, moved)


def _by_known_links(found: TorqueResiduals) -> TorqueResiduals:
    """The same without residuals of links with unknown masses."""
    return found if found.has_model else replace(found, link=np.full_like(found.link, np.nan))


def _outside_of_fits(found: TorqueResiduals, noise: Sequence[Explanation]) -> list[Explanation]:
    """Explanations by other signs than fits of residuals; at most one per joint."""
    sensors = _still_sensors(found)
    signs = _unlike_fits(_wrong_drives(found, _RUNS_OFF), found, noise, sensors)
    told = sensors + signs + _still_joints(found)
    return list({each.joint: each for each in reversed(told)}.values())


def _unlike_fits(
    signs: Sequence[Explanation],
    found: TorqueResiduals,
    noise: Sequence[Explanation],
    without: Sequence[Explanation] = (),
) -> list[Explanation]:
    """Drives with a wrong sign, except those explained by something that lasts longer.

    For a short time a bias, friction or a delay may resemble twice the commanded torque.
    """
    if not signs:
        return []
    search = Search(found, without, noise)
    return [each for each in signs if not search.explains(each)]


def _with_drives_that_run_off(
    told: Sequence[Explanation],
    last: Sequence[Explanation],
    found: TorqueResiduals,
    ending: TorqueResiduals,
) -> list[Explanation]:
    """Explanations, with those of runaway joints, which have little data, from the run's end.

    `last` and `ending` are of its last moments.
    """
    names = found.robot.names
    left = np.nanmax(np.abs(ending.motor), axis=0, initial=0.0)
    runs_off = {names[k] for k in np.flatnonzero(left > _MIN_ERROR * found.scale)}
    begins: dict[str, float] = {}
    for each in told:
        begins[each.joint] = min(each.begin, begins.get(each.joint, np.inf))
    unknown = {each.joint for each in told if each.kind == "unexplained"}
    first = float(ending.times[0]) - _ONSET_TOLERANCE
    starts = first <= found.times[0]
    runs_off -= {joint for joint in begins if joint not in unknown or begins[joint] < first}
    clear = [
        replace(
            each,
            begin=min(each.begin, begins.get(each.joint, each.begin)),
            from_start=each.from_start and starts,
        )
        for each in last
        if each.joint in runs_off and each.part == "drive" and each.kind != "unexplained"
    ]
    has = {each.joint for each in clear}
    order = [*names, FLANGE, LINKS]
    return sorted([*clear, *(each for each in told if each.joint not in has)],
                  key=lambda each: order.index(each.joint))  # fmt: skip


def _wrong_drives(found: TorqueResiduals, least: float) -> list[Explanation]:
    """Drives with a wrong sign, whose joint may reach its stop before a fit has enough rows.

    The residual torque is twice the commanded one, also at rest, where friction may hold a part,
    while the torque at the links matches their motion. If the drive of a torque loop saturates, its
    torque is opposite to the requested one.
    """
    told = []
    link = found.link
    left = np.where(np.isfinite(found.motor), found.motor, found.lag)
    # While a joint reverses, its inertia is not subtracted, and at rest only its stop may hold it,
    # unless its links are known.
    has_links = np.isfinite(link).any()
    is_judged = np.isfinite(found.motor) | np.isnan(link) & (found.motion.slow | has_links)
    for joint, name in enumerate(found.robot.names):
        held, scale = 2.0 * float(found.coulomb[joint]), float(found.scale[joint])
        asked, error = 2.0 * found.torques.commanded[:, joint], left[:, joint]
        known, least_asked = is_judged[:, joint], max(5.0 * held, 0.04 * scale)
        if found.torque_control:
            asked = 2.0 * found.torques.requested[:, joint]
            error = asked / 2.0 - found.torques.delivered[:, joint]
            known, least_asked = np.isfinite(error), scale
        with np.errstate(invalid="ignore"):
            is_much = np.abs(asked) > least_asked
            is_wrong = np.abs(error - asked) < 0.15 * np.abs(asked) + held
            is_right = np.abs(link[:, joint]) < 0.15 * np.abs(asked)
        first, last = _longest(is_wrong & is_much & known)
        way = slice(max(first - LEAST_ROWS, 0), last)  # before it reached its stop
        judged = np.isfinite(link[way, joint])
        if (last - first) * found.step < least or not judged.any():
            continue
        if is_right[way][judged].mean() < 0.5:
            continue
        while first > 0 and abs(error[first - 1]) > held + 0.01 * scale:
            first -= 1
        told.append(Explanation(
            name, "sign", "drive", -1.0, "", np.nan, MAX_CONFIDENCE, float(found.times[first]),
            None if last >= len(found.times) - 1 else float(found.times[last - 1]),
            False, {}, (name,),
        ))  # fmt: skip
    return told


def _still_joints(found: TorqueResiduals) -> list[Explanation]:
    told = []
    for joint, name in enumerate(found.robot.names):
        least = max(0.025 * float(found.scale[joint]), 3.0 * float(found.coulomb[joint]))
        first, last = _longest(found.motion.slow[:, joint] & np.isfinite(found.lag[:, joint]))
        if (last - first) * found.step < _STANDS:
            continue
        lag, sensed = found.lag[first:last, joint], found.link[first:last, joint]
        sensed = sensed[np.isfinite(sensed)]
        excess = np.abs(lag) > least
        is_sensor = len(sensed) > 0 and np.sqrt(np.mean(sensed**2)) > 0.3 * np.sqrt(np.mean(lag**2))
        if np.ptp(lag) < least or excess.mean() < 0.3 or is_sensor:
            continue
        # Before, it may have been at rest without being stuck, as far as friction explains it.
        begin = first if first > 0 else int(np.argmax(excess))
        told.append(Explanation(
            name, "stuck", "joint", float(lag[np.argmax(np.abs(lag))]), _unit(found, joint),
            np.nan, MAX_CONFIDENCE, float(found.times[begin]),
            None if last >= len(found.times) - 1 else float(found.times[last - 1]),
            begin == 0, {}, (name,),
        ))  # fmt: skip
    return told


def _still_sensors(found: TorqueResiduals) -> list[Explanation]:
    told = []
    for joint, (name, (begin, end, value)) in enumerate(
        zip(found.robot.names, found.noise.held, strict=True)
    ):
        rows = (found.times >= begin) & (found.times <= end)
        expected, least = found.torques.model[rows, joint], 0.001 * found.scale[joint]
        if end - begin < _STANDS or not len(expected) or np.ptp(expected) < least:
            continue
        told.append(Explanation(
            name, "stuck", "torque sensor", value, _unit(found, joint), np.nan, MAX_CONFIDENCE,
            begin, None if end >= found.times[-1] else end, begin <= found.times[0], {}, (name,),
        ))  # fmt: skip
    return told


def _noise(a: TorqueResiduals, b: TorqueResiduals | None) -> list[Explanation]:
    told = []
    rough = np.maximum(a.noise.roughness, _FINE * a.scale)
    for joint, name in enumerate(a.robot.names):
        scale, values = float(a.scale[joint]), rough[:, joint]
        least = _MIN_NOISE * scale
        found = _rougher(np.log(values))
        begin, size = None, 0.0
        if found is not None and np.median(values[found:]) > least:
            begin, size = found, float(np.median(values[found:]))
        elif b is not None:
            other = max(float(np.median(b.noise.roughness[:, joint])), _FINE * scale)
            size = float(np.median(values))
            begin = 0 if size > max(_NOISE_RATIO * other, least) else None
        elif a.robot.n > 2:
            others = np.delete(np.median(rough, axis=0), joint)
            of_others = np.median(others), scale * np.median(others / np.delete(a.scale, joint))
            size = float(np.median(values))
            begin = 0 if size > max(3.0 * max(of_others), least) else None
        if begin is None or not np.isfinite(size):
            continue
        told.append(Explanation(
            name, "noise", "torque sensor", size, _unit(a, joint), np.nan, MAX_CONFIDENCE,
            float(a.noise.times[begin]) if begin else float(a.times[0]), None, begin == 0, {},
            (name,),
        ))  # fmt: skip
    return told


def _rougher(levels: Array) -> int | None:
    """The window at which log roughness rises by log `_NOISE_RATIO` at least; None for none."""
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
    """First row of the longest run of true values, and the row after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]])))
    if not len(edges):
        return 0, 0
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest])


def _unit(found: TorqueResiduals, joint: int) -> str:
    return "Nm" if found.robot.types[joint] == "revolute" else "N"
