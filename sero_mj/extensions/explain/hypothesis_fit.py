"""`HypothesisFit`: what hypotheses about a recording leave unexplained of its torques."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ...base.frames import Array
from .link_torques import link_model, link_torques
from .recorded_rows import ANGLES, COMMANDED, MEASURED, Hypothesis, RecordedRows

# Remaining shares (link and motor side) below which hypotheses are equally good.
EQUAL = np.array([0.005, 0.03])
_ROUNDS, _STEP = 6, 1e-3  # of a fitted factor or offset


class HypothesisFit:
    """Compares the torques of a few rows with the models of both sides.

    Attributes:
        rows: the rows.
        n: number of joints.
        has_link: whether the link side is judged.
        has_motor: whether the motor side is judged.
        basis: orthonormal basis of the torques of motor inertia and friction, shape (n, K, 3).
        model: link torques of the recorded motion, shape (K, n).
        before: squared shares that remain without a hypothesis, shape (2, n).
    """

    def __init__(self, rows: RecordedRows) -> None:
        self.rows, self.n = rows, rows.robot.n
        self.has_link, self.has_motor = (bool(side.any()) for side in rows.judged)
        self._links = link_model(rows.robot)
        self.basis = np.linalg.qr(np.moveaxis(rows.motor, 1, 0))[0]
        self.model = self.models([rows.motion])[0]
        self.before = self._shares(rows.torques, rows.noise, self.model, range(self.n))

    def models(self, motions: Sequence[Array]) -> Array:
        """Returns link torques of M motions, shape (3, K, n) each; shape (M, K, n)."""
        q, v, a = np.concatenate(motions, axis=1)
        if not self.has_link:
            return np.zeros((len(motions), *motions[0].shape[1:]))
        return link_torques(self.rows.robot, q, v, a, model=self._links).reshape(
            len(motions), -1, self.n
        )

    def judged(self, hypotheses: Iterable[Hypothesis]) -> dict[Hypothesis, Array]:
        """Returns squared shares, shape (2, n), that remain with each hypothesis."""
        each_once = list(dict.fromkeys(hypotheses))
        motions: dict[tuple[object, object], int] = {}
        moved: list[Array] = []
        for each in each_once:
            key = each.order, each.factors
            if ANGLES in each.signals and key not in motions:
                motions[key] = len(moved)
                moved.append(each.of(ANGLES, self.rows.motion))
        models = self.models(moved) if moved else np.zeros(0)
        found = {}
        for each in each_once:
            is_moved = ANGLES in each.signals
            model = models[motions[each.order, each.factors]] if is_moved else self.model
            measured, commanded = self.rows.torques
            torques = np.stack([each.of(MEASURED, measured), each.of(COMMANDED, commanded)])
            noise, order = each.of(MEASURED, self.rows.noise), range(self.n)
            found[each] = self._shares(torques, noise, model, each.order if is_moved else order)
        return found

    def _shares(self, torques: Array, noise: Array, model: Array, order: Iterable[int]) -> Array:
        # Squared shares that remain of each joint on the link side and the motor side, (2, n).
        measured, commanded = torques
        motor = without(commanded - measured, self.basis[[*order]])
        left = np.stack([((measured - model) ** 2).mean(axis=0), (motor**2).mean(axis=0)])
        left = np.nan_to_num(left) + noise**2
        shares = left / self.sizes(measured, np.stack([model, commanded]))
        return np.asarray(self.rows.judged * shares)

    def sizes(self, measured: Array, others: Array) -> Array:
        """Returns mean squares of measured and other torques, shape (..., K, n); (..., n)."""
        squares = (measured**2).mean(axis=0) + (others**2).mean(axis=-2)
        return np.asarray(squares + self.rows.floor**2)

    def score(self, shares: Array) -> float:
        """Returns the score of squared shares, shape (2, n); less is better."""
        return float((np.log(shares + EQUAL[:, None] ** 2) * self.rows.judged).sum())

    def at(self, joints: Sequence[int] | Array, factor: float) -> Array:
        """Returns factors of the joints, shape (n,), which are 1 except at `joints`."""
        factors = np.ones(self.n)
        factors[joints] = factor
        return factors

    def scaled(self, joint: int, factor: float) -> Array:
        """Returns the motion, shape (3, K, n), with one joint multiplied by a factor."""
        return np.asarray(self.rows.motion * self.at([joint], factor))

    def shifted(self, joint: int, offset: float) -> Array:
        """Returns the motion, shape (3, K, n), with an offset of one angle."""
        motion = self.rows.motion.copy()
        motion[0, :, joint] += offset
        return motion

    def fitted(
        self, joints: Sequence[int], starts: Iterable[float], moved: Callable[[int, float], Array]
    ) -> list[float]:
        """Returns the parameter of each joint's motion with the best fit (Gauss-Newton).

        Args:
            joints: indices of the joints.
            starts: start values of the parameters.
            moved: function that returns the motion for a joint and its parameter.
        """
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
            now, then = np.split(self.models(motions), 2)
            slopes = (then - now) / steps[:, None, None]
            products = (slopes * (measured - now) * weights).sum(axis=(1, 2))
            values = values + products / np.maximum((slopes**2 * weights).sum(axis=(1, 2)), 1e-12)
        return [float(value) for value in values]


def without(values: Array, basis: Array) -> Array:
    """Returns values (K, n) without their parts in each joint's orthonormal basis (n, K, p)."""
    products = np.einsum("nkp,kn->np", basis, values)
    return np.asarray(values - np.einsum("nkp,np->kn", basis, products))
