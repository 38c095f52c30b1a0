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

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...base.frames import Array
from ...robots.declared.robot import SerialRobot
from ...simulate.runs.run_log import RunLog, event_of
from ...study.explanation import ALL_JOINTS, MAX_CONFIDENCE, Explanation, Kind, Part
from .goodness import limited
from .link_torques import link_model, link_torques, torques_by_gravity
from .torque_residuals import TorqueResiduals, is_coupled

_ROWS = 60  # rows at which hypotheses are judged
_MIN_ROWS = 12
_SUSPECTS = 12  # maximum number of joints whose signs and pairs are tried
_MAX_FAULTS = 3  # of the log, one after the other
_MIN_SHARE = 0.03  # largest remaining share of the torques of a correct run
_FLOOR = 1e-3  # share of the torque limit that is regarded as zero
_NOISE = 0.2  # share of white noise that passes the low-pass filter
# Remaining shares (link and motor side) below which hypotheses are equally good.
_EQUAL = np.array([0.005, 0.03])
# Prices of a fault and of a fault with fitted parameters, in units of the score.
_PRICE, _PRICE_OF_FIT, _OF_JOINT = 2.0, 3.0, 3.0
_ALTERNATIVE, _SAME = 1.0, 0.2  # differences of scores
_MIN_RATIO, _MIN_PROBABILITY = 10.0, 0.9  # to accept a hypothesis
_CHANGE = 0.5  # relative change of a squared share that a hypothesis affects
_CLOSE = 0.05  # relative difference of factors that are regarded as equal
_BEAM = 5  # sets of signs that are extended by one more joint
_ROUNDS, _STEP = 6, 1e-3  # of a fitted factor or offset
_FACTORS = (0.5, 0.7, 0.85, 1.2, 1.4, 2.0)  # start values of the factor of an angle
_GEARS = 1.2 ** -np.arange(3.0, 31.0)  # the same, if the angle exceeds its range: to 1/237
_MAX_OFFSET, _MAX_MASSES, _MIN_GAIN = 0.5, 0.5, 0.05  # rad or m; shares
_DEGREES, _MILLI = np.pi / 180.0, 1e-3

_ANGLES, _MEASURED, _COMMANDED = "joint_angles", "torques", "commanded_torques"
_Signals = tuple[str, ...]
_PARTS: dict[_Signals, Part] = {
    (_ANGLES,): "angles",
    (_MEASURED,): "measured torques",
    (_COMMANDED,): "commanded torques",
    (_MEASURED, _COMMANDED): "torques",
    (_ANGLES, _MEASURED): "signals",
    (_ANGLES, _MEASURED, _COMMANDED): "signals",
}


@dataclass(frozen=True)
class _Hypothesis:
    """How the correct signals follow from the recorded ones.

    Attributes:
        order: the recorded column of each joint.
        factors: factors of the columns in `order`.
    """

    kind: Kind
    signals: _Signals
    order: tuple[int, ...]
    factors: tuple[float, ...]
    price: float

    def of(self, signal: str, values: Array) -> Array:
        """Returns the correct signal, from a recorded one with shape (..., n)."""
        return values[..., self.order] * self.factors if signal in self.signals else values

    def resembles(self, other: _Hypothesis) -> bool:
        """Whether a simpler hypothesis has almost the same factors for the same columns."""
        same = self.signals == other.signals and self.order == other.order
        same &= self.price > other.price
        return same and bool(np.allclose(self.factors, other.factors, rtol=_CLOSE))

    @property
    def joints(self) -> list[int]:
        each = zip(self.order, self.factors, strict=True)
        return [k for k, (column, factor) in enumerate(each) if column != k or factor != 1.0]


def log_faults(log: RunLog, name: str, found: TorqueResiduals) -> tuple[list[Explanation], RunLog]:
    """Returns the faults of a robot's recorded signals, and the log without them.

    Args:
        found: residuals of the recorded signals.
    """
    faults: list[Explanation] = []
    rows = _Rows.of(found)
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


