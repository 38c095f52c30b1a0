"""Checked routes, compiled to a few numpy operations.

Everything that a route can compute is affine: each number of the input is a constant plus multiples
of received numbers. Routes can therefore be inverted, to compute the packet for given inputs.
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
    """The origin of numbers.

    Attributes:
        key: the source's event, or the output.
    """

    name: str
    key: str
    is_event: bool

    def __str__(self) -> str:
        return f"{self.name}.{self.key}"


class Term(NamedTuple):
    """Multiples of the numbers of one origin.

    Attributes:
        at: indices in the result to which they are added, (k,).
        take: flat indices in the origin, (k,).
        times: factors, (k,).
    """

    origin: Origin
    at: Ints
    take: Ints
    times: Array


@dataclass(frozen=True, eq=False)
class Affine:
    """A constant plus multiples of received numbers; `make_affine` makes it.

    Attributes:
        offset: the constant, (n,).
        only: if the result consists of numbers of one origin: their indices and the origin.
    """

    offset: Array
    terms: tuple[Term, ...]
    whole: Origin | None
    only: tuple[Origin, Ints] | None

    @cached_property
    def origins(self) -> tuple[Origin, ...]:
        return tuple(dict.fromkeys(term.origin for term in self.terms))

    def evaluate(self, numbers_of: Callable[[Origin], Array]) -> Array:
        """Returns the numbers (n,), or over time (T, n), a new array.

        NaN stays NaN. Numbers may overflow: call it under `np.errstate`.

        Args:
            numbers_of: gives the numbers of an origin, flat: (k,), or over time (T, k).
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
    """Builds an `Affine`. `offset`: the constant, (n,)."""
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


Truths = Callable[[Array], Any]  # of numbers over time, (T, n): (T, ...)


@dataclass(frozen=True, eq=False)
class Condition:
    """Comparisons of numbers, joined by `and`, `or` and `not`.

    Attributes:
        truths: computes truth values (T, ...) from numbers over time, (T, n).
    """

    truths: Truths

    def __call__(self, numbers: Array) -> Array:
        """Returns 1 if it holds for any of the numbers (n,), or over time (T, n), else 0.

        NaN if one of them is unknown.
        """
        rows = numbers if numbers.ndim > 1 else numbers[None]
        with np.errstate(all="ignore"):
            found = np.asarray(self.truths(rows))
        holds = np.broadcast_to(found.reshape(len(found), -1).any(axis=1), len(rows))
        values = np.where(np.isfinite(rows).all(axis=1), holds, np.nan)[:, None]
        return values if numbers.ndim > 1 else np.asarray(values[0])


@dataclass(frozen=True, eq=False)
class Route:
    """One checked route of numbers.

    Attributes:
        numbers: index of each of the input's numbers in those of the text; a robot of a group has
            its share of them, and coupled joints those of their driving joints.
        texts: origin of each of the input's numbers, for routes to some joints; empty for joints
            without a route, and for other routes.
        rest: values of joints without a route in that case: the declared pose, or no data.
        condition: of a toggle, compares the numbers; None if it uses a number directly.
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
        """Returns the origin of one of the input's numbers: `values0[3]`; empty for none."""
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
        """Names of the sources of its numbers."""
        return list(dict.fromkeys(o.name for o in self.value.origins if o.is_event))

    @property
    def outputs(self) -> list[str]:
        """The outputs of robots, doubles and arrows that it reads, `name.key`."""
        return [str(origin) for origin in self.value.origins if not origin.is_event]

    @property
    def direct(self) -> str | None:
        """The source, if it depends on a packet of that only; else None."""
        sources = self.sources
        if any(o.is_event and o.key in SIGNALS for o in self.value.origins):
            return None  # changes without a packet
        return sources[0] if len(sources) == 1 and not self.outputs else None


@dataclass(frozen=True)
class FrameRoute:
    """One checked route from a frame.

    Attributes:
        frame: name of the frame, or of the robot whose `fwd_kin_base_to_flange` it is.
    """

    to: Input
    frame: str
    is_fwd_kin: bool = False
