"""`usable`: a recording without rows that the robot did not send, and notes about its data.

A verdict about rows that the robot did not send would be wrong: a sender that stopped looks like
broken sensors in all joints, and torques that were never recorded look like links without mass.
"""

from __future__ import annotations

import numpy as np

from ...base.frames import Array, Bools
from ...simulate.runs.run_log import RunLog, event_of

_SIGNALS = ("joint_angles", "torques", "commanded_torques")
_STOPPED = 0.2  # s, minimum duration of constant signals that are left out
_JUMP = 10.0  # minimum gap of a clock jump, relative to the duration of all other rows
_MISSING = 0.01  # share of missing rows above which they are reported
_MANY, _MOST = 3, 0.5  # minimum number and share of joints whose torques are not recorded
_LARGEST = 1e6  # rad, m, Nm or N; larger values are not data
_MAX_NAMES = 12


def usable(log: RunLog, name: str) -> tuple[RunLog, list[str]]:
    """Returns a robot's run without rows that are certainly wrong, and notes about its data.

    Values that are left out are NaN. Only the longest part between jumps of the clock is returned.
    """
    if len(log.times) < 2 or not log.has(name, "torques"):
        return log, []
    log, notes = _between_clock_jumps(log)
    notes += _about_times(log.times)
    signals = {each: log.of(name, each) for each in _SIGNALS if log.has(name, each)}
    changed: dict[str, Array] = {}
    for each, values in signals.items():
        wild = np.abs(values) > _LARGEST  # false for NaN
        if wild.any():
            notes.append(f"rows with infinite or huge {each}: {int(wild.any(axis=1).sum())}")
            changed[each] = np.where(wild, np.nan, values)
    signals |= changed
    stopped, note = _stopped(log.times, signals)
    if note:
        notes.append(note)
    if stopped.any():
        changed = {
            each: np.where(stopped[:, None], np.nan, values) for each, values in signals.items()
        }
        signals |= changed
    names = log.robots[name].names
    still = _constant(signals["joint_angles"])
    unrecorded = _constant(signals["torques"])
    if not still.all() and unrecorded.sum() >= max(_MANY, _MOST * len(names)):
        notes.append(f"constant torques of {_listed(names, unrecorded)}: they are not used")
        changed["torques"] = np.where(unrecorded, np.nan, signals["torques"])
    notes += _about_joints(signals, names, still)
    if not changed:
        return log, notes
    events = {event_of(name, each): values for each, values in changed.items()}
    return RunLog(log.robots, {**log.signals, **events}, log.times, log.name), notes


def _between_clock_jumps(log: RunLog) -> tuple[RunLog, list[str]]:
    steps = np.diff(log.times)
    jump = int(np.argmax(steps))
    if steps[jump] <= _JUMP * (steps.sum() - steps[jump]) or len(steps) < 2:
        return log, []
    parts = [(log.times[0], log.times[jump]), (log.times[jump + 1], log.times[-1])]
    begin, end = parts[0] if jump + 1 >= len(log.times) / 2 else parts[1]
    note = f"the times jump by {steps[jump]:.3g} s after {log.times[jump]:.2f} s: only the rows " \
           f"from {begin:.2f} s to {end:.2f} s are used"  # fmt: skip
    part, notes = _between_clock_jumps(log.between(float(begin), float(end)))
    return part, [note, *notes]


def _about_times(times: Array) -> list[str]:
    steps = np.diff(times)
    same = int((steps == 0.0).sum())
    notes = [f"rows with the time of the row before: {same}"] if same else []
    step = float(np.median(steps))
    if step > 0.0:
        expected = round(float(times[-1] - times[0]) / step) + 1
        share = 1.0 - (len(times) - same) / expected
        if share > _MISSING:
            notes.append(f"{100.0 * share:.0f} % of the rows at {1.0 / step:.4g} Hz are missing")
    return notes


def _stopped(times: Array, signals: dict[str, Array]) -> tuple[Bools, str]:
    # Rows after the first one of intervals in which all signals are constant, unless all are.
    same = np.ones(len(times), bool)
    for values in signals.values():
        known = np.isfinite(values).any(axis=0)  # others are not recorded
        same[1:] &= (np.diff(values[:, known], axis=0) == 0.0).all(axis=1)
    same[0] = False
    if same[1:].all():
        return np.zeros_like(same), "all signals are constant: there is only one pose"
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
    spans = [(b, e) for b, e in zip(edges[::2], edges[1::2], strict=True)
             if times[e - 1] - times[b - 1] >= _STOPPED]  # fmt: skip
    stopped = np.zeros_like(same)
    for begin, end in spans:
        stopped[begin:end] = True
    if not spans:
        return stopped, ""
    texts = [f"{times[b - 1]:.2f} s to {times[e - 1]:.2f} s" for b, e in spans[:_MAX_NAMES]]
    return (
        stopped,
        f"all signals are constant from {', from '.join(texts)}: these rows are not used",
    )


def _constant(values: Array) -> Bools:
    # Joints with a known signal (T, n) that never changes.
    with np.errstate(invalid="ignore"):
        low, high = np.fmin.reduce(values, axis=0), np.fmax.reduce(values, axis=0)
    return np.asarray(low == high)


def _about_joints(signals: dict[str, Array], names: list[str], still: Bools) -> list[str]:
    notes = []
    for signal, what in (("joint_angles", "angles"), ("torques", "measured torques"),
                         ("commanded_torques", "commanded torques")):  # fmt: skip
        values = signals.get(signal)
        if values is None:
            notes.append(f"no {what}: drives and friction are not examined")
            continue
        unknown = np.asarray(~np.isfinite(values).any(axis=0))
        if unknown.any():
            effect = ""
            if signal == "joint_angles":
                effect = ": link torques of all joints are unknown"
            notes.append(f"no {what} of {_listed(names, unknown)}{effect}")
    if still.any():
        notes.append(f"no motion of {_listed(names, still)}: friction is not examined there")
    return notes


def _listed(names: list[str], chosen: Bools) -> str:
    found = [name for name, is_one in zip(names, chosen, strict=True) if is_one]
    if len(found) == len(names) > 1:
        return "all joints"
    more = f" and {len(found) - _MAX_NAMES} more" if len(found) > _MAX_NAMES else ""
    return ", ".join(found[:_MAX_NAMES]) + more