@dataclass(frozen=True, eq=False)
class _Rows:
    """Filtered signals at a few rows.

    Attributes:
        motion: angles, velocities and accelerations, shape (3, K, n).
        motor: acceleration, velocity and its sign, shape (K, n, 3); the torque of motor inertia and
            friction is a combination of them.
        torques: measured and commanded torques, shape (2, K, n).
        payload: torques per unit of the parameters of a payload, shape (K, n, 10).
        judged: whether each joint is judged on the link side and the motor side, shape (2, n).
        noise: standard deviations of the filtered measured torques, shape (n,), Nm or N.
        floor: torques that are regarded as zero, shape (n,), Nm or N.
    """

    robot: SerialRobot
    motion: Array
    motor: Array
    torques: Array
    payload: Array
    judged: Array
    noise: Array
    floor: Array
    torque_control: bool

    @classmethod
    def of(cls, found: TorqueResiduals) -> _Rows | None:
        torques = np.stack([found.torques.measured, found.torques.commanded])
        has_commands = bool(np.isfinite(torques[1]).any())
        motion = found.motion
        motor = np.stack([motion.accelerations, motion.velocities, motion.signs], axis=-1)
        needed = [torques[0], *motion.links, *([torques[1]] if has_commands else [])]
        rows = np.flatnonzero(np.isfinite(needed).all(axis=(0, 2)))
        if len(rows) < _MIN_ROWS:
            return None
        rows = rows[np.linspace(0, len(rows) - 1, min(_ROWS, len(rows))).astype(int)]
        robot = found.robot
        known = ~is_coupled(robot)
        judged = np.stack([known & found.has_model, known & has_commands])
        return cls(robot, motion.links[:, rows], np.nan_to_num(motor[rows]),
                   np.nan_to_num(torques[:, rows]), found.torques.payload[rows],
                   judged.astype(float), _NOISE * np.median(found.noise.roughness, axis=0),
                   _FLOOR * found.scale, found.torque_control)  # fmt: skip

    def corrected(self, it: _Hypothesis) -> _Rows:
        motor = np.moveaxis(it.of(_ANGLES, np.moveaxis(self.motor, -1, 0)), 0, -1)
        torques = [it.of(_MEASURED, self.torques[0]), it.of(_COMMANDED, self.torques[1])]
        return replace(self, motion=it.of(_ANGLES, self.motion), motor=motor,
                       torques=np.stack(torques), noise=it.of(_MEASURED, self.noise))  # fmt: skip


