"""Diagnoses the kind, size and start time of joint faults from torques.

Each kind has a distinct signature in the residuals of the link and motor side of a joint (see
`TorqueResiduals`). With the link torque x of the model and the commanded torque u:

    torque sensor   sign, gain g     link (g - 1) x      motor -(g - 1) x
                    bias b           link b              motor -b
                    delay d          link -d dx/dt       motor  d dx/dt
                    noise            roughness of the measured torque
    drive           sign, gain g                         motor -(g - 1) u
                    bias b                               motor -b
                    delay d                              motor  d du/dt
    joint           friction                             motor f sign(dq) + v dq
                    stuck            no motion although the torque exceeds the friction
    flange          payload          link: linear in ten parameters, all joints together
    links           masses s         link s x, all joints together, during the whole run
    encoder         offset o         link -o dx/dq, all joints together
                    scale k          link -k q dx/dq, all joints together
    joint           friction drift                       motor (f sign(dq) + v dq) (t - t0)
                    load friction f                      motor f |x| sign(dq)
                    spring           link: polynomial of q
                    elasticity k     link -(x dx/dq + M d2x/dt2) / k, all joints together
                    backlash b       link -b/2 sign(x) dx/dq, all joints together
    drive           motor inertia B                      motor B ddq
                    saturation L                         motor u - clip(u, L)
    one link        mass, center     link: linear in mass or first moment, all joints together
    base            tilt             link: linear in gravity, all joints together
    flange, link    force F          link -J^T F, all joints together
    commands        clock d, r                           motor -(d + r t) du/dt, all joints
                    gravity c                            motor c g(q), all joints

Faults of the log itself are searched first (see `log_faults`). Then each kind is fitted for all
begin and end times. The kind and the times with the lowest Bayesian information criterion (Schwarz
1978) are selected; the confidence results from the odds against the other kinds, and from the share
of torque that remains unexplained (see `goodness`). The explanation is subtracted from the
residuals, and the search continues. Differences below 0.05 % of a joint's torque limit are not
reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...base.errors import UsageError
from ...simulate.runs.run_log import RunLog
from ...study.align import Pair
from ...study.explanation import (
    ALL_JOINTS,
    OF_ONE_RUN,
    Explainer,
    Explanation,
    Parameter,
    Part,
    by_place,
)
from .corrected_angles import with_correct_angles
from .direct_faults import noisy_sensors, stuck_joints, stuck_sensors, wrong_drives
from .evidence_rows import merged, rows_line, with_log_evidence
from .explain_search import Search
from .identify import identify, parameters
from .log_faults import log_faults
from .next_motion import with_next
from .torque_residuals import TorqueResiduals, pair_with_model, torque_residuals
from .usable_rows import usable

_OF_OWN = 0.1  # share of the squared residuals of a run that a fault of this run leaves at most
# A fault of the second run resembles one of these faults of the first run with opposite sign.
_APPROXIMATE = ("gain", "bias", "friction", "unexplained")
_MIN_WRONG, _MIN_WRONG_FAST = 0.2, 0.03  # s, minimum durations
_ENDING, _FAST = 0.6, 0.004  # s, end of a run, and the width of its low-pass filter
_ONSET_TOLERANCE = 0.1  # s, apparent lead of an onset due to the slower low-pass filter
_MIN_ERROR = 0.05  # share of the torque limit; minimum error of a runaway drive
_FAST_CONFIDENCE = 0.85  # of a drive that runs away, because its data is short
# Number of joints that are rarely faulty in the same way for different reasons, the highest
# confidence of such faults, and the relative spread of equal delays.
_MANY, _OF_MANY, _EQUAL = 3, 0.8, 0.1
# Kinds that are uncertain if they end before the run and the joint has unexplained torques, too.
_OF_A_WHILE, _BESIDE_UNEXPLAINED = ("gain", "bias", "delay", "friction"), 0.8
_OF_ONE_JOINT = ("gain", "bias", "delay", "friction drift", "spring")


def explain_run(log: RunLog, robot: str, found: TorqueResiduals | None = None) -> list[Explanation]:
    """Diagnoses a robot in a run, see `explain`; raises UsageError for too little data.

    `found` contains the residuals of the robot if they are already known; `log` is `usable` then.
    """
    if found is None:
        log, _ = usable(log, robot)
        found = torque_residuals(log, robot)
    faults, log = log_faults(log, robot, found)
    if faults:
        recorded, found = found, replace(torque_residuals(log, robot), no_model=found.no_model)
        faults = with_log_evidence(faults, _by_known_links(recorded), found)
    explained = _explain_correct(log, robot, found)
    if (correct := with_correct_angles(log, robot, explained)) is not None:
        fault, log = correct
        found = replace(torque_residuals(log, robot), no_model=found.no_model)
        again = _explain_correct(log, robot, found)
        explained = [fault, *(each for each in again if each.part != "angles")]
    explained = _beside_unexplained(_of_many_joints(explained, found.robot.names))
    explanations = [*faults, *explained]
    return with_next(explanations, _by_known_links(found))


def _explain_correct(log: RunLog, robot: str, found: TorqueResiduals) -> list[Explanation]:
    # A run that a runaway joint aborts ends too early for the normal low-pass filter.
    end = log.between(float(log.times[-1]) - _ENDING, None)
    looped = found.torque_control
    try:
        ending = torque_residuals(end, robot, torque_control=looped, window=_FAST)
    except UsageError:  # too few rows
        return explain(found)
    return explain(found, ending)


def explain(found: TorqueResiduals, ending: TorqueResiduals | None = None) -> list[Explanation]:
    """Diagnoses a robot from its commanded and measured torques and its model.

    Without a model of the links (see `TorqueResiduals.has_model`), payloads are not detected, and
    biases of sensor and drive are indistinguishable. `ending` contains the residuals at
    the end of the run with a faster low-pass filter, for runaway drives.

    Returns the explanations joint by joint, in descending order of confidence.
    """
    found = _by_known_links(found)
    noise = noisy_sensors(found, None)
    without = _outside_of_fits(found, noise)
    if ending is None:
        return Search(found, without, noise).explanations([*without, *noise])
    ending = _by_known_links(ending)
    noise_at_end = noisy_sensors(ending, None)
    has = {each.joint for each in without}
    fast = [each for each in wrong_drives(ending, _MIN_WRONG_FAST) if each.joint not in has]
    fast = [replace(each, confidence=_FAST_CONFIDENCE)
            for each in _unlike_fits(fast, ending, noise_at_end)]  # fmt: skip
    without += _unlike_fits(fast, found, noise)
    explanations = Search(found, without, noise).explanations([*without, *noise])
    last = Search(ending, without, noise_at_end).explanations([])
    return _with_runaway_drives(explanations, last, found, ending)


def explain_pair(a: TorqueResiduals, b: TorqueResiduals) -> list[Explanation]:
    """Explains the difference of two runs at the same times; sizes are first run minus second run.

    The faults in `OF_ONE_RUN` are attributed to one run. Other faults are attributed to a run if
    they explain its own residuals, but not those of the other run. Otherwise, only the difference
    is known: it is 0.2 if the gains of two sensors are 0.8 and 0.6. Faults of the second run are
    searched in the negative difference, and replace approximate explanations.
    """
    of_a, of_b = (_outside_of_fits(each, noisy_sensors(each, None)) for each in (a, b))
    first, second = _explain_first(a, b, of_a, of_b), _explain_first(b, a, of_b, of_a)
    first, of_second = _by_run(a, b, first, second)
    second = of_second + [
        replace(each, is_second=True)
        for each in second
        if each.kind in OF_ONE_RUN and not _is_of_first(a, b, each, first)
    ]
    remaining = [each for each in first if not any(_replaces(other, each) for other in second)]
    return _of_many_joints([*remaining, *second], a.robot.names)


def _by_run(
    a: TorqueResiduals,
    b: TorqueResiduals,
    first: Sequence[Explanation],
    second: Sequence[Explanation],
) -> tuple[list[Explanation], list[Explanation]]:
    # Separates the faults of run `a` and of both from those of run `b`. `first` explains the
    # difference a - b, and `second` explains b - a in the motion of `b`.
    of_second = [
        replace(_of_one_run(each), is_second=True) for each in second if _explains_own(b, each)
    ]
    same = {(each.joint, each.kind, each.part) for each in of_second}
    known = {joint for each in of_second for joint in each.joints}
    of_first = [
        _of_one_run(each) if _explains_own(a, each) else each
        for each in first
        if (each.joint, each.kind, each.part) not in same
        and (each.kind != "unexplained" or each.joint not in known)
    ]
    return of_first, of_second


def _explains_own(run: TorqueResiduals, fault: Explanation) -> bool:
    # Whether a fault of the difference of two runs explains the residuals of one of them.
    evidence = fault.evidence
    if evidence is None or fault.kind in (*OF_ONE_RUN, "unexplained"):
        return False
    if not run.has_model if evidence.side == "link" else run.undeclared:
        return False
    own = (run.link if evidence.side == "link" else run.motor)[
        :, run.robot.names.index(evidence.joint)
    ]
    effect = evidence.before - evidence.after
    before, after = np.nansum(own**2), np.nansum((own - effect) ** 2)
    return bool(after < _OF_OWN * before)


def _of_one_run(fault: Explanation) -> Explanation:
    # The other run is correct, so that the gain is known.
    if not fault.is_difference:
        return fault
    return replace(fault, size=1.0 + fault.size, is_difference=False)


def _is_of_first(
    a: TorqueResiduals, b: TorqueResiduals, fault: Explanation, first: Sequence[Explanation]
) -> bool:
    # A wrong sign of either run explains the difference. The run with the larger residuals has it.
    same = [each for each in first if (each.joint, each.kind) == (fault.joint, fault.kind)]
    if not same:
        return any(each.joint == fault.joint and each.kind in OF_ONE_RUN for each in first)
    joint = a.robot.names.index(fault.joint)
    is_known = a.has_model and b.has_model and fault.part == "torque sensor"
    own, other = ((each.link if is_known else each.motor)[:, joint] for each in (a, b))
    return bool(np.nanmean(own**2) >= np.nanmean(other**2))


def _replaces(fault: Explanation, other: Explanation) -> bool:
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
    # `mine` and `theirs` were found in each run alone. Faults that both have make no difference.
    known = {(each.joint, each.part) for each in theirs}
    own = [each for each in mine if (each.joint, each.part) not in known]
    difference = _difference(a, b)
    noise = noisy_sensors(a, b)
    found = Search(difference, [*mine, *theirs], noise).explanations([*own, *noise])
    return [
        replace(each, size=each.size - 1.0, is_difference=True) if each.kind == "gain" else each
        for each in found
    ]


def explain_runs(
    a: RunLog, b: RunLog, robots: tuple[str, str], offset: float = 0.0
) -> list[Explanation]:
    """Explains the difference of two runs; `offset` (s) is added to the times of `b`.

    See `explain_pair`.

    Raises:
        UsageError: a run has too little data or no torques.
    """
    (a, _), (b, _) = usable(a, robots[0]), usable(b, robots[1])
    faults, first, second = _both(a, b, robots, offset)
    return with_next([*faults, *explain_pair(first, second)], first)


def _both(
    a: RunLog, b: RunLog, robots: tuple[str, str], offset: float
) -> tuple[list[Explanation], TorqueResiduals, TorqueResiduals]:
    # Faults of both usable logs, and the residuals of the corrected logs at the same times.
    first, second = torque_residuals(a, robots[0]), torque_residuals(b, robots[1])
    faults, a = log_faults(a, robots[0], first)
    faults_of_b, b = log_faults(b, robots[1], second)
    if faults:
        recorded, first = first, torque_residuals(a, robots[0])
        faults = with_log_evidence(faults, recorded, first)
    if faults_of_b:
        faults_of_b = with_log_evidence(faults_of_b, second, torque_residuals(b, robots[1]))
    second = torque_residuals(b, robots[1], times=first.times - offset)
    moved = replace(second, times=first.times, noise=second.noise.later(offset))
    of_b = [replace(each, begin=each.begin + offset, is_second=True) for each in faults_of_b]
    return [*faults, *of_b], first, moved


def _difference(a: TorqueResiduals, b: TorqueResiduals) -> TorqueResiduals:
    return replace(a, link=a.link - b.link, motor=a.motor - b.motor, lag=a.lag - b.lag,
                   left_out=merged(a, b))  # fmt: skip


def _of_many_joints(explanations: Sequence[Explanation], names: Sequence[str]) -> list[Explanation]:
    # Equal delays of many joints are one delay of the log. Many joints with the same other fault
    # probably have a common cause that is not known.
    groups: dict[tuple[str, str, bool], list[Explanation]] = {}
    for each in explanations:
        if each.joint in names and each.kind in _OF_ONE_JOINT:
            groups.setdefault((each.kind, each.part, each.is_second), []).append(each)
    found = list(explanations)
    for (kind, part, _), group in groups.items():
        if len({each.joint for each in group}) < _MANY:
            continue
        sizes = np.array([each.size for each in group])
        whole = all(each.from_start and each.end is None for each in group)
        found = [each for each in found if each not in group]
        if kind == "delay" and whole and np.std(sizes) < _EQUAL * abs(np.mean(sizes)):
            signal: Part = "measured torques" if part == "torque sensor" else "commanded torques"
            joints = tuple(dict.fromkeys(each.joint for each in group))
            found.append(replace(
                group[0], joint=ALL_JOINTS, part=signal, size=float(np.median(sizes)),
                joints=joints, confidence=max(each.confidence for each in group),
            ))  # fmt: skip
        else:
            found += [replace(each, confidence=min(each.confidence, _OF_MANY)) for each in group]
    return by_place(found, names)


def _beside_unexplained(explanations: Sequence[Explanation]) -> list[Explanation]:
    # What is unexplained at a joint may also cause what resembles a fault for a while.
    unknown = {each.joint for each in explanations if each.kind == "unexplained"}
    return [
        replace(each, confidence=min(each.confidence, _BESIDE_UNEXPLAINED))
        if each.joint in unknown and each.kind in _OF_A_WHILE and each.end is not None
        else each
        for each in explanations
    ]


def _by_known_links(found: TorqueResiduals) -> TorqueResiduals:
    return found if found.has_model else replace(found, link=np.full_like(found.link, np.nan))


def _outside_of_fits(found: TorqueResiduals, noise: Sequence[Explanation]) -> list[Explanation]:
    # Explanations that are not fitted to residuals, at most one per joint.
    sensors = stuck_sensors(found)
    signs = _unlike_fits(wrong_drives(found, _MIN_WRONG), found, noise, sensors)
    explanations = sensors + signs + stuck_joints(found)
    return list({each.joint: each for each in reversed(explanations)}.values())


def _unlike_fits(
    signs: Sequence[Explanation],
    found: TorqueResiduals,
    noise: Sequence[Explanation],
    without: Sequence[Explanation] = (),
) -> list[Explanation]:
    # For a short time, a bias, friction or delay can look like a wrong sign.
    if not signs:
        return []
    search = Search(found, without, noise)
    return [each for each in signs if not search.explains(each)]


def _with_runaway_drives(
    explanations: Sequence[Explanation],
    last: Sequence[Explanation],
    found: TorqueResiduals,
    ending: TorqueResiduals,
) -> list[Explanation]:
    # Runaway joints have little data, so they are explained by `last`, from the end of the run.
    names = found.robot.names
    left = np.nanmax(np.abs(ending.motor), axis=0, initial=0.0)
    runaway = {names[k] for k in np.flatnonzero(left > _MIN_ERROR * found.scale)}
    begins: dict[str, float] = {}
    for each in explanations:
        begins[each.joint] = min(each.begin, begins.get(each.joint, np.inf))
    unknown = {each.joint for each in explanations if each.kind == "unexplained"}
    first = float(ending.times[0]) - _ONSET_TOLERANCE
    starts = first <= found.times[0]
    runaway -= {joint for joint in begins if joint not in unknown or begins[joint] < first}
    clear = [
        replace(
            each,
            confidence=min(each.confidence, _FAST_CONFIDENCE),
            begin=min(each.begin, begins.get(each.joint, each.begin)),
            from_start=each.from_start and starts,
        )
        for each in last
        if each.joint in runaway and each.part == "drive" and each.kind != "unexplained"
    ]
    has = {each.joint for each in clear}
    return by_place([*clear, *(each for each in explanations if each.joint not in has)], names)


class TorqueExplainer(Explainer):
    """Explains torque differences by the residuals of the robot's model."""

    def of_two(
        self, a: RunLog, b: RunLog, robots: tuple[str, str], offset: float
    ) -> tuple[list[Explanation], list[str]]:
        (a, notes), (b, more) = usable(a, robots[0]), usable(b, robots[1])
        faults, first, second = _both(a, b, robots, offset)
        found = with_next([*faults, *explain_pair(first, second)], first)
        notes = [*(f"{a.name}: {note}" for note in notes), *(f"{b.name}: {note}" for note in more)]
        return found, [*notes, rows_line(_difference(first, second))]

    def of_one(self, run: RunLog, robot: str) -> tuple[list[Explanation], list[str]]:
        run, notes = usable(run, robot)
        found = torque_residuals(run, robot)
        return explain_run(run, robot, found), [*notes, *_about_model(found)]

    def with_model(self, run: RunLog, robot: str) -> tuple[Pair, list[Explanation], list[str]]:
        run, notes = usable(run, robot)
        found = torque_residuals(run, robot)
        explanations = explain_run(run, robot, replace(found, no_model=""))
        pair = pair_with_model(run, found)
        first = _first_difference(pair, found, explanations)
        return pair, explanations, [first, *notes, *_about_model(found)]

    def parameters(self, run: RunLog, robot: str) -> list[Parameter]:
        return parameters(identify(run, robot))


def _about_model(found: TorqueResiduals) -> list[str]:
    lines = []
    if found.undeclared:
        keys = ", ".join(found.undeclared)
        lines.append(
            f"{found.robot.name} declares no {keys}: they are fitted to this recording, so only "
            "changes of its drives are visible. Estimate them with `sero-mj identify`."
        )
    lines += ["model: inverse dynamics of the measured motion; all signals low-pass filtered at "
              f"{0.16 / found.width:.0f} Hz", rows_line(_by_known_links(found))]  # fmt: skip
    if found.torque_control:
        lines.append("Commands come from a joint torque loop that already compensates friction.")
    if not found.has_model:
        lines.append(f"no link model: {found.no_model}")
    return lines


def _first_difference(
    pair: Pair, found: TorqueResiduals, explanations: Sequence[Explanation]
) -> str:
    if not (np.isfinite(found.link).any() or np.isfinite(found.motor).any()):
        return f"{pair.robot.name} cannot be compared with its model"
    if not explanations:
        return f"{pair.robot.name} agrees with its model"
    first = min(explanations, key=lambda each: (not each.from_start, each.begin))
    kind = f"{first.kind} at {first.joint}, {first.when}"
    return f"first difference between {pair.robot.name} and its model: {kind}"
