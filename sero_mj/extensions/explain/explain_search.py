"""`Search`: searches for the kinds and times of faults that explain a robot's residuals.

See `explain` for the effects of each kind. Each kind is fitted by linear regression between two
edges in time. With cumulative sums over rows, the cost of each pair of edges is constant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...base.frames import Array, Bools
from ...study.evidence import Evidence
from ...study.explanation import MAX_CONFIDENCE, PLACES, Explanation, Kind, Part, by_place
from .edges import Edges, Sums, SumsOfPair
from .effects import (
    MIN_SIGN,
    SHARE,
    CommonEffect,
    JointEffect,
    Size,
    common_effects,
    joint_effects,
)
from .evidence_rows import evidence_at, worst_joint
from .goodness import limited, unexplained_share
from .torque_residuals import DELAYS, TorqueResiduals, effects_of_motors

MIN_EFFECT = 5e-4  # share of the torque limit; root mean square while the fault acts
MIN_ROWS = 8  # minimum number of rows in an interval
# Noise floor as a share of the torque limit, as a share of the torque, and in s of its rate.
_FLOOR, _FLOOR_SHARE, _FLOOR_TIME = 1e-4, 1e-3, 2e-3
_MIN_SHARE = 0.08  # share of the largest effect at a joint; smaller effects are not reported
_MIN_CONFIDENCE = 0.5  # of a kind; below, torques are unexplained
_SIDES: tuple[Part, Part] = ("joint", "drive")  # parts of torques that are unexplained
_UNDECLARED = 0.8  # highest confidence of a drive fault from the start if friction is undeclared
# Gain below which a torque hardly follows what it should follow, and the highest confidence of
# this gain. A controller that compensates a large disturbance of its drive causes the same torques.
_NO_GAIN, _OF_NO_GAIN = 0.1, 0.8
_SIMILAR = 6.0  # difference of scores below which the odds are less than 20
_MIN_SCORE = 12.0  # minimum improvement over no explanation
_ROWS_PER_FACT = 2.0  # low-pass filtered rows are correlated
_MAX_PER_JOINT = 3
_MAX_COMMONS = 6  # tried effects that concern all joints, with fits of their residuals
_MAX_OF_KIND = 2  # tried effects of the same kind that concern all joints
_REFITS = 4
_TIE = 1e-3  # preference between equivalent explanations
_ROUNDS = 40
_MIN_VARIANCE = 1e-3  # of residuals in units of their standard deviations
# Minimum number of differing joints for also fitting a payload without one of them, and maximum
# number of these fits.
_MIN_JOINTS, _MAX_TRIED = 3, 2
_ROUNDS_OF_VALUES, _EXACT = 6, 0.02  # refinements, and factor minus 1 of an exact value
_RESIDUAL_RATIO = 0.1  # ratio of squared residuals below which an explanation is far better
_UNEXPLAINED = 0.002  # share of the torque limit
_MIN_PUSHED = 2  # number of joints with unexplained torques that indicates an external force


@dataclass(eq=False)
class _Fit:
    """The best explanation of the residuals of one joint, or of all joints (`joint` is -1).

    `effect` is None for unexplained torques and for undeclared friction.
    """

    joint: int
    kind: Kind
    part: Part
    effect: JointEffect | CommonEffect | None
    columns: Array  # (2, K, n, p), in units of the residuals' standard deviations
    priors: Array  # (p,)
    edges: tuple[int, int]  # in half rows, see `Edges`
    gain: float  # improvement of the score over no explanation
    parameters: Array
    errors: Array
    confidence: float = 0.0
    used: Bools | None = None  # joints used for the fit; None for all
    alternatives: tuple[str, ...] = ()  # other kinds that the data cannot exclude

    @property
    def common(self) -> CommonEffect | None:
        return self.effect if isinstance(self.effect, CommonEffect) else None

    @property
    def is_on_link(self) -> bool:
        return self.part == "joint"


class Search:
    """Searches for explanations of residuals; those with the strongest evidence come first."""

    def __init__(
        self,
        found: TorqueResiduals,
        without: Sequence[Explanation],
        noisy: Sequence[Explanation] = (),
    ) -> None:
        self.found = found
        self.n = found.robot.n
        residuals = np.stack([found.link, found.motor])
        for each in without:  # ignore the rows that are already explained
            joint = found.robot.names.index(each.joint)
            rows = found.times > each.begin - 0.15
            if each.end is not None:
                rows &= found.times < each.end + 0.15
            sides = slice(None) if each.part == "torque sensor" else 1
            residuals[sides, rows, joint] = np.nan
        still = np.maximum(_spread(residuals), _FLOOR * found.scale)
        torques = found.torques
        exerted = np.where(np.isfinite(torques.model), torques.model, torques.measured)
        moving = np.hypot(_FLOOR_SHARE * exerted, _FLOOR_TIME * torques.rates)
        self.sigma = np.hypot(still[:, None], np.nan_to_num(moving))  # (2, K, n)
        for each in noisy:  # noise is not evidence for other faults
            joint, rows = found.robot.names.index(each.joint), found.times >= each.begin
            if rows.sum() > MIN_ROWS:
                rough = _spread(residuals[:, rows])[:, joint]
                self.sigma[:, rows, joint] = np.hypot(self.sigma[:, rows, joint], rough[:, None])
        self.known = np.isfinite(residuals)
        self.y = np.where(self.known, residuals / self.sigma, 0.0)
        self.left = self.y.copy()
        self.count = np.maximum(self.known.sum(axis=(0, 1)), 1)  # (n,)
        self.facts = np.maximum(self.count / _ROWS_PER_FACT, 2.0)
        self.edges = Edges(len(found.times), found.step / found.width)
        self.undeclared = self._undeclared()
        self.fits: list[_Fit] = []
        if self.undeclared:
            self._refit()
        for _ in range(_ROUNDS):
            best = self._best()
            if best is None:
                break
            self.fits.append(best)
            self._refit()

    def _undeclared(self) -> list[_Fit]:
        # Friction and inertia of motors that are not declared are fitted along with the faults.
        found = self.found
        effects = effects_of_motors(
            found.motion, found.undeclared, torque_control=found.torque_control
        )
        fits, count = [], len(effects)
        for joint in range(self.n if effects else 0):
            X = np.zeros((*self.y.shape, count))
            scaled = np.stack([each[:, joint] for each in effects], axis=-1)
            scaled /= self.sigma[1, :, joint, None]
            known = self.known[1, :, joint, None] & np.isfinite(scaled)
            X[1, :, joint] = np.where(known, scaled, 0.0)
            zero, wide = np.zeros(count), np.full(count, SHARE * found.scale[joint])
            whole = 0, self.edges.end
            fits.append(_Fit(joint, "friction", "joint", None, X, wide, whole, 0.0, zero, zero))
        return fits

    def _joint_effects(self) -> list[JointEffect]:
        found = self.found
        true, late = found.torques.model, found.torques.late_model
        for fit in self.fits:  # sensors also measure a payload, for example
            if fit.common is not None and fit.common.side == 0:
                share = self.edges.share(*fit.edges)[:, None]
                extra = share * np.nan_to_num(fit.common.torques @ fit.parameters)
                slope = np.gradient(extra, found.step, axis=0)
                true, late = true + extra, late - DELAYS[:, None, None] * slope
        if not self.known[0].any():
            true = found.torques.commanded - found.lag + np.nan_to_num(found.motor)
        return joint_effects(found, true, late)

    def _best(self) -> _Fit | None:
        fits = self._singles()
        first = max(fits, key=lambda fit: fit.gain, default=None)
        if first is None or not self.known[0].any():
            return first
        # If a joint has its own fault, the other joints fit the common effect.
        without = [None, *range(self.n)] if len(fits) >= _MIN_JOINTS else [None]
        alternative = sum(fit.gain for fit in fits)
        tried: list[_Fit] = []
        for common, X in self._commons():
            y = self.left[common.side]
            of_joints = [(X[None, :, j], y[None, :, j]) for j in range(self.n)]
            if common.is_constant:
                pair = 0, self.edges.end
                sums: list[Sums] | list[SumsOfPair]
                sums = [self.edges.sums_of_pair(*each, pair) for each in of_joints]
            else:
                sums = [self.edges.sums(*each) for each in of_joints]
            found = [self._of_all_joints(common, X, sums, joint) for joint in without]
            tried += sorted((fit for fit in found if fit), key=lambda fit: -fit.gain)[:_MAX_TRIED]
        tried.sort(key=lambda fit: -fit.gain)
        totals = [
            (total, fit) for fit in tried[:_MAX_COMMONS]
            if (total := self._total_with(fit)) is not None
        ]  # fmt: skip
        if not totals:
            return first
        highest, best = max(totals, key=lambda each: each[0])
        if highest <= alternative:
            return first
        rivals = [(total, fit) for total, fit in totals if fit.common is not best.common]
        best.confidence = _odds([highest, alternative, *(total for total, _ in rivals)])
        best.alternatives = _similar(highest, rivals)
        return best

    def _total_with(self, common: _Fit) -> float | None:
        # The score of a common fit plus those of the fits of its residuals.
        self.fits.append(common)
        self.left -= common.columns @ common.parameters
        others = self._singles()
        self.left += common.columns @ common.parameters
        self.fits.pop()
        # A joint may be excluded because of its own fault, but not because it does not fit.
        unfit = [fit for fit in others if fit.kind == "unexplained" and fit.is_on_link
                 and common.used is not None and not common.used[fit.joint]]  # fmt: skip
        return None if unfit else common.gain + sum(fit.gain for fit in others)

    def _singles(self) -> list[_Fit]:
        candidates = self._joint_effects()
        found = [self._best_of(joint, candidates) for joint in range(self.n)]
        return [fit for fit in found if fit is not None]

    def _best_of(self, joint: int, candidates: Sequence[JointEffect]) -> _Fit | None:
        mine = [fit for fit in self.fits if fit.joint == joint]
        total = float((self.left[:, :, joint] ** 2).sum())
        highest = _evidence(total, 0.0, self.count[joint], self.facts[joint])
        if len(mine) >= _MAX_PER_JOINT or highest < _MIN_SCORE:
            return None
        fitted = {(fit.kind, fit.part) for fit in mine}
        new = [each for each in candidates if (each.kind, each.part) not in fitted]
        fits = [self._refined(joint, each) for each in new]
        fits += [self._unknown(joint, side) for side in (0, 1)]
        known = [fit for fit in fits if fit is not None]
        best = max(known, key=lambda fit: fit.gain, default=None)
        if best is None or best.gain < _MIN_SCORE or not self._matters(best):
            return None
        rivals = [fit for fit in known if (fit.kind, fit.part) != (best.kind, best.part)]
        best.confidence = _odds([best.gain, *(fit.gain for fit in rivals), 0.0])
        best.alternatives = _similar(best.gain, [(fit.gain, fit) for fit in rivals])
        return best

    def _refined(self, joint: int, candidate: JointEffect) -> _Fit | None:
        # Refines the value of an effect that is not linear in it, such as a delay.
        fit = self._fitted(joint, candidate)
        for _ in range(_ROUNDS_OF_VALUES):
            if fit is None or candidate.variants is None:
                break
            factor = float(fit.parameters[0])
            if abs(factor - 1.0) < _EXACT:
                break
            variants = candidate.variants(factor)
            fits = [self._fitted(joint, each, fit.edges) for each in variants]
            gains = [-np.inf if each is None else each.gain for each in fits]
            k = int(np.argmax(gains))
            if gains[k] <= fit.gain:
                break
            fit, candidate = fits[k], variants[k]
        return fit

    def _fitted(
        self, joint: int, candidate: JointEffect, edges: tuple[int, int] | None = None
    ) -> _Fit | None:
        columns = np.stack([np.stack([side[:, joint] for side in column])
                            for column in candidate.columns], axis=-1)  # fmt: skip
        scaled = columns / self.sigma[:, :, joint, None]
        X = np.where(self.known[:, :, joint, None] & np.isfinite(scaled), scaled, 0.0)
        y, priors = self.left[:, :, joint], candidate.priors[joint]
        if candidate.is_constant:
            edges = (0, self.edges.end)
        sums = self.edges.sums(X, y) if edges is None else self.edges.sums_of_pair(X, y, edges)
        inverse = np.diag(1.0 / priors**2)
        total, count, facts = float((y * y).sum()), self.count[joint], self.facts[joint]
        absorbed = self._absorbed(joint, X, edges)

        def scores(first: Any, last: Any) -> Array:
            H, g, rows = sums.between(first, last)
            H = H - absorbed(first, last)
            phi = np.linalg.solve(H + inverse, g[..., None])[..., 0]
            gains = 2.0 * np.einsum("kp,kp->k", g, phi) - np.einsum("kp,kpq,kq->k", phi, H, phi)
            ends = 0.0 + (np.asarray(first) > 0) + (np.asarray(last) < self.edges.end)
            if self.undeclared:  # changes are relative to the start of the recording
                ends += _TIE * (np.asarray(first) == 0)
            price = (len(priors) + ends) * np.log(facts)
            better = _evidence(total, total - np.clip(gains, 0.0, total), count, facts) - price
            return np.where(rows >= MIN_ROWS, better, -np.inf)

        if edges is None:
            first, last, gain = self.edges.best(scores)
        else:
            first, last = edges
            gain = float(scores(np.array([first]), np.array([last]))[0])
        if not gain > 0.0:
            return None
        H, g, _ = sums.between(first, last)
        parameters, errors = _solved(H, g, inverse, total, int(count))
        least = 0.0 if candidate.least is None else candidate.least[joint]
        lowest = -np.inf if candidate.lowest is None else candidate.lowest[joint]
        low, high = max(lowest, candidate.allowed[0]), candidate.allowed[1]
        if abs(parameters[0]) < least or not low < parameters[0] < high:
            return None
        whole = np.zeros((*self.y.shape, len(priors)))
        whole[:, :, joint] = X * self.edges.share(first, last)[:, None]
        return _Fit(joint, candidate.kind, candidate.part, candidate, whole, priors, (first, last),
                    gain, parameters, errors)  # fmt: skip

    def _absorbed(
        self, joint: int, X: Array, edges: tuple[int, int] | None
    ) -> Callable[[Any, Any], Any]:
        # The part of X' X between two edges that undeclared friction would explain as well.
        if not self.undeclared:
            return lambda first, last: 0.0
        N, priors = self.undeclared[joint].columns[:, :, joint], self.undeclared[joint].priors
        inverse = np.linalg.inv(np.einsum("ckp,ckq->pq", N, N) + np.diag(1.0 / priors**2))
        if edges is not None:
            one = np.einsum("ckp,ckq,k->pq", X, N, self.edges.share(*edges))
            of_pair = one @ inverse @ one.T
            return lambda first, last: of_pair
        cross = self.edges.weighted(np.einsum("ckp,ckq->kpq", X, N))

        def between(first: Any, last: Any) -> Array:
            C = cross[first] - cross[last]
            return np.asarray(C @ inverse @ np.swapaxes(C, -1, -2))

        return between

    def _unknown(self, joint: int, side: int) -> _Fit | None:
        # An arbitrary torque far above noise on one side of a joint. It has as many parameters as
        # data, so any simpler explanation is preferred.
        y = self.left[side, :, joint]
        least = _UNEXPLAINED * self.found.scale[joint] / self.sigma[side, :, joint]
        over = np.flatnonzero(np.abs(y) > np.maximum(least, 6.0))
        if not len(over) or over[-1] - over[0] < MIN_ROWS // 2:
            return None
        rows = slice(max(int(over[0]) - 2, 0), min(int(over[-1]) + 3, len(y)))
        total, facts = float((self.left[:, :, joint] ** 2).sum()), self.facts[joint]
        gain = _evidence(total, total - float((y[rows] ** 2).sum()), self.count[joint], facts)
        count = np.count_nonzero(self.known[side, rows, joint]) / _ROWS_PER_FACT
        whole = np.zeros((*self.y.shape, 1))
        whole[side, rows, joint, 0] = y[rows]
        last = self.edges.end if rows.stop >= len(y) else 2 * rows.stop
        return _Fit(joint, "unexplained", _SIDES[side], None, whole,
                    np.ones(1), (2 * rows.start, last),
                    float(gain - (count + 2.0) * np.log(facts)), np.ones(1),
                    np.array([np.nan]))  # fmt: skip

    @cached_property
    def _common_effects(self) -> list[tuple[CommonEffect, Array]]:
        # With the effects (K, n, p) in units of the residuals' standard deviations.
        effects = []
        for each in common_effects(self.found):
            scaled = each.torques / self.sigma[each.side, :, :, None]
            known = self.known[each.side][..., None] & np.isfinite(scaled)
            effects.append((each, np.where(known, scaled, 0.0)))
        return effects

    def _commons(self) -> list[tuple[CommonEffect, Array]]:
        # Trying all effects is slow, so of each kind only those are tried that explain most of the
        # whole run.
        fitted = {(fit.common.kind, fit.common.place) for fit in self.fits if fit.common}
        promising: dict[Kind, list[tuple[float, int]]] = {}
        for k, (each, X) in enumerate(self._common_effects):
            if (each.kind, each.place) in fitted:
                continue
            H = np.einsum("knp,knq->pq", X, X) + np.diag(1.0 / each.priors**2)
            g = np.einsum("knp,kn->p", X, self.left[each.side])
            promising.setdefault(each.kind, []).append((float(g @ np.linalg.solve(H, g)), k))
        best = [k for found in promising.values() for _, k in sorted(found)[-_MAX_OF_KIND:]]
        return [self._common_effects[k] for k in sorted(best)]

    def _of_all_joints(
        self, common: CommonEffect, X: Array, sums: Sequence[Sums | SumsOfPair], without: int | None
    ) -> _Fit | None:
        used = np.arange(self.n) != (-1 if without is None else without)
        inverse = np.diag(1.0 / common.priors**2)
        totals, facts = (self.left**2).sum(axis=(0, 1)), float(self.facts.sum())

        def scores(first: Any, last: Any) -> Array:
            parts = [each.between(first, last) for each in sums]
            H = np.stack([part[0] for part in parts], axis=1)  # (k, n, 10, 10)
            g = np.stack([part[1] for part in parts], axis=1)
            all_H = H[:, used].sum(axis=1)
            regular = all_H + inverse
            phi = np.linalg.solve(regular, g[:, used].sum(axis=1)[..., None])[..., 0]
            cut = 2.0 * np.einsum("knp,kp->kn", g, phi) - np.einsum("kp,knpq,kq->kn", phi, H, phi)
            count = np.trace(np.linalg.solve(regular, all_H), axis1=1, axis2=2)
            better = _evidence(totals, totals - np.minimum(cut, totals), self.count, self.facts)
            ends = 0.0 + (np.asarray(first) > 0) + (np.asarray(last) < self.edges.end)
            enough = np.asarray(last) - np.asarray(first) >= 2 * MIN_ROWS
            return np.where(enough, better.sum(axis=1) - (count + ends) * np.log(facts), -np.inf)

        if common.is_constant:
            first, last = 0, self.edges.end
            gain = float(scores(np.array([first]), np.array([last]))[0])
        else:
            first, last, gain = self.edges.best(scores)
        if not gain > _MIN_SCORE:
            return None
        parts = [
            each.between(first, last) for each, is_used in zip(sums, used, strict=True) if is_used
        ]
        H, g = (
            np.sum([part[0] for part in parts], axis=0),
            np.sum([part[1] for part in parts], axis=0),
        )
        parameters, errors = _solved(H, g, inverse, float(totals.sum()), int(self.count.sum()))
        columns = np.zeros((*self.y.shape, len(common.priors)))
        columns[common.side] = X * self.edges.share(first, last)[:, None, None]
        fit = _Fit(-1, common.kind, common.part, common, columns, common.priors, (first, last),
                   gain, parameters, errors, used=used)  # fmt: skip
        active = np.ix_(self.edges.share(first, last) > 0.5, used)
        before = float((self.left[common.side][active] ** 2).sum())
        after = float(((self.left - columns @ parameters)[common.side][active] ** 2).sum())
        if not common.allowed[0] < parameters[0] < common.allowed[1]:
            return None
        size = common.size(parameters, errors, -1)
        is_clear = abs(size.size) > max(common.min_size, 3.0 * size.error)
        return fit if is_clear and after < 0.4 * before and self._matters(fit) else None

    def _effects(self, fit: _Fit) -> Array:
        # Root mean square effect at each joint while the fault acts, of the larger side, (n,).
        effect = (fit.columns @ fit.parameters) * self.sigma
        active = self.edges.share(*fit.edges) > 0.5
        known = np.maximum(self.known[:, active].sum(axis=1), 1)
        return np.asarray(np.sqrt((effect[:, active] ** 2).sum(axis=1) / known).max(axis=0))

    def _matters(self, fit: _Fit) -> bool:
        effects = self._effects(fit)
        if fit.joint < 0:
            return bool((effects > MIN_EFFECT * self.found.scale).any())
        others = [self._effects(each)[fit.joint] for each in self.fits]
        least = MIN_EFFECT * self.found.scale[fit.joint]
        return bool(effects[fit.joint] > max([least, *(_MIN_SHARE * each for each in others)]))

    def _refit(self) -> None:
        # Fits of one joint depend on each other, so they are solved together.
        fits = [fit for fit in [*self.undeclared, *self.fits] if fit.kind != "unexplained"]
        groups = [[fit for fit in fits if fit.joint == joint] for joint in range(self.n)]
        groups += [[fit] for fit in fits if fit.joint < 0]
        groups = [group for group in groups if group]
        self._update_left()
        for _ in range(_REFITS if len(groups) > 1 else 1):
            for group in groups:
                X, priors = self._together(group)
                mine = X @ np.concatenate([fit.parameters for fit in group])
                y = (self.left + mine)[:, :, self._used_by(group)].ravel()
                X = X[:, :, self._used_by(group)].reshape(len(y), -1)
                H = X.T @ X + np.diag(1.0 / priors**2)
                solution = np.linalg.solve(H, X.T @ y)
                for fit in group:
                    fit.parameters, solution = np.split(solution, [len(fit.priors)])
                self._update_left()
        for group in groups:  # standard errors depend on the final residuals
            used = self._used_by(group)
            variance = float((self.left[:, :, used] ** 2).sum()) / int(self.count[used].sum())
            X, priors = self._together(group)
            X = X.reshape(-1, X.shape[-1])
            covariance = np.linalg.inv(X.T @ X + np.diag(1.0 / priors**2))
            scale = _ROWS_PER_FACT * max(variance, _MIN_VARIANCE)
            errors = np.sqrt(np.diag(covariance) * scale)
            for fit in group:
                fit.errors, errors = np.split(errors, [len(fit.priors)])

    def _together(self, group: Sequence[_Fit]) -> tuple[Array, Array]:
        columns = np.concatenate([fit.columns for fit in group], axis=-1)
        return columns, np.concatenate([fit.priors for fit in group])

    def _used_by(self, group: Sequence[_Fit]) -> Bools:
        if group[0].joint >= 0:
            return np.asarray(np.arange(self.n) == group[0].joint)
        return np.ones(self.n, bool) if group[0].used is None else group[0].used

    def _update_left(self) -> None:
        self.left = self.y.copy()
        for fit in [*self.undeclared, *self.fits]:
            self.left -= fit.columns @ fit.parameters

    def _unexplained_share(self, fit: _Fit) -> float:
        others = [each for each in [*self.undeclared, *self.fits] if each is not fit
                  and each.kind != "unexplained"]  # fmt: skip
        y = self.y - sum((each.columns @ each.parameters for each in others), np.zeros_like(self.y))
        used = np.arange(self.n) == fit.joint
        if fit.joint < 0:
            used = self._effects(fit) > MIN_EFFECT * self.found.scale
            used = used & (True if fit.used is None else fit.used)
        rows = self.edges.share(*fit.edges) > 0.5
        sides = (fit.columns[:, :, used] != 0.0).any(axis=(1, 2, 3))
        y, X = y[np.ix_(sides, rows, used)], fit.columns[np.ix_(sides, rows, used)]
        y, X = np.moveaxis(y, 1, -1), np.moveaxis(X, 1, -2)  # rows last
        return unexplained_share(
            y.reshape(-1, y.shape[-1]), X.reshape(-1, *X.shape[-2:]), fit.priors
        )

    def _ratio(self, fit: _Fit) -> float:
        # Size of a fit relative to the largest one, at the joint where it is largest.
        effects = np.stack([self._effects(each) for each in self.fits])
        largest = np.maximum(effects.max(axis=0), 1e-12)
        return float((self._effects(fit) / largest).max())

    def explanations(self, more: Sequence[Explanation]) -> list[Explanation]:
        """Returns all explanations and `more`, joint by joint, in descending order of size."""
        fits = [fit for fit in self.fits if self._is_large(fit) and not self._is_of_contact(fit)]
        fits.sort(key=lambda fit: -float(self._effects(fit).max()))
        found = [*more, *_one_per_side([self._explanation(fit) for fit in fits])]
        found.sort(key=lambda each: each.kind == "noise")  # last, as vibrations also cause noise
        return by_place(found, self.found.robot.names)

    def explains(self, sign: Explanation) -> bool:
        """Whether another explanation is better than a drive with a wrong sign.

        The other explanation must fit far better, or also apply before or after the wrong sign.
        """
        found, joint = self.found, self.found.robot.names.index(sign.joint)
        end = np.inf if sign.end is None else sign.end
        during = (found.times >= sign.begin) & (found.times <= end)
        known = self.known[1, :, joint]
        rows = known & during
        before, after = ((each[1, rows, joint] ** 2).sum() for each in (self.y, self.left))
        twice = 2.0 * found.torques.commanded[rows, joint] / self.sigma[1, rows, joint]
        by_sign = ((self.y[1, rows, joint] - twice) ** 2).sum()
        # With joint torque control, the commanded torque is not that of the motor.
        is_far_better = not found.torque_control and after < _RESIDUAL_RATIO * by_sign
        for fit in self.fits:
            is_sign = fit.kind == "gain" and abs(fit.parameters[0]) > MIN_SIGN
            if fit.joint != joint or fit.kind == "unexplained" or is_sign:
                continue
            acts = known & (self.edges.share(*fit.edges) > 0.5)
            acts &= np.abs(fit.columns[1, :, joint]).sum(axis=-1) > 0.0
            count = int((acts & during).sum())
            lasts = (acts & ~during).sum() >= max(MIN_ROWS, count)
            if not rows.any():  # too close to the end for the low-pass filter
                if lasts and fit.edges[1] >= self.edges.end:
                    return True
            elif count and after < _RESIDUAL_RATIO * before and (lasts or is_far_better):
                return True
        return False

    def _is_large(self, fit: _Fit) -> bool:
        if fit.joint < 0:
            return True
        effects = [float(self._effects(each)[fit.joint]) for each in self.fits]
        return float(self._effects(fit)[fit.joint]) > _MIN_SHARE * max(effects)

    def _is_of_contact(self, fit: _Fit) -> bool:
        # A sensor appears wrong, but a contact pushes other joints more.
        if fit.kind == "unexplained" or fit.joint < 0 or fit.part != "torque sensor":
            return False
        first, last = fit.edges
        size = float((self._effects(fit) / self.found.scale)[fit.joint])
        pushed = {
            other.joint
            for other in self.fits
            if other.kind == "unexplained" and other.is_on_link and other.joint != fit.joint
            and min(other.edges[1], last) - max(other.edges[0], first) > 0.5 * (last - first)
            and (self._effects(other) / self.found.scale)[other.joint] > size
        }  # fmt: skip
        return len(pushed) >= _MIN_PUSHED

    def _explanation(self, fit: _Fit) -> Explanation:
        found, names = self.found, self.found.robot.names
        affected = self._effects(fit) > MIN_EFFECT * found.scale
        joints = np.array(names)[affected].tolist() if fit.joint < 0 else [names[fit.joint]]
        is_revolute = fit.joint < 0 or found.robot.types[fit.joint] == "revolute"
        kind, part, confidence = fit.kind, fit.part, fit.confidence
        alternatives = fit.alternatives
        place = names[fit.joint] if fit.common is None else fit.common.place
        if kind == "gain" and abs(float(fit.parameters[0])) > MIN_SIGN:
            kind = "sign"
        if fit.effect is not None:
            size = fit.effect.size(fit.parameters, fit.errors, fit.joint)
            confidence = limited(confidence, self._unexplained_share(fit), self._ratio(fit))
            if self.undeclared and fit.edges == (0, self.edges.end) and not fit.columns[0].any():
                confidence = min(confidence, _UNDECLARED)
            if kind == "gain" and size.size < _NO_GAIN:
                confidence = min(confidence, _OF_NO_GAIN)
        torques = (fit.columns @ fit.parameters) * self.sigma
        evidence = self._evidence(fit, torques)
        if fit.effect is None or confidence < _MIN_CONFIDENCE:
            side, row, joint = np.unravel_index(np.argmax(np.abs(torques)), torques.shape)
            size, place = Size(float(torques[side, row, joint]), np.nan, "Nm"), names[joint]
            if fit.effect is not None:
                alternatives = (_name(fit), *alternatives)
                kind, part, confidence = "unexplained", _SIDES[side], 1.0 - confidence
                confidence = min(confidence, MAX_CONFIDENCE)
        unit = "N" if size.unit == "Nm" and not is_revolute else size.unit
        first, last = fit.edges
        return Explanation(
            place, kind, part, size.size, unit, size.error,
            confidence, float(found.times[0] + 0.5 * first * found.step),
            None if last >= self.edges.end else float(found.times[0] + 0.5 * last * found.step),
            first == 0, size.values, tuple(joints),
            alternatives=tuple(dict.fromkeys(each for each in alternatives if each != kind)),
            evidence=evidence,
        )  # fmt: skip

    def _evidence(self, fit: _Fit, torques: Array) -> Evidence:
        # At the joint and side with the largest torques (2, K, n) of a fit.
        side, joint = worst_joint(torques, self.found.scale)
        rows = self.known[side, :, joint]
        left = np.where(rows, (self.left * self.sigma)[side, :, joint], np.nan)
        before = left + torques[side, :, joint]
        after = before if fit.effect is None else left  # unexplained torques remain
        return evidence_at(self.found, joint, side, before, after, fit.kind, fit.part)


def _spread(residuals: Array) -> Array:
    # Robust standard deviation from changes between rows, independent of slow changes, (2, n).
    steps = np.abs(np.diff(residuals, axis=1))
    result = np.zeros((2, residuals.shape[2]))
    for side, joint in np.ndindex(result.shape):
        known = steps[side, :, joint][np.isfinite(steps[side, :, joint])]
        if len(known):
            result[side, joint] = np.median(known) / 0.6745 / np.sqrt(2.0)
    return result


def _evidence(before: Any, after: Any, count: Any, facts: Any) -> Any:
    # Twice the logarithm of the likelihood ratio of two sums of squares, both with added noise.
    return facts * (np.log1p(before / count) - np.log1p(np.maximum(after, 0.0) / count))


def _solved(H: Array, g: Array, inverse: Array, total: float, count: int) -> tuple[Array, Array]:
    covariance = np.linalg.inv(H + inverse)
    parameters = covariance @ g
    rest = total - float(2.0 * g @ parameters - parameters @ H @ parameters)
    variance = _ROWS_PER_FACT * max(rest / count, _MIN_VARIANCE)
    return parameters, np.sqrt(np.diag(covariance) * variance)


def _similar(score: float, rivals: Sequence[tuple[float, _Fit]]) -> tuple[str, ...]:
    # Names of other explanations with almost the same score, the best first.
    ordered = sorted(rivals, key=lambda each: -each[0])
    return tuple(dict.fromkeys(_name(fit) for each, fit in ordered if score - each < _SIMILAR))


def _name(fit: _Fit) -> str:
    if fit.effect is None:
        return fit.kind
    if fit.common is not None and fit.common.place not in PLACES:
        return f"{fit.kind} at {fit.common.place}"
    return f"{fit.kind} of the {fit.part}"


def _one_per_side(explanations: Sequence[Explanation]) -> list[Explanation]:
    # Several unexplained torques of a joint are one, with the time of all.
    found: dict[tuple[str, str, str, int], Explanation] = {}
    for k, each in enumerate(explanations):
        is_known = each.kind != "unexplained"
        key = each.joint, each.kind, each.part, k if is_known else -1
        other = found.get(key)
        if other is None:
            found[key] = each
            continue
        first, second = sorted((each, other), key=lambda one: -abs(one.size))
        ends = [one.end for one in (first, second)]
        found[key] = replace(
            first,
            begin=min(first.begin, second.begin),
            end=None if None in ends else max(end for end in ends if end is not None),
            from_start=first.from_start or second.from_start,
            joints=tuple(dict.fromkeys((*first.joints, *second.joints))),
            alternatives=tuple(dict.fromkeys((*first.alternatives, *second.alternatives))),
        )
    return list(found.values())


def _odds(scores: Sequence[float]) -> float:
    # Probability of the first explanation by the scores of all.
    differences = np.minimum(np.asarray(scores[1:], np.float64) - scores[0], 60.0)
    return min(float(1.0 / (1.0 + np.exp(0.5 * differences).sum())), MAX_CONFIDENCE)