class _Trial:
    """Judges hypotheses about the columns of a run."""

    def __init__(self, rows: _Rows) -> None:
        self.rows, self.n = rows, rows.robot.n
        self.has_link, self.has_motor = (bool(side.any()) for side in rows.judged)
        self.links = link_model(rows.robot)
        self.basis = np.linalg.qr(np.moveaxis(rows.motor, 1, 0))[0]  # (n, K, 3)
        self.model = self._models([rows.motion])[0]
        self.before = self._shares(rows.torques, rows.noise, self.model, range(self.n))

    def best(self) -> tuple[_Hypothesis, Explanation] | None:
        """Returns the fault of the log, if it explains the torques far better than the others."""
        noise = self.rows.noise**2 / self._sizes(self.rows.torques[0], self.model)
        if (self.before < _MIN_SHARE**2 + 3.0 * noise).all():
            return None
        tried: dict[_Hypothesis, Array] = {}
        for hypotheses in self._groups():
            tried |= self._judged(hypotheses)
        if not tried:
            return None
        scores = {each: self._score(shares) for each, shares in tried.items()}
        totals = {each: score + each.price for each, score in scores.items()}
        best = min(totals, key=lambda each: totals[each])
        simpler = {each: total for each, total in totals.items() if not (
            (len(each.joints) > len(best.joints) and scores[each] > scores[best] - _SAME)
            or (each.price == _PRICE_OF_FIT and any(map(each.resembles, tried)))
        )}  # fmt: skip
        alternatives = [each for each, total in simpler.items()
                        if each != best and total < totals[best] + _ALTERNATIVE]  # fmt: skip
        rivals = [min(self._of_robot())]
        of_log, of_robot = (
            np.exp(np.clip(totals[best] - np.array(list(each)), -60.0, 60.0))
            for each in (simpler.values(), rivals)
        )
        near = sum(float(np.exp(totals[best] - totals[each])) for each in (best, *alternatives))
        everything = float(of_log.sum() + of_robot.sum())
        after = tried[best]
        largest = np.maximum(self.before, after)
        concerned = np.abs(self.before - after) > _CHANGE * largest
        remaining = float(after[concerned].sum() / max(self.before[concerned].sum(), 1e-12))
        if near < _MIN_PROBABILITY * everything or remaining * _MIN_RATIO > 1.0:
            return None
        confidence = limited(min(1.0 / everything, MAX_CONFIDENCE), float(np.sqrt(remaining)))
        found = self._explanation(best, confidence)
        others = [self._explanation(each, 0.0) for each in alternatives]
        return best, replace(found, alternatives=tuple(each.text for each in others))

    # Hypotheses

    def _groups(self) -> Iterable[Iterable[_Hypothesis]]:
        if self.has_link:
            yield self._of_angles()
            yield self._signs()
            yield self._scales()
        yield self._of_columns()
        yield self._of_torques()

    def _make(self, kind: Kind, signals: _Signals, price: float = _PRICE, *,
              order: Sequence[int] | None = None,
              factors: Array | None = None) -> _Hypothesis:  # fmt: skip
        order = range(self.n) if order is None else order
        factors = np.ones(self.n) if factors is None else factors
        return _Hypothesis(kind, signals, tuple(order), tuple(factors.tolist()), price)

    def _at(self, joints: Sequence[int] | Array, factor: float) -> Array:
        factors = np.ones(self.n)
        factors[joints] = factor
        return factors

    def _suspects(self) -> list[int]:
        # Joints whose torques differ most; a wrong column has an effect on its own joint.
        order = np.argsort(-self.before.sum(axis=0))
        return sorted(int(joint) for joint in order[:_SUSPECTS])

    def _of_angles(self) -> Iterable[_Hypothesis]:
        revolute = np.array(self.rows.robot.types) == "revolute"
        yield self._make("sign", (_ANGLES,), factors=-np.ones(self.n))
        yield self._make("scale", (_ANGLES,), factors=np.where(revolute, _DEGREES, 1.0))
        for joint in self._suspects():
            unit = _DEGREES if revolute[joint] else _MILLI
            for factor in (unit, 1.0 / unit):
                yield self._make("scale", (_ANGLES,), factors=self._at([joint], factor))

    def _signs(self) -> Iterable[_Hypothesis]:
        # The best sets of wrong signs are extended by one more joint at a time.
        suspects = self._suspects()
        beam: list[frozenset[int]] = [frozenset()]
        lowest = np.inf
        while True:
            sets = {each | {joint} for each in beam for joint in suspects if joint not in each}
            made = {
                self._make("sign", (_ANGLES,), _PRICE * len(each), factors=self._at([*each], -1.0)):
                each for each in sets
            }  # fmt: skip
            yield from made
            scores = {each: self._score(shares) for each, shares in self._judged(made).items()}
            best = sorted(scores, key=lambda each: scores[each])[:_BEAM]
            if not best or (len(made[best[0]]) > 3 and scores[best[0]] > lowest):
                return
            lowest = min(lowest, scores[best[0]])
            beam = [made[each] for each in best]

    def _scales(self) -> Iterable[_Hypothesis]:
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
        made = [self._make("scale", (_ANGLES,), _PRICE_OF_FIT, factors=self._at([j], factor))
                for j, factor in starts]  # fmt: skip
        judged = self._judged(made)
        best: dict[int, _Hypothesis] = {}
        for each in sorted(made, key=lambda each: self._score(judged[each])):
            best.setdefault(each.joints[0], each)
        joints = list(best)
        fitted = self._fitted(
            joints, [each.factors[joint] for joint, each in best.items()], self._scaled
        )
        for joint, factor in zip(joints, fitted, strict=True):
            yield self._make("scale", (_ANGLES,), _PRICE_OF_FIT,
                             factors=self._at([joint], factor))  # fmt: skip

    def _sets(self) -> list[_Signals]:
        of_torques: list[_Signals] = [(_MEASURED,)]
        if self.has_motor:
            of_torques += [(_COMMANDED,), (_MEASURED, _COMMANDED)]
        return of_torques

    def _of_columns(self) -> Iterable[_Hypothesis]:
        sets = self._sets()
        if self.has_link:
            sets += [(_ANGLES,), (_ANGLES, *sets[-1])]
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

    def _of_torques(self) -> Iterable[_Hypothesis]:
        # Factors of the torques of all joints, and joints with other signs of both torques.
        measured, commanded = self.rows.torques
        for signals in self._sets():
            if signals == (_COMMANDED,):
                factor = _median_gain(commanded, measured, self.rows.judged[1])
            elif self.has_link:
                factor = _median_gain(measured, self.model, self.rows.judged[0])
            else:
                factor = _median_gain(measured, commanded, self.rows.judged[1])
            yield self._make("sign", signals, factors=-np.ones(self.n))
            if factor and np.isfinite(factor):
                yield self._make("scale", signals, _PRICE_OF_FIT, factors=np.full(self.n, factor))
        for joint in self._suspects() if self.has_motor and self.has_link else ():
            yield self._make("sign", (_MEASURED, _COMMANDED), factors=self._at([joint], -1.0))

    # Scores

    def _models(self, motions: Sequence[Array]) -> Array:
        # Link torques of motions (3, K, n), (len(motions), K, n).
        q, v, a = np.concatenate(motions, axis=1)
        if not self.has_link:
            return np.zeros((len(motions), *motions[0].shape[1:]))
        return link_torques(self.rows.robot, q, v, a, model=self.links).reshape(
            len(motions), -1, self.n
        )

    def _judged(self, hypotheses: Iterable[_Hypothesis]) -> dict[_Hypothesis, Array]:
        # Squared shares that remain with each hypothesis.
        each_once = list(dict.fromkeys(hypotheses))
        motions: dict[tuple[object, object], int] = {}
        moved: list[Array] = []
        for each in each_once:
            key = each.order, each.factors
            if _ANGLES in each.signals and key not in motions:
                motions[key] = len(moved)
                moved.append(each.of(_ANGLES, self.rows.motion))
        models = self._models(moved) if moved else np.zeros(0)
        found = {}
        for each in each_once:
            is_moved = _ANGLES in each.signals
            model = models[motions[each.order, each.factors]] if is_moved else self.model
            measured, commanded = self.rows.torques
            torques = np.stack([each.of(_MEASURED, measured), each.of(_COMMANDED, commanded)])
            noise, order = each.of(_MEASURED, self.rows.noise), range(self.n)
            found[each] = self._shares(torques, noise, model, each.order if is_moved else order)
        return found

    def _shares(self, torques: Array, noise: Array, model: Array, order: Iterable[int]) -> Array:
        # Squared shares that remain of each joint on the link side and the motor side, (2, n).
        measured, commanded = torques
        motor = _without(commanded - measured, self.basis[[*order]])
        left = np.stack([((measured - model) ** 2).mean(axis=0), (motor**2).mean(axis=0)])
        left = np.nan_to_num(left) + noise**2
        shares = left / self._sizes(measured, np.stack([model, commanded]))
        return np.asarray(self.rows.judged * shares)

    def _sizes(self, measured: Array, others: Array) -> Array:
        # Mean squares of measured and other torques (..., K, n), (..., n).
        squares = (measured**2).mean(axis=0) + (others**2).mean(axis=-2)
        return np.asarray(squares + self.rows.floor**2)

    def _score(self, shares: Array) -> float:
        return float((np.log(shares + _EQUAL[:, None] ** 2) * self.rows.judged).sum())

    # Faults of the robot

    def _of_robot(self) -> list[float]:
        # Totals of the best faults of the robot that act during the whole run.
        measured = self.rows.torques[0]
        link = measured - self.model
        lefts = [(link, 0.0)]
        if self.has_link:
            weights = 1.0 / np.sqrt((measured**2).mean(axis=0) + self.rows.floor**2)
            weights = weights * self.rows.judged[0]
            lefts += [
                (_without_common(link, self.rows.payload, weights), _PRICE_OF_FIT),
                (_without_common(link, self.model[..., None], weights, _MAX_MASSES), _PRICE),
                (
                    _without_common(
                        link, torques_by_gravity(self.rows.robot, self.rows.motion[0]), weights
                    ),
                    _PRICE,
                ),
            ]
            offsets = self._fitted(range(self.n), np.zeros(self.n), self._shifted)
            motions = [self._shifted(joint, offset) for joint, offset in enumerate(offsets)
                       if abs(offset) < _MAX_OFFSET]  # fmt: skip
            if motions:
                lefts += [(measured - each, _PRICE) for each in self._models(motions)]
        return [price + self._of_joints(left) for left, price in lefts]

    def _of_joints(self, link: Array) -> float:
        # The score of link residuals, with gains and biases of joints that are worth their price.
        measured, commanded = self.rows.torques
        one = np.ones_like(measured)
        totals = []
        for rest, correct, price in _one_fault(link, measured - link, one, measured):
            sensed = measured if self.rows.torque_control else correct
            motor = _without(commanded - sensed, self.basis)
            others = [_without(each, self.basis) for each in (commanded, one)]
            of_link = self._log_shares(0, rest, measured - rest) + price
            for left, _, more in _one_fault(motor, others[0], others[1], motor):
                of_motor = self._log_shares(1, left, commanded) + more
                totals.append((np.stack([of_link, of_motor]) * self.rows.judged).sum(axis=0))
        return float(np.min(totals, axis=0).sum())

    def _log_shares(self, side: int, left: Array, other: Array) -> Array:
        squares = np.nan_to_num(left**2).mean(axis=0) + self.rows.noise**2
        shares = squares / self._sizes(self.rows.torques[0], other)
        return np.asarray(np.log(shares + _EQUAL[side] ** 2))

    # Fits

    def _scaled(self, joint: int, factor: float) -> Array:
        return np.asarray(self.rows.motion * self._at([joint], factor))

    def _shifted(self, joint: int, offset: float) -> Array:
        motion = self.rows.motion.copy()
        motion[0, :, joint] += offset
        return motion

    def _fitted(
        self, joints: Sequence[int], starts: Iterable[float], moved: Callable[[int, float], Array]
    ) -> list[float]:
        # The parameter of each joint's motion that fits the torques best (Gauss and Newton).
        values = np.array([*starts], float)
        measured = self.rows.torques[0]
        weights = 1.0 / ((measured**2).mean(axis=0) + self.rows.floor**2)
        for _ in range(_ROUNDS):
            if not len(values):
                break
            steps = _STEP * np.maximum(np.abs(values), _STEP)
            motions = [moved(joint, value) for joint, value in zip(joints, values, strict=True)]
            motions += [moved(joint, value)
                        for joint, value in zip(joints, values + steps, strict=True)]  # fmt: skip
            now, then = np.split(self._models(motions), 2)
            slopes = (then - now) / steps[:, None, None]
            products = (slopes * (measured - now) * weights).sum(axis=(1, 2))
            values = values + products / np.maximum((slopes**2 * weights).sum(axis=(1, 2)), 1e-12)
        return [float(value) for value in values]

    # Explanations

    def _explanation(self, it: _Hypothesis, confidence: float) -> Explanation:
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


