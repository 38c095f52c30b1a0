"""`log_faults`: faults of the recorded signals themselves, such as swapped columns.

A wrong log makes a correct robot look broken, so these faults are searched before those of the
robot. Each hypothesis assigns a recorded column and a factor to each joint, for some signals.
It is judged by what remains of both sides of each joint, as a share of the torques:

    link side     |measured - model|^2 / (|measured|^2 + |model|^2)
    motor side    the same of commanded and measured torques, after the best motor inertia and
                  friction of the joint

The score is the sum of the logarithms over joints and sides, so that a broken joint does not decide
alone. Faults of the robot that act during the whole run compete: gains and biases of sensors and
drives, payload, masses, encoder offsets, and the direction of gravity. If they explain the torques
as well, the log is not blamed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ...base.frames import Array
from ...simulate.runs.run_log import RunLog, event_of
from ...study.explanation import ALL_JOINTS, MAX_CONFIDENCE, Explanation, Kind, Part
from .goodness import limited
from .hypothesis_fit import HypothesisFit
from .recorded_rows import ANGLES, COMMANDED, MEASURED, Hypothesis, RecordedRows, Signals
from .robot_score import PRICE, PRICE_OF_FIT, robot_score
from .torque_residuals import TorqueResiduals

_SUSPECTS = 12  # maximum number of joints whose signs and pairs are tried
_MAX_FAULTS = 3  # of the log, one after the other
_MIN_SHARE = 0.03  # largest remaining share of the torques of a correct run
_ALTERNATIVE, _SAME = 1.0, 0.2  # differences of scores
_MIN_RATIO, _MIN_PROBABILITY = 10.0, 0.9  # to accept a hypothesis
_CHANGE = 0.5  # relative change of a squared share that a hypothesis affects
_BEAM = 5  # sets of signs that are extended by one more joint
_FACTORS = (0.5, 0.7, 0.85, 1.2, 1.4, 2.0)  # start values of the factor of an angle
_GEARS = 1.2 ** -np.arange(3.0, 31.0)  # the same, if the angle exceeds its range: to 1/237
_DEGREES, _MILLI = np.pi / 180.0, 1e-3

_PARTS: dict[Signals, Part] = {
    (ANGLES,): "angles",
    (MEASURED,): "measured torques",
    (COMMANDED,): "commanded torques",
    (MEASURED, COMMANDED): "torques",
    (ANGLES, MEASURED): "signals",
    (ANGLES, MEASURED, COMMANDED): "signals",
}


def log_faults(log: RunLog, name: str, found: TorqueResiduals) -> tuple[list[Explanation], RunLog]:
    """Returns the faults of a robot's recorded signals, and the log without them.

    Args:
        found: residuals of the recorded signals.
    """
    faults: list[Explanation] = []
    rows = RecordedRows.of(found)
    while rows is not None and len(faults) < _MAX_FAULTS:
        best = _Trial(rows).best()
        if best is None:
            break
        hypothesis, explanation = best
        faults.append(replace(explanation, begin=float(found.times[0])))
        events = {event_of(name, signal): signal for signal in hypothesis.signals}
        signals = {
            event: hypothesis.of(events[event], values) if event in events else values
            for event, values in log.signals.items()
        }
        log = RunLog(log.robots, signals, log.times, log.name)
        rows = rows.corrected(hypothesis)
    return faults, log


class _Trial:
    """Tries hypotheses about the columns of a run."""

    def __init__(self, rows: RecordedRows) -> None:
        self.rows, self.fit, self.n = rows, HypothesisFit(rows), rows.robot.n

    def best(self) -> tuple[Hypothesis, Explanation] | None:
        """Returns the fault of the log, if it explains the torques far better than the others."""
        noise = self.rows.noise**2 / self.fit.sizes(self.rows.torques[0], self.fit.model)
        if (self.fit.before < _MIN_SHARE**2 + 3.0 * noise).all():
            return None
        tried: dict[Hypothesis, Array] = {}
        for hypotheses in self._groups():
            tried |= self.fit.judged(hypotheses)
        if not tried:
            return None
        scores = {each: self.fit.score(shares) for each, shares in tried.items()}
        totals = {each: score + each.price for each, score in scores.items()}
        best = min(totals, key=lambda each: totals[each])
        simpler = {each: total for each, total in totals.items() if not (
            (len(each.joints) > len(best.joints) and scores[each] > scores[best] - _SAME)
            or (each.price == PRICE_OF_FIT and any(map(each.resembles, tried)))
        )}  # fmt: skip
        alternatives = [each for each, total in simpler.items()
                        if each != best and total < totals[best] + _ALTERNATIVE]  # fmt: skip
        rivals = [robot_score(self.fit)]
        of_log, of_robot = (
            np.exp(np.clip(totals[best] - np.array(list(each)), -60.0, 60.0))
            for each in (simpler.values(), rivals)
        )
        near = sum(float(np.exp(totals[best] - totals[each])) for each in (best, *alternatives))
        everything = float(of_log.sum() + of_robot.sum())
        after = tried[best]
        largest = np.maximum(self.fit.before, after)
        concerned = np.abs(self.fit.before - after) > _CHANGE * largest
        remaining = float(after[concerned].sum() / max(self.fit.before[concerned].sum(), 1e-12))
        if near < _MIN_PROBABILITY * everything or remaining * _MIN_RATIO > 1.0:
            return None
        confidence = limited(min(1.0 / everything, MAX_CONFIDENCE), float(np.sqrt(remaining)))
        found = self._explanation(best, confidence)
        others = [self._explanation(each, 0.0) for each in alternatives]
        return best, replace(found, alternatives=tuple(each.text for each in others))

    # Hypotheses

    def _groups(self) -> Iterable[Iterable[Hypothesis]]:
        if self.fit.has_link:
            yield self._of_angles()
            yield self._signs()
            yield self._scales()
        yield self._of_columns()
        yield self._of_torques()

    def _make(self, kind: Kind, signals: Signals, price: float = PRICE, *,
              order: Sequence[int] | None = None,
              factors: Array | None = None) -> Hypothesis:  # fmt: skip
        order = range(self.n) if order is None else order
        factors = np.ones(self.n) if factors is None else factors
        return Hypothesis(kind, signals, tuple(order), tuple(factors.tolist()), price)

    def _suspects(self) -> list[int]:
        # Joints whose torques differ most; a wrong column has an effect on its own joint.
        order = np.argsort(-self.fit.before.sum(axis=0))
        return sorted(int(joint) for joint in order[:_SUSPECTS])

    def _of_angles(self) -> Iterable[Hypothesis]:
        revolute = np.array(self.rows.robot.types) == "revolute"
        yield self._make("sign", (ANGLES,), factors=-np.ones(self.n))
        yield self._make("scale", (ANGLES,), factors=np.where(revolute, _DEGREES, 1.0))
        for joint in self._suspects():
            unit = _DEGREES if revolute[joint] else _MILLI
            for factor in (unit, 1.0 / unit):
                yield self._make("scale", (ANGLES,), factors=self.fit.at([joint], factor))

    def _signs(self) -> Iterable[Hypothesis]:
        # The best sets of wrong signs are extended by one more joint at a time.
        suspects, fit = self._suspects(), self.fit
        beam: list[frozenset[int]] = [frozenset()]
        lowest = np.inf
        while True:
            sets = {each | {joint} for each in beam for joint in suspects if joint not in each}
            made = {
                self._make(
                    "sign", (ANGLES,), PRICE * len(each), factors=fit.at([*each], -1.0)
                ): each
                for each in sets
            }
            yield from made
            scores = {each: fit.score(shares) for each, shares in fit.judged(made).items()}
            best = sorted(scores, key=lambda each: scores[each])[:_BEAM]
            if not best or (len(made[best[0]]) > 3 and scores[best[0]] > lowest):
                return
            lowest = min(lowest, scores[best[0]])
            beam = [made[each] for each in best]

    def _scales(self) -> Iterable[Hypothesis]:
        # Factors of the angle of one joint, fitted from the best start values.
        largest = np.abs(self.rows.motion[0]).max(axis=0)
        limits = self.rows.robot.plausible_limits
        allowed = np.where(np.isfinite(limits).all(axis=1), np.abs(limits).max(axis=1), 2 * np.pi)
        starts = [
            (joint, factor) for joint in self._suspects()
            for factor in (*_FACTORS, *(
                [*_GEARS, *-_GEARS] if largest[joint] > 1.05 * allowed[joint] else []))
            if largest[joint] * abs(factor) < 1.05 * allowed[joint]
        ]  # fmt: skip
        made = [self._make("scale", (ANGLES,), PRICE_OF_FIT, factors=self.fit.at([j], factor))
                for j, factor in starts]  # fmt: skip
        judged = self.fit.judged(made)
        best: dict[int, Hypothesis] = {}
        for each in sorted(made, key=lambda each: self.fit.score(judged[each])):
            best.setdefault(each.joints[0], each)
        joints = list(best)
        fitted = self.fit.fitted(
            joints, [each.factors[joint] for joint, each in best.items()], self.fit.scaled
        )
        for joint, factor in zip(joints, fitted, strict=True):
            yield self._make("scale", (ANGLES,), PRICE_OF_FIT,
                             factors=self.fit.at([joint], factor))  # fmt: skip

    def _sets(self) -> list[Signals]:
        of_torques: list[Signals] = [(MEASURED,)]
        if self.fit.has_motor:
            of_torques += [(COMMANDED,), (MEASURED, COMMANDED)]
        return of_torques

    def _of_columns(self) -> Iterable[Hypothesis]:
        sets = self._sets()
        if self.fit.has_link:
            sets += [(ANGLES,), (ANGLES, *sets[-1])]
        orders: list[tuple[Kind, list[int]]] = []
        for i, j in combinations(self._suspects(), 2):
            order = list(range(self.n))
            order[i], order[j] = j, i
            orders.append(("swap", order))
        if self.n > 2:
            orders += [("order", np.roll(range(self.n), -k).tolist()) for k in range(1, self.n)]
        for kind, order in orders:
            for signals in sets:
                yield self._make(kind, signals, order=order)

    def _of_torques(self) -> Iterable[Hypothesis]:
        # Factors of the torques of all joints, and joints with other signs of both torques.
        measured, commanded = self.rows.torques
        for signals in self._sets():
            if signals == (COMMANDED,):
                factor = _median_gain(commanded, measured, self.rows.judged[1])
            elif self.fit.has_link:
                factor = _median_gain(measured, self.fit.model, self.rows.judged[0])
            else:
                factor = _median_gain(measured, commanded, self.rows.judged[1])
            yield self._make("sign", signals, factors=-np.ones(self.n))
            if factor and np.isfinite(factor):
                yield self._make("scale", signals, PRICE_OF_FIT, factors=np.full(self.n, factor))
        for joint in self._suspects() if self.fit.has_motor and self.fit.has_link else ():
            yield self._make("sign", (MEASURED, COMMANDED), factors=self.fit.at([joint], -1.0))

    # Explanations

    def _explanation(self, it: Hypothesis, confidence: float) -> Explanation:
        names = self.rows.robot.names
        joints = it.joints
        factor = it.factors[joints[0]]
        place = ALL_JOINTS if len(joints) == self.n > 1 else names[joints[0]]
        size = -1.0
        if it.kind == "scale":
            size = 1.0 / factor
        elif it.kind == "order":
            size = float(it.order[0])
        return Explanation(
            place, it.kind, _PARTS[it.signals], size, "", np.nan, confidence, 0.0,
            from_start=True, joints=tuple(names[joint] for joint in joints),
        )  # fmt: skip


def _median_gain(values: Array, expected: Array, judged: Array) -> float:
    # The median factor over the joints that fits values (K, n) to the expected ones.
    with np.errstate(invalid="ignore", divide="ignore"):
        gains = (values * expected).sum(axis=0) / (values**2).sum(axis=0)
    gains = gains[np.isfinite(gains) & (judged > 0)]
    return float(np.median(gains)) if len(gains) else np.nan
