"""`Edges`: sums over the time between any two edges, for the begin and end of a fault."""

from __future__ import annotations

from dataclasses import dataclass
from math import erf
from typing import Any

import numpy as np

from ...base.frames import Array

_erf = np.vectorize(erf)
_REACH = 6.0  # standard deviations of the filter beyond which a step is complete
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
        edges = np.arange(2 * rows)
        self._first = -(-edges // 2)  # first row after each edge
        reach = int(np.ceil(_REACH / sharpness))
        near = self._first[:, None] + np.arange(-reach, reach + 1)
        distance = near - 0.5 * edges[:, None]
        on = 0.5 * (1.0 + _erf(distance * sharpness / np.sqrt(2.0)))
        on[0], on[-1] = distance[0] >= 0.0, distance[-1] >= 0.0
        inside = (near >= 0) & (near < rows)
        self._near, self._is_inside = np.where(inside, near, 0), inside
        self._on, self._is_after = np.where(inside, on, 0.0), inside & (distance >= 0.0)

    def share(self, first: int, last: int) -> Array:
        # The filtered share of an effect between two edges, (K,).
        return np.asarray(self._step(first) - self._step(last))

    def _step(self, edge: int) -> Array:
        step = (np.arange(self.rows) >= self._first[edge]).astype(np.float64)
        np.add.at(step, self._near[edge], self._on[edge] - self._is_after[edge])
        return np.asarray(step)

    def _after(self, values: Array, on: Array) -> Array:
        # Sums of values (K, ...) with the weights after each edge, (E, ...). The weights are 0
        # before an edge and 1 after it, and differ from these only in rows near the edge, `on`.
        flat = values.reshape(len(values), -1)
        sums = np.zeros((self.rows + 1, flat.shape[1]))
        sums[:-1] = np.cumsum(flat[::-1], axis=0)[::-1]
        found = sums[self._first]
        for column, more in zip(self._near.T, (on - self._is_after).T, strict=True):
            found += more[:, None] * flat[column]
        return np.asarray(found.reshape(-1, *values.shape[1:]))

    def sums(self, X: Array, y: Array) -> Sums:
        # Normal equations between any two edges, for columns X (c, K, p) and data y (c, K).
        squares = np.einsum("ckp,ckq->kpq", X, X)
        products = np.einsum("ckp,ck->kp", X, y)
        known = (X != 0.0).any(axis=(0, 2)).astype(np.float64)
        on = self._on
        # The share before the last edge is 1 minus the share after it.
        before = np.where(self._is_inside, 1.0 - (1.0 - on) ** 2, 0.0)
        return Sums(
            self._after(squares, on**2), self._after(squares, before),
            self._after(products, on), self._after(known, on),
        )  # fmt: skip

    def sums_of_pair(self, X: Array, y: Array, pair: tuple[int, int]) -> SumsOfPair:
        share = self.share(*pair)
        acting = X * share[:, None]
        known = (X != 0.0).any(axis=(0, 2)).astype(np.float64)
        return SumsOfPair(np.einsum("ckp,ckq->pq", acting, acting),
                          np.einsum("ckp,ck->p", acting, y), float(known @ share))  # fmt: skip

    def weighted(self, values: Array) -> Array:
        # Sums of values (K, ...) after each edge, (E, ...).
        return self._after(values, self._on)

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
