"""`Edges`: sums over the time between any two edges, for the begin and end of a fault."""

from __future__ import annotations

from dataclasses import dataclass
from math import erf
from typing import Any

import numpy as np

from ...base.frames import Array

_erf = np.vectorize(erf)
_GRID, _ROUNDS = 18, 3  # edges of the first pairs that are tried, and rounds of refinement


@dataclass(frozen=True, eq=False)
class Sums:
    """Normal equations of linear effects between any two of E edges, for p parameters."""

    begun: Array  # (E, p, p)
    ended: Array  # (E, p, p)
    products: Array  # (E, p)
    known: Array  # (E,)

    def between(self, first: Any, last: Any) -> tuple[Array, Array, Array]:
        return (
            self.begun[first] - self.ended[last],
            self.products[first] - self.products[last],
            self.known[first] - self.known[last],
        )


@dataclass(frozen=True, eq=False)
class SumsOfPair:
    """Normal equations between one pair of edges; other edges are ignored."""

    squares: Array  # (p, p)
    products: Array  # (p,)
    known: float

    def between(self, first: Any, last: Any) -> tuple[Array, Array, Array]:
        shape = np.shape(first)
        return (
            np.broadcast_to(self.squares, (*shape, *self.squares.shape)),
            np.broadcast_to(self.products, (*shape, *self.products.shape)),
            np.full(shape, self.known),
        )


class Edges:
    """Begin and end times of an effect in half rows, after the low-pass filter.

    Edge 0 is the start and edge 2 K - 1 the end; edge e is at e / 2 rows. The filter converts a
    step to the integral of a Gaussian. `sharpness` is the inverse of the filter's width in rows.
    """

    def __init__(self, rows: int, sharpness: float) -> None:
        self.rows, self.end = rows, 2 * rows - 1
        distance = np.arange(rows)[None, :] - 0.5 * np.arange(2 * rows)[:, None]
        self._on = 0.5 * (1.0 + _erf(distance * sharpness / np.sqrt(2.0)))
        self._on[0], self._on[-1] = 1.0, 0.0

    def share(self, first: int, last: int) -> Array:
        # The filtered share of an effect between two edges, (K,).
        return np.asarray(self._on[first] - self._on[last])

    def sums(self, X: Array, y: Array) -> Sums:
        # Normal equations between any two edges, for columns X (c, K, p) and data y (c, K).
        K, p = X.shape[1:]
        squares = np.einsum("ckp,ckq->kpq", X, X).reshape(K, p * p)
        products = np.einsum("ckp,ck->kp", X, y)
        known = (X != 0.0).any(axis=(0, 2)).astype(np.float64)
        # The share before the last edge is 1 minus the share after it.
        begun, ended = self._on**2 @ squares, (1.0 - (1.0 - self._on) ** 2) @ squares
        return Sums(
            begun.reshape(-1, p, p), ended.reshape(-1, p, p), self._on @ products, self._on @ known
        )

    def sums_of_pair(self, X: Array, y: Array, pair: tuple[int, int]) -> SumsOfPair:
        share = self.share(*pair)
        acting = X * share[:, None]
        known = (X != 0.0).any(axis=(0, 2)).astype(np.float64)
        return SumsOfPair(np.einsum("ckp,ckq->pq", acting, acting),
                          np.einsum("ckp,ck->p", acting, y), float(known @ share))  # fmt: skip

    def weighted(self, values: Array) -> Array:
        # Sums of values (K, ...) after each edge, (E, ...).
        return np.tensordot(self._on, values, axes=1)

    def best(self, scores: Any) -> tuple[int, int, float]:
        # Returns the best edges and their score; `scores` takes arrays of edges. A temporary effect
        # is not visible with its begin alone, so a grid of pairs is tried first.
        grid = np.unique(np.linspace(0, self.end, _GRID).astype(int))
        pairs = np.array([(i, j) for i in grid for j in grid if i < j]).T
        found = scores(*pairs)
        first, last = pairs[:, int(np.argmax(found))].tolist()
        score = -np.inf
        for _ in range(_ROUNDS):
            firsts = np.arange(last)
            found = scores(firsts, np.full(len(firsts), last))
            first = int(np.argmax(found))
            lasts = np.arange(first + 1, self.end + 1)
            found = scores(np.full(len(lasts), first), lasts)
            last = int(lasts[np.argmax(found)])
            if found.max() <= score:
                break
            score = float(found.max())
        return first, last, score
