"""The numbers that a route leads to an input, as a few numpy operations.

Everything that a route can compute is affine: each number of the input is a constant plus
multiples of numbers that were received. That is why a route can also be followed backwards, to
make the packet that gives wanted numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
_ALL = slice(None)


class Origin(NamedTuple):
    """Where numbers come from.

    Attributes:
        name: of a source, or of a robot, a double or an arrow.
        key: the source's event, or the output.
        is_event: which of the two.
    """

    name: str
    key: str
    is_event: bool

    def __str__(self) -> str:
        return f"{self.name}.{self.key}"


@dataclass(frozen=True, eq=False)
class Term:
    """Multiples of the numbers of one origin.

    Attributes:
        origin: where they come from.
        at: which numbers of the result they are added to, (k,) or all.
        take: which number of the origin, counted through all of its rows, goes there, (k,).
        times: what it is multiplied by, (k,); None where nothing is.
    """

    origin: Origin
    at: Ints | slice
    take: Ints
    times: Array | None


class Affine:
    """A constant plus multiples of received numbers.

    Args:
        offset: the constant, (n,).
        terms: what is added to it, in this order.
        whole: the origin, where the result is all of its numbers, unchanged.

    Attributes:
        offset: as given.
        terms: as given.
        whole: as given.
        origins: all origins, each once.
    """

    def __init__(self, offset: Array, terms: tuple[Term, ...], whole: Origin | None) -> None:
        self.offset = offset
        self.terms = terms
        self.whole = whole
        self.origins = tuple(dict.fromkeys(term.origin for term in terms))
        self._only = _only_picks(offset, terms)

    def evaluate(self, numbers_of: Callable[[Origin], Array]) -> Array:
        """Returns the numbers (n,), a new array.

        NaN stays NaN. Numbers may overflow: call it under `np.errstate`.

        Args:
            numbers_of: gives the numbers of an origin, flat.
        """
        if self._only is not None:
            return numbers_of(self._only.origin)[self._only.take]
        result = self.offset.copy()
        for term in self.terms:
            numbers = numbers_of(term.origin)[term.take]
            result[term.at] += numbers if term.times is None else numbers * term.times
        return result


def make_affine(
    offset: Array, parts: list[tuple[Origin, Ints, Array]], sizes: dict[Origin, int]
) -> Affine:
    """Joins parts into as few terms as possible.

    Args:
        offset: the constant, (n,).
        parts: origin; index of its number that goes to each place, (n,), -1 for none; what it is
            multiplied by, (n,).
        sizes: how many numbers each origin has.
    """
    joined: list[tuple[Origin, Ints, Array]] = []
    for origin, take, times in parts:
        for other, index, factor in joined:
            free = (take < 0) | (index < 0)
            if other == origin and free.all():  # they lead to different places
                here = take >= 0
                index[here], factor[here] = take[here], times[here]
                break
        else:
            joined.append((origin, take.copy(), times.copy()))
    terms = tuple(_term(*part) for part in joined)
    covered = np.zeros(len(offset), bool)
    for term in terms:
        covered[term.at] = True
    # -0.0 is what leaves every number as it is that is added to it: 0.0 takes the sign off -0.0.
    offset = np.where(covered & (offset == 0.0), -0.0, offset)
    only = _only_picks(offset, terms)
    whole = None
    if only is not None and np.array_equal(only.take, np.arange(sizes[only.origin])):
        whole = only.origin
    return Affine(offset, terms, whole)


def _only_picks(offset: Array, terms: tuple[Term, ...]) -> Term | None:
    """The only term, where the result is nothing but some of its numbers."""
    if len(terms) != 1 or offset.any():
        return None
    return terms[0] if terms[0].times is None and isinstance(terms[0].at, slice) else None


def _term(origin: Origin, take: Ints, times: Array) -> Term:
    at = np.flatnonzero(take >= 0)
    factors = None if (times[at] == 1.0).all() else times[at]
    return Term(origin, _ALL if len(at) == len(take) else at, take[at], factors)
