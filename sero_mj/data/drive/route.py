"""Checked routes, compiled to a few NumPy operations.

Routes are affine: each number of an input is a constant plus multiples of received numbers. They
can be inverted, to compute the packet that results in given inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...base.frames import Array, Ints
from ...robots.declared.inputs import Input
from ..receive.source import SIGNALS


class Origin(NamedTuple):
    """The origin of numbers in a route: an event of a source, or an input of a robot."""

    name: str
    key: str
    is_event: bool

    def __str__(self) -> str:
        return f"{self.name}.{self.key}"


class Term(NamedTuple):
    """Multiples of k numbers of one origin.

    Attributes:
        at: indices in the result, shape (k,).
        take: flat indices in the origin, shape (k,).
        times: factors, shape (k,).
    """

    origin: Origin
    at: Ints
    take: Ints
    times: Array


@dataclass(frozen=True, eq=False)
class Affine:
    """A constant plus multiples of received numbers; created by `make_affine`.

    Attributes:
        offset: constant, shape (n,).
        whole: origin, if the result is all of its numbers in the same order; otherwise None.
        only: origin and indices, if the result is a selection of the numbers of one origin, without
            factors and constants; otherwise None.
    """

    offset: Array
    terms: tuple[Term, ...]
    whole: Origin | None
    only: tuple[Origin, Ints] | None

    @cached_property
    def origins(self) -> tuple[Origin, ...]:
        return tuple(dict.fromkeys(term.origin for term in self.terms))

    def evaluate(self, numbers_of: Callable[[Origin], Array]) -> Array:
        """Returns the numbers, shape (n,), or (T, n) over time.

        Call this method within `np.errstate`, because numbers may overflow.

        Args:
            numbers_of: function from an origin to its numbers, shape (k,), or (T, k) over time.
        """
        if self.only is not None:
            origin, take = self.only
            return numbers_of(origin)[..., take]
        result = self.offset.copy()
        for term in self.terms:
            numbers = numbers_of(term.origin)[..., term.take]
            if numbers.ndim > result.ndim:
                result = np.tile(result, (len(numbers), 1))
            result[..., term.at] += numbers * term.times
        return result


def make_affine(offset: Array, terms: Sequence[Term], sizes: Mapping[Origin, int]) -> Affine:
    """Returns a constant, shape (n,), plus terms; `sizes` counts the numbers of each origin."""
    only = whole = None
    if len(terms) == 1 and len(terms[0].at) == len(offset) and not offset.any():
        origin, _, take, times = terms[0]
        if (times == 1.0).all():
            only = (origin, take)
            whole = origin if np.array_equal(take, np.arange(sizes[origin])) else None
    covered = np.zeros(len(offset), bool)
    for term in terms:
        covered[term.at] = True
    # -0.0 is the neutral element of addition: adding 0.0 would turn -0.0 into 0.0.
    offset = np.where(covered & (offset == 0.0), -0.0, offset)
    return Affine(offset, tuple(terms), whole, only)


Truths = Callable[[Array], Any]  # function from numbers (T, n) to truth values (T, ...)


@dataclass(frozen=True, eq=False)
class Condition:
    """Comparisons of numbers, combined by `and`, `or` and `not`."""

    truths: Truths

    def __call__(self, numbers: Array) -> Array:
        """Returns 1 if the condition holds for any of the numbers, otherwise 0.

        Numbers have the shape (n,), or (T, n) over time. Returns NaN if a number is NaN.
        """
        rows = numbers if numbers.ndim > 1 else numbers[None]
        with np.errstate(all="ignore"):
            found = np.asarray(self.truths(rows))
        holds = np.broadcast_to(found.reshape(len(found), -1).any(axis=1), len(rows))
        values = np.where(np.isfinite(rows).all(axis=1), holds, np.nan)[:, None]
        return values if numbers.ndim > 1 else np.asarray(values[0])


@dataclass(frozen=True, eq=False)
class Route:
    """A checked route that sets the numbers of an input.

    Attributes:
        to: input that the route sets.
        text: text of the origin.
        numbers: for each number of the input, the index of its value in the result of `text`. A
            coupled joint has the index of its driving joint.
        texts: for a route to individual joints, the expression of each joint; empty for joints that
            the route does not set.
        rest: for a route to individual joints, the declared values (or NaN) of joints that it does
            not set.
        condition: condition of a toggle; None if the route sets numbers.
    """

    to: Input
    text: str
    value: Affine
    negated: bool = False
    numbers: tuple[int, ...] = ()
    texts: tuple[str, ...] = ()
    rest: Array | None = None
    condition: Condition | None = None

    def origin_of(self, index: int) -> str:
        """Returns the origin of a number of the input, such as `values0[3]`, or ""."""
        offset = self.value.offset[index]
        text = self.texts[index] if self.texts else self.text
        if np.isnan(offset) or not text:
            return ""
        found = [(term, k) for term in self.value.terms for k in np.flatnonzero(term.at == index)]
        if len(found) == 1 and offset == 0.0:
            ((term, k),) = found
            if term.times[k] == 1.0:
                return f"{term.origin.key}[{term.take[k]}]"
        return f"({text})[{self.numbers[index]}]"

    @property
    def sources(self) -> list[str]:
        """Names of the sources that the route reads."""
        return list(dict.fromkeys(o.name for o in self.value.origins if o.is_event))

    @property
    def outputs(self) -> list[str]:
        """Outputs of robots, doubles and arrows that the route reads, as `name.key`."""
        return [str(origin) for origin in self.value.origins if not origin.is_event]

    @property
    def direct(self) -> str | None:
        """Name of the source, if the route depends only on packets of one source, else None."""
        sources = self.sources
        if any(o.is_event and o.key in SIGNALS for o in self.value.origins):
            return None  # changes also without a packet
        return sources[0] if len(sources) == 1 and not self.outputs else None


@dataclass(frozen=True)
class FrameRoute:
    """A checked route that sets an input to the pose of a frame.

    Attributes:
        frame: name of the frame; for `fwd_kin_base_to_flange`, name of the robot.
    """

    to: Input
    frame: str
    is_fwd_kin: bool = False
