"""`unexplained_share` and `limited`: whether an explanation is good enough, not only the best one.

The odds of an explanation compare it with the other kinds of faults. If the true cause is not among
them, the best kind still has high odds. Its parameters then differ between parts of the recording,
and the torques of one part do not predict those of another one. So each explanation is fitted to
all parts but one, and its error is measured on that part (cross-validation).

Source: Stone, Cross-validatory choice and assessment of statistical predictions, Journal of the
Royal Statistical Society B 36(2), 1974.
"""

from __future__ import annotations

import numpy as np

from ...base.frames import Array, Bools

_FOLDS = 5
_NOISE = 2.0  # mean square of residuals that is attributed to noise, in squared standard deviations
_OF_SMALL, _LARGE = 0.6, 0.5  # highest confidence of a tiny fault; ratio without a limit
# Shares of the torque that remain unexplained, and the highest confidence with each.
_SHARES = (0.0, 0.03, 0.06, 0.1, 0.2, 0.35, 0.5, 1.0)
_CONFIDENCES = (0.99, 0.99, 0.92, 0.8, 0.65, 0.5, 0.3, 0.0)


def unexplained_share(y: Array, X: Array, priors: Array) -> float:
    """Returns the share of residuals that a fault does not predict, from 0 to 1.

    Args:
        y: residuals while the fault acts, shape (c, K), in standard deviations; 0 if unknown.
        X: effects of the fault's parameters on the residuals, shape (c, K, p).
        priors: prior standard deviations of the parameters, shape (p,).
    """
    rows = y.shape[1]
    before = float((y * y).sum())
    folds = np.arange(rows) * _FOLDS // max(rows, 1)
    count = int(np.count_nonzero(y))
    after = 0.0
    for fold in range(_FOLDS):
        held: Bools = folds == fold
        rest = ~held
        H = np.einsum("ckp,ckq->pq", X[:, rest], X[:, rest]) + np.diag(1.0 / priors**2)
        phi = np.linalg.solve(H, np.einsum("ckp,ck->p", X[:, rest], y[:, rest]))
        after += float(((y[:, held] - X[:, held] @ phi) ** 2).sum())
    excess = max(after - _NOISE * count, 0.0)
    return min(np.sqrt(excess / before), 1.0) if before > 0.0 else 0.0


def limited(confidence: float, share: float, ratio: float = 1.0) -> float:
    """Returns a confidence, limited by what the explanation achieves.

    Args:
        confidence: confidence from the odds against other causes.
        share: share of torque that remains unexplained, from 0 to 1.
        ratio: size relative to the largest explanation at the same joint, from 0 to 1. What an
            inexact larger explanation leaves may resemble a small fault.
    """
    by_ratio = _OF_SMALL + (1.0 - _OF_SMALL) * ratio / _LARGE
    return min(confidence, float(np.interp(share, _SHARES, _CONFIDENCES)), by_ratio)
