"""Linear regression with standard errors for autocorrelated residuals.

Sources: Newey, West, A simple, positive semi-definite, heteroskedasticity and autocorrelation
consistent covariance matrix, Econometrica 55(3), 1987. Kiefer, Vogelsang, A new asymptotic theory
for heteroskedasticity-autocorrelation robust tests, Econometric Theory 21(6), 2005 (bias of these
errors in short runs). Belsley, Kuh, Welsch, Regression Diagnostics, 1980 (condition number of
scaled columns, variance inflation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...base.frames import Array

_MAX_INFLATION = 3000.0
_LAGS = 1.3  # number of lags per square root of the number of rows


@dataclass(frozen=True)
class Estimate:
    """An estimate in SI units with its standard error, or the reason why it is not identifiable."""

    value: float | None
    error: float | None = None
    reason: str | None = None

    def __str__(self) -> str:
        if self.value is None or self.error is None:
            return "-"
        digits = max(0, min(6, int(np.ceil(-np.log10(max(self.error, 1e-12)))) + 1))
        return f"{self.value + 0.0:.{digits}f} ± {self.error:.1g}"


@dataclass(frozen=True, eq=False)
class Regression:
    """The result of a least-squares fit with p parameters.

    Attributes:
        values: parameters, shape (p,).
        covariance: covariance of the parameters, shape (p, p).
        inflation: ratio of the variance of each parameter to that of an uncorrelated estimate,
            shape (p,); infinite for linearly dependent columns.
    """

    values: Array
    covariance: Array
    inflation: Array

    def estimates(self, reason: str, max_inflation: float = _MAX_INFLATION) -> list[Estimate]:
        """Returns the estimates, and `reason` for those that are not identifiable."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return [
            Estimate(float(value), float(error))
            if each < max_inflation
            else Estimate(None, None, reason)
            for value, error, each in zip(self.values, errors, self.inflation, strict=True)
        ]


def regression(
    X: Array, y: Array, priors: Array | float = 0.0, drift: Array | None = None
) -> Regression:
    """Fits parameters to s series at K times by least squares.

    The errors of a series at different times, and of different series, may be correlated.

    Args:
        X: columns, shape (K, s, p), zero if unknown.
        y: data, shape (K, s), zero if unknown.
        priors: inverse prior variances of the parameters, shape (p,), in units of the residuals.
        drift: change of the data by the standard deviation of the unknown delay between `X` and
            `y`, shape (K, s).
    """
    flat = X.reshape(-1, X.shape[2])
    H = flat.T @ flat + np.diag(np.broadcast_to(priors, X.shape[2]))
    scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
    inverse = np.linalg.pinv(H / np.outer(scale, scale), rcond=1e-13, hermitian=True)
    inflation = np.diag(inverse).copy()
    inverse = inverse / np.outer(scale, scale)
    # Linearly dependent columns have an infinite inflation.
    resolved = np.diag(inverse @ H)
    inflation[(resolved < 0.999) | (scale < 1e-9)] = np.inf
    values = inverse @ (flat.T @ y.ravel())
    scores = np.einsum("ksp,ks->kp", X, y - X @ values)
    used = int((X != 0.0).any(axis=(1, 2)).sum())
    S = scores.T @ scores
    lags = max(int(np.ceil(_LAGS * np.sqrt(used))), 4)
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        share = 1.0 - lag / (lags + 1.0)
        part = scores[lag:].T @ scores[:-lag]
        S += share * (part + part.T)
    facts = used * y.shape[1]
    S *= facts / max(facts - len(values), 1) * _short_run_factor(lags / max(used, 1)) ** 2
    covariance = inverse @ S @ inverse
    if drift is not None:
        shift = inverse @ (flat.T @ drift.ravel())
        covariance = covariance + np.outer(shift, shift)
    return Regression(values, covariance, inflation)


def condition_number(X: Array) -> float:
    """Returns the condition number of columns (K, p) scaled to length 1; infinite if one is 0."""
    lengths = np.linalg.norm(X, axis=0)
    if not len(X) or not (lengths > 0).all():
        return np.inf
    return float(np.linalg.cond(X / lengths))


def _short_run_factor(share: float) -> float:
    # The residuals of a fit underestimate sums of autocovariances over a share of the run.
    # Kiefer and Vogelsang 2005, table 1: quantile of 97.5 %, which is 1.96 for long runs.
    b = min(share, 1.0)
    return (1.96 + 2.9694 * b + 0.416 * b**2 - 0.5324 * b**3) / 1.96
