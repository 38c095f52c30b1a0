"""Physically consistent parameters of links that fit identified base parameters.

A rigid body can have the `PARAMETERS` if and only if its pseudo-inertia matrix

    P = [S h; h^T m] with S = trace(I)/2 - I

is positive definite. The excited combinations of the parameters follow from the torques. All other
combinations stay close to declared or estimated links, by the Bregman divergence of -log det P.
The sum of both is convex, and infinite for inconsistent links. Newton's method minimizes it.

A link that differs much from its prior, such as one with a payload, gets a smaller weight.

Sources: Wensing, Kim, Slotine, Linear matrix inequalities for physically-consistent inertial
parameter identification, IEEE RA-L 3(1), 2018. Lee, Wensing, Park, Geometric robot dynamic
identification: a convex programming approach, IEEE T-RO 36(2), 2020 (entropic divergence).
"""

from __future__ import annotations

import numpy as np

from ....base.frames import Array

_MAX_STEPS = 60
_STEP = 0.15  # logarithm of the ratio of weights along the path
_TO_BOUNDARY = 0.5  # share of the way to the boundary of consistent links in one step
_ROUNDS, _LOOSE, _CLOSE = 3, 0.01, 4.0  # reweighting; first weight; small divergence
_CONVERGED = 1e-6  # squared Newton decrement
_MIN_MOMENT = 1e-6  # smallest eigenvalue of a prior pseudo-inertia, relative to the largest


def _basis() -> Array:
    # The pseudo-inertia of a unit of each parameter, (10, 4, 4).
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    for axis in range(3):
        basis[1 + axis, axis, 3] = basis[1 + axis, 3, axis] = 1.0
        basis[4 + axis, :3, :3] = 0.5 * np.eye(3)
        basis[4 + axis, axis, axis] -= 1.0
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        basis[7 + k, i, j] = basis[7 + k, j, i] = -1.0
    return basis


def _symmetric() -> Array:
    # An orthonormal basis of the symmetric matrices, (10, 4, 4).
    basis = np.zeros((10, 4, 4))
    for k, (i, j) in enumerate(zip(*np.triu_indices(4), strict=True)):
        basis[k, i, j] = basis[k, j, i] = 1.0 if i == j else np.sqrt(0.5)
    return basis


_BASIS, _SYMMETRIC = _basis(), _symmetric()


def pseudo_inertias(parameters: Array) -> Array:
    """Returns the pseudo-inertia matrices of n links with `PARAMETERS` (10 n,), (n, 4, 4)."""
    return np.asarray(np.einsum("nk,kij->nij", parameters.reshape(-1, 10), _BASIS))


def consistent_parameters(
    prior: Array, combination: Array, values: Array, information: Array, weight: float
) -> Array:
    """Returns consistent standard parameters that fit base parameters, shape (10 n,).

    Args:
        prior: declared or estimated standard parameters, shape (10 n,).
        combination: matrix that maps standard to base parameters, shape (b, 10 n).
        values: base parameters, shape (b,).
        information: inverse covariance of `values`, shape (b, b), which may be singular.
        weight: weight of the divergence from the prior, about the inverse square of the relative
            error of the prior.
    """
    P0 = _definite(pseudo_inertias(prior))
    fit = _Fit(combination, values, information, np.asarray(np.linalg.inv(P0)))
    L, weights = np.asarray(np.linalg.cholesky(P0)), np.full(len(P0), _LOOSE * weight)
    # From the prior along the central path, as interior-point methods do. It starts where the data
    # hardly move the links away from the prior.
    pull = float(np.linalg.norm(fit.slopes(L, np.zeros(len(P0)))[1]))
    before = np.full(len(P0), max(weight, pull))
    for _ in range(_ROUNDS):
        L = _along(L, fit, before, weights)
        before, weights = weights, weight / np.maximum(fit.divergences(L) / _CLOSE, 1.0)
    return _parameters_of(_square(L))


