"""Aligns two runs of a robot in time."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..base.errors import Problem, UsageError, first_of
from ..base.frames import Array
from ..robots.declared.robot import SerialRobot
from ..simulate.runs.run_log import RunLog, compared_signal

log = logging.getLogger(__name__)

_MIN_OVERLAP = 0.3  # minimum overlap as a share of the shorter motion
_MIN_SPEED = 1e-4  # minimum root mean square velocity, rad/s or m/s
_MAX_ROWS = 2**21
# Penalty in correlation for shorter overlaps. A periodic motion matches at every period; the shift
# with the longest overlap is selected.
_OVERLAP_WEIGHT = 0.1


@dataclass(frozen=True)
class Shift:
    """The time shift between two motions.

    Attributes:
        seconds: shift to add to the times of the second motion.
        correlation: normalized cross-correlation of the velocities, 1 for the same motion.
    """

    seconds: float
    correlation: float


def find_shift(times_a: Array, angles_a: Array, times_b: Array, angles_b: Array) -> Shift | None:
    """Estimates the time shift of motion `b` from the velocities of all joints.

    The shift maximizes the normalized cross-correlation among overlaps of at least 30 % of the
    shorter motion. It is refined by a parabola through the highest three values. Times have the
    shape (T,), angles have the shape (T, n). Returns None if the robot hardly moves in a run.
    """
    spans = times_a[-1] - times_a[0], times_b[-1] - times_b[0]
    if min(spans) <= 0.0:
        return None
    step = max(
        float(np.median(np.diff(times_a))), float(np.median(np.diff(times_b))),
        sum(spans) / _MAX_ROWS,
    )  # fmt: skip
    a, b = _velocities(times_a, angles_a, step), _velocities(times_b, angles_b, step)
    if min(len(a), len(b)) < 3 or min(_rms(a), _rms(b)) < _MIN_SPEED:
        return None
    scores, correlation, first = _correlate(a, b)
    best = int(np.argmax(scores))
    # The overlap selects a peak; its maximum depends on the correlation only.
    while best + 1 < len(correlation) and correlation[best + 1] > correlation[best]:
        best += 1
    while best > 0 and correlation[best - 1] > correlation[best]:
        best -= 1
    fraction = 0.0
    if 0 < best < len(scores) - 1 and np.isfinite(scores[best - 1 : best + 2]).all():
        before, at, after = correlation[best - 1 : best + 2]
        bend = before - 2.0 * at + after
        fraction = float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0
    seconds = times_a[0] - times_b[0] + (first + best + fraction) * step
    return Shift(float(seconds), float(correlation[best]))


def _correlate(a: Array, b: Array) -> tuple[Array, Array, int]:
    # Returns score and correlation of every lag, and the first lag. Lag k aligns row i of b with
    # row i + k of a.
    length = len(a) + len(b) - 1
    size = 1 << (length - 1).bit_length()
    product = np.fft.rfft(a, size, axis=0) * np.conj(np.fft.rfft(b, size, axis=0))
    circular = np.fft.irfft(product.sum(axis=1), size)
    first = 1 - len(b)
    raw = np.concatenate([circular[size + first :], circular[: len(a)]])
    lags = np.arange(first, len(a))
    begin, end = np.maximum(lags, 0), np.minimum(lags + len(b), len(a))
    energy_a, energy_b = _summed(a), _summed(b)
    energies = (energy_a[end] - energy_a[begin]) * (energy_b[end - lags] - energy_b[begin - lags])
    overlap = (end - begin) / min(len(a), len(b))
    enough = (overlap >= _MIN_OVERLAP) & (energies > 1e-9 * energy_a[-1] * energy_b[-1])
    correlation = np.full(len(lags), -np.inf)
    correlation[enough] = raw[enough] / np.sqrt(energies[enough])
    return correlation + _OVERLAP_WEIGHT * np.minimum(overlap, 1.0), correlation, first


def _summed(velocities: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.sum(velocities**2, axis=1))])


def _velocities(times: Array, angles: Array, step: float) -> Array:
    even = np.arange(times[0], times[-1] + 0.5 * step, step)
    sampled = np.stack([np.interp(even, times, column) for column in angles.T], axis=1)
    return np.asarray(np.gradient(sampled, step, axis=0)) if len(even) > 1 else sampled * 0.0


def _rms(velocities: Array) -> float:
    return float(np.sqrt(np.mean(velocities**2)))


# Signals that are compared if both runs have them.
COMPARED = ("joint_angles", "joint_velocities", "torques", "commanded_torques")
# Gaps that exceed both limits are not interpolated.
_GAP, _GAP_ROWS = 0.1, 5  # limits in s and in packets
_MIN_CORRELATION = 0.5  # minimum for a meaningful offset


@dataclass(frozen=True, eq=False)
class Pair:
    """Two runs of a robot at the same times.

    Attributes:
        robot: robot as declared in the first run.
        times: times on the clock of the first run, shape (T,), s.
        a: mapping from signals to values of the first run, shape (T, n), NaN if unknown.
        b: mapping from signals to values of the second run, shape (T, n), NaN if unknown.
        offset: offset that was added to the times of the second run, s.
        correlation: correlation of the motions if the offset was estimated, else None.
        names: names of the two runs.
    """

    robot: SerialRobot
    times: Array
    a: Mapping[str, Array]
    b: Mapping[str, Array]
    offset: float
    correlation: float | None
    names: tuple[str, str]

    def difference(self, signal: str) -> Array:
        """Returns the values of the first run minus those of the second, shape (T, n)."""
        return np.asarray(self.a[signal] - self.b[signal])

    @property
    def signals(self) -> list[str]:
        return [signal for signal in COMPARED if signal in self.a and signal in self.b]

    @property
    def has_one_motion(self) -> bool:
        """Whether the runs have the same motion by definition, as for a robot and its model."""
        return self.a.get("joint_angles") is self.b.get("joint_angles")


def align(
    a: RunLog, b: RunLog, robot: str | None = None, offset: float | Literal["auto"] = 0.0
) -> Pair:
    """Resamples two runs at common times, which are the times of the run with the higher rate.

    Values are interpolated linearly, except across gaps.

    `robot` is a name, `NAME,NAME` for different names in `a` and `b`, or None for the only common
    robot. `offset` (s) is added to the times of `b`; `auto` estimates it from joint velocities.

    Raises:
        UsageError: there is no such robot, or the runs do not overlap.
    """
    of_a, of_b = choose_robots(a, b, robot)
    shift: Shift | None = None
    if offset == "auto":
        shift = find_shift(a.times, a.of(of_a, "joint_angles"), b.times, b.of(of_b, "joint_angles"))
        if shift is None:
            found = "one of the runs hardly moves"
            raise UsageError(Problem("--offset auto", found, expected="a number of seconds"))
        if shift.correlation < _MIN_CORRELATION:
            problem = Problem(
                "--offset auto",
                f"the motions of {a.name} and {b.name} have a correlation of",
                found=round(shift.correlation, 2),
                expected=f"at least {_MIN_CORRELATION:g}, or a number of seconds",
            )
            raise UsageError(problem)
    _check_names(a, of_a, b, of_b)
    seconds = float(offset) if shift is None else shift.seconds
    moved = b.times + seconds
    begin, end = max(a.times[0], moved[0]), min(a.times[-1], moved[-1])
    base = a.times if a.timestep <= b.timestep else moved
    slack = 1e-6 * max(a.timestep, b.timestep)
    times = base[(base >= begin - slack) & (base <= end + slack)]
    if len(times) < 2:
        spans = [f"{name} from {t[0]:.3f} s to {t[-1]:.3f} s"
                 for name, t in ((a.name, a.times), (b.name, moved))]  # fmt: skip
        where = f" with the offset {seconds:g} s" if seconds else ""
        expected = "runs that overlap. Set --offset S or --offset auto."
        raise UsageError(Problem("", f"found {spans[0]}, {spans[1]}{where}", expected=expected))
    return Pair(
        a.robots[of_a],
        times,
        _sampled(a, of_a, a.times, times),
        _sampled(b, of_b, moved, times),
        seconds,
        None if shift is None else shift.correlation,
        (a.name, b.name),
    )


def pair_with_commands(log: RunLog, robot: str | None = None) -> Pair:
    """Pairs the commanded and measured torques of a robot; `robot` is None for the only robot.

    Raises:
        UsageError: there is no such robot, the robot is ambiguous, or torques are missing.
    """
    name = choose_robot(log, robot)
    for signal in ("torques", "commanded_torques"):
        if not log.has(name, signal):
            found = f"has no {signal} of '{name}'"
            expected = "torques and commanded_torques, or a second recording to compare with"
            raise UsageError(Problem(log.name, found, expected=expected))
    angles = log.of(name, "joint_angles")
    return Pair(
        log.robots[name],
        log.times,
        {"joint_angles": angles, "torques": compared_signal(log, name, "commanded_torques")},
        {"joint_angles": angles, "torques": log.of(name, "torques")},
        0.0,
        None,
        ("commanded", "measured"),
    )


def choose_robot(log: RunLog, name: str | None) -> str:
    """Returns the name of a robot in a run; `name` is None for the only robot.

    Raises:
        UsageError: there is no such robot, or `name` is None and there are several robots.
    """
    if name is not None and name not in log.robots:
        where, known = f"in {log.name}", log.robots
        raise UsageError(Problem("--robot", "no robot", found=name, of=where, available=known))
    if name is None and len(log.robots) != 1:
        has = ", ".join(log.robots) or "no robot"
        raise UsageError(f"{log.name} has {has}; choose one with --robot NAME")
    return name or next(iter(log.robots))


def choose_robots(a: RunLog, b: RunLog, name: str | None = None) -> tuple[str, str]:
    """Returns the names of a robot in two runs.

    `name` is `NAME`, `NAME,NAME`, or None for the only common robot.

    Raises:
        UsageError: there is no such robot, the choice of the robot is ambiguous, or the numbers of
            joints differ.
    """
    if name is not None:
        in_a, _, in_b = name.partition(",")
        pair = in_a.strip(), (in_b or in_a).strip()
        for run, wanted in zip((a, b), pair, strict=True):
            if wanted not in run.robots:
                where, known = f"in {run.name}", run.robots
                problem = Problem("--robot", "no robot", found=wanted, of=where, available=known)
                raise UsageError(problem)
    else:
        common = [each for each in a.robots if each in b.robots]
        if len(common) == 1:
            pair = common[0], common[0]
        elif not common and len(a.robots) == len(b.robots) == 1:
            pair = next(iter(a.robots)), next(iter(b.robots))
        elif common:
            raise UsageError(f"both runs have {', '.join(common)}; choose one with --robot NAME")
        else:
            has = [f"{run.name} has {', '.join(run.robots) or 'no robot'}" for run in (a, b)]
            hint = "choose a pair with --robot NAME,NAME"
            raise UsageError(f"{has[0]}, {has[1]}: no common robot; {hint}")
    first, second = a.robots[pair[0]], b.robots[pair[1]]
    if first.n != second.n:
        found = f"{pair[0]} has {first.n} joints in {a.name}, {pair[1]} has {second.n} in {b.name}"
        raise UsageError(Problem("", found, expected="the same number"))
    return pair


def _check_names(a: RunLog, of_a: str, b: RunLog, of_b: str) -> None:
    first, second = a.robots[of_a].names, b.robots[of_b].names
    if first == second:
        return
    names = f"{first_of(first)} in {a.name}, {first_of(second)} in {b.name}"
    if sorted(first) == sorted(second):
        expected = "the same order. --scene ROBOT reads both in the order of ROBOT."
        raise UsageError(Problem("", f"the joints are {names}", expected=expected))
    log.warning("joint names differ, so joints are compared in order: %s", names)


def _sampled(log: RunLog, robot: str, times: Array, wanted: Array) -> dict[str, Array]:
    return {
        signal: at_times(times, compared_signal(log, robot, signal), wanted)
        for signal in COMPARED
        if log.has(robot, signal)
    }


def at_times(times: Array, values: Array, wanted: Array, gap: float = _GAP) -> Array:
    """Interpolates values, shape (T, n), linearly from increasing `times` to the times `wanted`.

    Returns NaN outside `times` and in gaps, which are longer than `gap` (s) and than 5 intervals.
    """
    if len(times) == 1:
        return np.where(wanted[:, None] == times[0], values[0], np.nan)
    right = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    left = right - 1
    widths = times[right] - times[left]
    with np.errstate(invalid="ignore"):
        share = np.clip((wanted - times[left]) / widths, 0.0, 1.0)
        result = values[left] + share[:, None] * (values[right] - values[left])
    # NaN in an adjacent row must not affect a row that matches exactly.
    for exact, rows in ((share == 0.0, left), (share == 1.0, right)):
        result[exact] = values[rows[exact]]
    steps = np.diff(times)
    longest = max(gap, _GAP_ROWS * float(np.median(steps)))
    slack = 1e-6 * float(np.median(steps))
    inside = (widths > longest) & (share > 0.0) & (share < 1.0)
    outside = (wanted < times[0] - slack) | (wanted > times[-1] + slack)
    result[inside | outside] = np.nan
    return np.asarray(result)