def _one_fault(
    left: Array, gained: Array, one: Array, measured: Array
) -> Iterable[tuple[Array, Array, float]]:
    # Residuals (K, n), correct torques and price without a fault, with a gain, and with a bias.
    yield left, measured, 0.0
    squares = np.maximum((gained**2).sum(axis=0), 1e-12)
    gain = 1.0 + (left * gained).sum(axis=0) / squares
    gain = np.where(np.abs(gain) > _MIN_GAIN, gain, 1.0)
    yield left - (gain - 1.0) * gained, measured / gain, _OF_JOINT
    bias = (left * one).sum(axis=0) / np.maximum((one**2).sum(axis=0), 1e-12)
    yield left - bias * one, measured - bias, _OF_JOINT


def _median_gain(values: Array, expected: Array, judged: Array) -> float:
    # The median factor over the joints that fits values (K, n) to the expected ones.
    with np.errstate(invalid="ignore", divide="ignore"):
        gains = (values * expected).sum(axis=0) / (values**2).sum(axis=0)
    gains = gains[np.isfinite(gains) & (judged > 0)]
    return float(np.median(gains)) if len(gains) else np.nan


def _without(values: Array, basis: Array) -> Array:
    # Values (K, n) minus their parts in the span of each joint's orthonormal basis (n, K, p).
    products = np.einsum("nkp,kn->np", basis, values)
    return np.asarray(values - np.einsum("nkp,np->kn", basis, products))


def _without_common(left: Array, columns: Array, weights: Array, limit: float = np.inf) -> Array:
    # Residuals (K, n) without the best multiples of the columns (K, n, p) of all joints together.
    X = np.nan_to_num(columns * weights[:, None]).reshape(-1, columns.shape[-1])
    y = np.nan_to_num(left * weights).ravel()
    phi = np.linalg.lstsq(X, y, rcond=1e-9)[0]
    return np.asarray(left - columns @ np.clip(phi, -limit, limit))
