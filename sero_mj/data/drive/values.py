"""Values of routes: arrays of constants plus multiples of received numbers.

Values are computed once, when a scene is read. `Value.compile` converts them to operations that are
applied to each packet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array, Ints
from .route import Affine, Origin, Term, make_affine
from .units import NONE, Dimension, describe

Numbers = NDArray[Any]  # array of `Number` objects


class Impossible(Exception):
    """An operation that is impossible in a route; the text is the reason."""


@dataclass(frozen=True, slots=True)
class Number:
    """A constant plus multiples of received numbers.

    Attributes:
        offset: constant.
        terms: origin, index and factor of each received number.
    """

    offset: float
    unit: Dimension = NONE
    terms: tuple[tuple[Origin, int, float], ...] = ()

    def __add__(self, other: Number) -> Number:
        if any(self.unit) and any(other.unit) and self.unit != other.unit:
            units = f"{describe(self.unit)} and {describe(other.unit)}"
            raise Impossible(f"expected the same unit on both sides; found {units}")
        unit = self.unit if any(self.unit) else other.unit
        return Number(self.offset + other.offset, unit, self.terms + other.terms)

    def __neg__(self) -> Number:
        return self * Number(-1.0)

    def __sub__(self, other: Number) -> Number:
        return self + -other

    def __mul__(self, other: Number) -> Number:
        if self.terms and other.terms:
            reason = "expected a constant on one side: routes can only add multiples of numbers"
            raise Impossible(reason)
        value, factor = (other, self) if other.terms else (self, other)
        unit = tuple(a + b for a, b in zip(self.unit, other.unit, strict=True))
        terms = tuple((origin, index, by * factor.offset) for origin, index, by in value.terms)
        return Number(value.offset * factor.offset, unit, terms)

    def __truediv__(self, other: Number) -> Number:
        if other.terms:
            raise Impossible("expected a constant divisor")
        if not other.offset:
            raise Impossible("expected a divisor other than 0")
        return self * Number(1.0 / other.offset, tuple(-exponent for exponent in other.unit))


@dataclass(frozen=True, eq=False)
class Value:
    """An array of constants plus multiples of received numbers.

    Attributes:
        entries: array of `Number` objects.
        is_frames: whether the array contains 4 x 4 frames.
        sizes: count of the numbers of each origin.
    """

    entries: Numbers
    is_frames: bool = False
    sizes: Mapping[Origin, int] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.entries.shape

    @property
    def units(self) -> list[Dimension]:
        """Units of the entries, row-major."""
        return [entry.unit for entry in self.entries.flat]

    @property
    def is_constant(self) -> bool:
        """Whether the value does not depend on received numbers."""
        return not any(entry.terms for entry in self.entries.flat)

    def gather(self, take: Ints, factors: Array, constants: Array) -> Value:
        """Returns the numbers at m row-major indices, times factors, plus constants.

        A number loses its unit unless its factor is 1. A constant of NaN means missing data.
        """
        flat = self.entries.ravel()
        entries = np.empty(len(take), dtype=object)
        for i, (index, factor, constant) in enumerate(
            zip(take.tolist(), factors.tolist(), constants.tolist(), strict=True)
        ):
            entry: Number = flat[index]
            if factor != 1.0 or constant != 0.0:
                known = () if isnan(constant) else entry.terms
                entry = Number(entry.offset, NONE, known) * Number(factor)
                entry = Number(entry.offset + constant, NONE, entry.terms)
            entries[i] = entry
        return Value(entries, sizes=self.sizes)

    def spread(self, at: Ints, rest: Array) -> Value:
        """Returns `rest`, m constants, with the numbers of this value at the k indices `at`.

        If this value is a single number, it is repeated k times.
        """
        entries = np.array([Number(float(each)) for each in rest], dtype=object)
        entries[at] = self.entries.ravel() if self.entries.size > 1 else self.entries.item()
        return Value(entries, sizes=self.sizes)

    def split(self, counts: Sequence[int]) -> list[Value]:
        """Splits the numbers, in row-major order, into parts with the sizes `counts`."""
        parts = np.split(self.entries.ravel(), np.cumsum(counts)[:-1])
        return [Value(part, sizes=self.sizes) for part in parts]

    def compile(self, count: int) -> Affine:
        """Returns the operations that compute `count` numbers from a packet.

        A single number is repeated.
        """
        entries = np.broadcast_to(self.entries.ravel(), count)
        terms = []
        for column in zip_longest(*(entry.terms for entry in entries)):
            by_origin: dict[Origin, list[tuple[int, int, float]]] = {}
            for at, term in enumerate(column):
                if term is not None:
                    origin, take, times = term
                    by_origin.setdefault(origin, []).append((at, take, times))
            for origin, rows in by_origin.items():
                terms.append(Term(origin, *map(np.array, zip(*rows, strict=True))))
        return make_affine(np.array([entry.offset for entry in entries]), terms, self.sizes)


def constant(number: float, unit: Dimension = NONE) -> Value:
    """Returns a constant number with a unit."""
    return Value(np.array(Number(number, unit), dtype=object))


def numbers_of(
    origin: Origin, shape: tuple[int, ...], units: Sequence[Dimension] | None = None
) -> Value:
    """Returns all numbers of an event or output. `units` has one entry per number."""
    count = int(np.prod(shape))
    numbers = [
        Number(0.0, unit, ((origin, i, 1.0),)) for i, unit in enumerate(units or [NONE] * count)
    ]
    entries = np.array(numbers, dtype=object).reshape(shape)
    return Value(entries, len(shape) == 3, {origin: count})


def joined(values: Sequence[Value]) -> Value:
    """Concatenates the numbers of several values."""
    entries = np.concatenate([value.entries.ravel() for value in values])
    sizes = {origin: size for value in values for origin, size in value.sizes.items()}
    return Value(entries, sizes=sizes)