class _Fit:
    # Links have factors L (n, 4, 4) of P = L L^T, which do not lose the precision of small
    # eigenvalues.
    def __init__(
        self, combination: Array, values: Array, information: Array, inverse: Array
    ) -> None:
        sizes, axes = np.linalg.eigh(information)
        root = np.sqrt(np.maximum(sizes, 0.0))[:, None] * axes.T
        self.A, self.b, self.inverse = root @ combination, root @ values, inverse
        self._offset = np.linalg.slogdet(inverse)[1] + 4.0

    def divergences(self, L: Array) -> Array:
        """Returns the divergence of each link from its prior, shape (n,)."""
        distances = np.einsum("nij,nji->n", self.inverse, _square(L))
        size = 2.0 * np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
        return np.asarray(distances - size - self._offset)

    def cost(self, L: Array, weights: Array) -> float:
        left = self.A @ _parameters_of(_square(L)) - self.b
        return float(0.5 * left @ left + weights @ self.divergences(L))

    def slopes(self, L: Array, weights: Array) -> tuple[Array, Array]:
        """Returns A (b, 10 n) and the gradient (10 n,) in the coordinates X of L (1 + X) L^T."""
        n = len(weights)
        changes = L[:, None] @ _SYMMETRIC @ np.swapaxes(L, 1, 2)[:, None]
        T = np.stack([_parameters_of(each).reshape(10, 10).T for each in changes])
        traces = np.trace(_SYMMETRIC, axis1=1, axis2=2)
        slopes = np.einsum("nij,nkji->nk", self.inverse, changes) - traces
        A = np.einsum("bni,nij->bnj", self.A.reshape(-1, n, 10), T).reshape(-1, 10 * n)
        left = self.A @ _parameters_of(_square(L)) - self.b
        return A, A.T @ left + (weights[:, None] * slopes).ravel()

    def newton_step(self, L: Array, weights: Array) -> tuple[Array, float]:
        """Returns X (n, 4, 4) of the step to L (1 + X) L^T, and the rate of decrease along it."""
        A, gradient = self.slopes(L, weights)
        step = -np.linalg.solve(A.T @ A + np.diag(np.repeat(weights, 10)), gradient)
        X = np.einsum("nk,kij->nij", step.reshape(-1, 10), _SYMMETRIC)
        return X, float(-gradient @ step)


def _along(L: Array, fit: _Fit, before: Array, after: Array) -> Array:
    # The minimum with other weights, in small steps.
    ratios = np.log(after / before)
    for share in np.linspace(0.0, 1.0, int(np.ceil(np.abs(ratios).max() / _STEP)) + 1)[1:]:
        L = _minimum(L, fit, before * np.exp(share * ratios))
    return L


def _minimum(L: Array, fit: _Fit, weights: Array) -> Array:
    # Newton's method with backtracking.
    now = fit.cost(L, weights)
    for _ in range(_MAX_STEPS):
        X, rate = fit.newton_step(L, weights)
        if rate < _CONVERGED * weights.max():
            break
        lowest = float(np.linalg.eigvalsh(X).min())
        size, rounding = min(1.0, _TO_BOUNDARY / max(-lowest, 1e-300)), 1e-11 * abs(now)
        while size > 1e-9:
            after = L @ np.linalg.cholesky(np.eye(4) + size * X)
            cost = fit.cost(after, weights)
            if cost <= now - 0.1 * size * rate + rounding:
                break
            size *= 0.5
        else:
            break
        L, now = after, cost
    return L


def _square(L: Array) -> Array:
    return np.asarray(L @ np.swapaxes(L, 1, 2))


def _definite(P: Array) -> Array:
    # Pseudo-inertias of flat or massless links, which are at the bound of what is consistent.
    moments, axes = np.linalg.eigh(P)
    moments = np.maximum(moments, _MIN_MOMENT * np.maximum(moments[:, -1:], 1e-9))
    return np.asarray((axes * moments[:, None]) @ np.swapaxes(axes, 1, 2))


def _parameters_of(P: Array) -> Array:
    # Standard parameters (10 n,) of pseudo-inertias (n, 4, 4).
    S = P[:, :3, :3]
    tensors = np.einsum("nii->n", S)[:, None, None] * np.eye(3) - S
    entries = tensors[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.concatenate([P[:, 3, 3:], P[:, :3, 3], entries], axis=1).ravel()
