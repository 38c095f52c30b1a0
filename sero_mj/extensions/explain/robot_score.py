"""`robot_score`: the best score of faults of the robot that act during the whole run.

They compete with faults of the log. `Search` examines them later in all rows; here, they are fitted
to the few rows of `HypothesisFit`, which also contain angles far from the correct ones.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...base.frames import Array
from .hypothesis_fit import EQUAL, HypothesisFit, without
from .link_torques import torques_by_gravity

# Prices of a fault, of a fault with fitted parameters, and of a fault of one joint, in units of the
# score.
PRICE, PRICE_OF_FIT, _OF_JOINT = 2.0, 3.0, 3.0
_MAX_OFFSET, _MAX_MASSES, _MIN_GAIN = 0.5, 0.5, 0.05  # rad or m; shares


def robot_score(fit: HypothesisFit) -> float:
    """Returns the total score and price of the best fault of the robot; less is better."""
    measured = fit.rows.torques[0]
    link = measured - fit.model
    lefts = [(link, 0.0)]
    if fit.has_link:
        weights = 1.0 / np.sqrt((measured**2).mean(axis=0) + fit.rows.floor**2)
        weights = weights * fit.rows.judged[0]
        lefts += [
            (_without_common(link, fit.rows.payload, weights), PRICE_OF_FIT),
            (_without_common(link, fit.model[..., None], weights, _MAX_MASSES), PRICE),
            (
                _without_common(
                    link, torques_by_gravity(fit.rows.robot, fit.rows.motion[0]), weights
                ),
                PRICE,
            ),
        ]
        offsets = fit.fitted(range(fit.n), np.zeros(fit.n), fit.shifted)
        motions = [fit.shifted(joint, offset) for joint, offset in enumerate(offsets)
                   if abs(offset) < _MAX_OFFSET]  # fmt: skip
        if motions:
            lefts += [(measured - each, PRICE) for each in fit.models(motions)]
    return min(price + _of_joints(fit, left) for left, price in lefts)


def _of_joints(fit: HypothesisFit, link: Array) -> float:
    # The score of link residuals, with gains and biases of joints that are worth their price.
    measured, commanded = fit.rows.torques
    one = np.ones_like(measured)
    totals = []
    for rest, correct, price in _one_fault(link, measured - link, one, measured):
        sensed = measured if fit.rows.torque_control else correct
        motor = without(commanded - sensed, fit.basis)
        others = [without(each, fit.basis) for each in (commanded, one)]
        of_link = _log_shares(fit, 0, rest, measured - rest) + price
        for left, _, more in _one_fault(motor, others[0], others[1], motor):
            of_motor = _log_shares(fit, 1, left, commanded) + more
            totals.append((np.stack([of_link, of_motor]) * fit.rows.judged).sum(axis=0))
    return float(np.min(totals, axis=0).sum())


def _log_shares(fit: HypothesisFit, side: int, left: Array, other: Array) -> Array:
    squares = np.nan_to_num(left**2).mean(axis=0) + fit.rows.noise**2
    shares = squares / fit.sizes(fit.rows.torques[0], other)
    return np.asarray(np.log(shares + EQUAL[side] ** 2))


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


def _without_common(left: Array, columns: Array, weights: Array, limit: float = np.inf) -> Array:
    # Residuals (K, n) without the best multiples of the columns (K, n, p) of all joints together.
    X = np.nan_to_num(columns * weights[:, None]).reshape(-1, columns.shape[-1])
    y = np.nan_to_num(left * weights).ravel()
    phi = np.linalg.lstsq(X, y, rcond=1e-9)[0]
    return np.asarray(left - columns @ np.clip(phi, -limit, limit))
