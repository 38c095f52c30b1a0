"""Values of routes' expressions: arrays of constants plus multiples of received numbers.

Such a value is computed once, when a scene is read; `Value.compile` converts it to the operations
for every packet.

- Entries are picked along the first axis: `udp.vectors0[0]` is the first vector, `[0][2]` its z.
- Operands have one shape, or one of them is a number or can be repeated as in numpy.
- A list concatenates the numbers of its entries. - Matrices cannot be indexed or combined, except
that one of several can be picked, and the unit of length be changed: `udp.matrices0 * mm` and
`0.001 * udp.matrices0` scale their positions.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from math import isfinite, isnan
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ...base.errors import RouteError
from ...base.frames import Array, Ints
from ._units import LENGTH, NONE, Dimension, describe
from .language import Expression, first_word
from .route import Affine, Origin, Term, make_affine

Numbers = NDArray[Any]  # of `_Number`


@dataclass(frozen=True, slots=True)
class _Number:
    """A constant plus multiples of received numbers: origin, index and factor of each."""

    offset: float
    unit: Dimension = NONE
    terms: tuple[tuple[Origin, int, float], ...] = ()

    def plus(self, other: _Number) -> _Number:
        unit = self.unit if any(self.unit) else other.unit
        return _Number(self.offset + other.offset, unit, self.terms + other.terms)

    def times(self, constant: _Number) -> _Number:
        unit = tuple(map(operator.add, self.unit, constant.unit))
        terms = tuple((origin, index, by * constant.offset) for origin, index, by in self.terms)
        return _Number(self.offset * constant.offset, unit, terms)

    def inverse(self) -> _Number:
        """One over a constant."""
        return _Number(1.0 / self.offset, tuple(-exponent for exponent in self.unit))


_MINUS_ONE = _Number(-1.0)


def _each(function: Callable[..., _Number], *operands: Any) -> Numbers:
    """Applies a function to every entry, with broadcasting."""
    return np.asarray(np.frompyfunc(function, len(operands), 1)(*operands), dtype=object)


@dataclass(frozen=True, eq=False)
class Value:
    """An array of constants plus multiples of received numbers.

    Attributes:
        entries: an array of `_Number`, of the value's shape.
        is_frames: whether it is 4 x 4 frames.
        sizes: count of numbers of its origins.
    """

    entries: Numbers
    is_frames: bool = False
    sizes: Mapping[Origin, int] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array; () for a number."""
        return self.entries.shape

    @property
    def units(self) -> list[Dimension]:
        """Units of every entry, row-major."""
        return [entry.unit for entry in self.entries.flat]

    @property
    def is_constant(self) -> bool:
        """Whether it contains no received numbers."""
        return not any(entry.terms for entry in self.entries.flat)

    def gather(self, take: Ints, factors: Array, constants: Array) -> Value:
        """Returns the numbers (m,): those at `take`, times factors, plus constants.

        A constant of NaN makes it no data, whatever is received.

        Args:
            take: (m,), indices of the numbers, row-major.
            factors: (m,); a number loses its unit unless its factor is 1.
            constants: (m,).
        """
        flat = self.entries.ravel()
        entries = np.empty(len(take), dtype=object)
        for i, (index, factor, constant) in enumerate(
            zip(take.tolist(), factors.tolist(), constants.tolist(), strict=True)
        ):
            entry: _Number = flat[index]
            if factor != 1.0 or constant != 0.0:
                known = () if isnan(constant) else entry.terms
                entry = _Number(entry.offset, NONE, known).times(_Number(factor))
                entry = _Number(entry.offset + constant, NONE, entry.terms)
            entries[i] = entry
        return Value(entries, sizes=self.sizes)

    def spread(self, at: Ints, rest: Array) -> Value:
        """Returns numbers (m,): its own at the indices `at` (k,), and constants elsewhere, (m,).

        A single number is written to all of these.
        """
        entries = np.array([_Number(float(each)) for each in rest], dtype=object)
        entries[at] = self.entries.ravel() if self.entries.size > 1 else self.entries.item()
        return Value(entries, sizes=self.sizes)

    def split(self, counts: Sequence[int]) -> list[Value]:
        """Splits its numbers, row-major, into parts of these sizes."""
        parts = np.split(self.entries.ravel(), np.cumsum(counts)[:-1])
        return [Value(part, sizes=self.sizes) for part in parts]

    def compile(self, count: int) -> Affine:
        """Returns the operations for every packet; a constant number is repeated `count` times."""
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
    """A number, with the exponents of its unit."""
    return Value(np.array(_Number(number, unit), dtype=object))


def numbers_of(
    origin: Origin, shape: tuple[int, ...], units: Sequence[Dimension] | None = None
) -> Value:
    """All numbers of an event or output.

    Args:
        origin: the event or output.
        shape: of its array.
        units: exponents of the unit of each; None for plain numbers.
    """
    count = int(np.prod(shape))
    numbers = [
        _Number(0.0, unit, ((origin, i, 1.0),)) for i, unit in enumerate(units or [NONE] * count)
    ]
    entries = np.array(numbers, dtype=object).reshape(shape)
    return Value(entries, len(shape) == 3, {origin: count})


def joined(values: Sequence[Value]) -> Value:
    """Concatenates the numbers of values."""
    entries = np.concatenate([value.entries.ravel() for value in values])
    sizes = {origin: size for value in values for origin, size in value.sizes.items()}
    return Value(entries, sizes=sizes)


def evaluate(expression: Expression, names: Mapping[str, Value]) -> Value:
    """Evaluates an expression.

    Args:
        expression: what `parse` returned.
        names: what every name in it stands for.

    Raises:
        RouteError: points at what has no meaning, and says why.
    """
    with np.errstate(all="ignore"):  # non-finite numbers are refused below
        value = Evaluator(expression, names).evaluate(expression.tree)
    return finite(value, expression, names)


def finite(value: Value, expression: Expression, names: Mapping[str, Value]) -> Value:
    """Returns a value with the sizes of its origins; refuses non-finite numbers."""
    for entry in value.entries.flat:
        if not all(map(isfinite, (entry.offset, *(times for _, _, times in entry.terms)))):
            raise RouteError(expression.text, 0, "expected finite numbers", len(expression.text))
    sizes = {origin: size for each in names.values() for origin, size in each.sizes.items()}
    return replace(value, sizes=sizes)


class Evaluator:
    """Computes the values of an expression's parts.

    Args:
        expression: what `parse` returned.
        names: what every name in it stands for.
    """

    def __init__(self, expression: Expression, names: Mapping[str, Value]) -> None:
        self._expression, self._names = expression, names
        self._refuse = expression.refuse

    def check_comparison(self, node: ast.expr, left: Value, right: Value) -> None:
        """Refuses a comparison of frames, of different units or of different numbers of values.

        Args:
            node: of the left side.
            left: its value.
            right: that of the right side.
        """
        if left.is_frames or right.is_frames:
            self._refuse_frames(node)
        self._sum(self._expression.behind(node), left, right)

    def evaluate(self, node: ast.expr) -> Value:
        """Returns the value of a part; raises a RouteError that points at an invalid part."""
        chain = []  # a sum of 1,000 terms is as deep a tree; it is evaluated without recursion
        while True:
            match node:
                case ast.UnaryOp(op=ast.Not()):
                    break
                case (
                    ast.BinOp(left=inner) | ast.UnaryOp(operand=inner) | ast.Subscript(value=inner)
                ):
                    chain.append(node)
                    node = inner
                case _:
                    break
        value = self._operand(node)
        for outer in reversed(chain):
            match outer:
                case ast.BinOp():
                    value = self._binary(outer, value, self.evaluate(outer.right))
                case ast.Subscript():
                    value = self._pick(outer, value)
                case ast.UnaryOp(op=ast.USub()):
                    if value.is_frames:
                        self._refuse_frames(outer)
                    value = Value(_each(_Number.times, value.entries, _MINUS_ONE))
        return value

    def _operand(self, node: ast.expr) -> Value:
        if isinstance(node, ast.Compare | ast.BoolOp | ast.UnaryOp | ast.Call):
            reason = "expected numbers, names, + - * /; functions and comparisons are for switches"
            self._refuse(first_word(node), reason)
        if isinstance(node, ast.List):
            values = [self.evaluate(item) for item in node.elts]
            if any(value.is_frames for value in values):
                self._refuse_frames(node)
            return Value(np.concatenate([value.entries.ravel() for value in values]))
        word = self._expression.words[first_word(node)]
        if word.kind == "name":
            return self._names[word.text]
        if not isfinite(number := float(word.text)):
            self._refuse(first_word(node), "expected a smaller number", len(word.text))
        return constant(number)

    def _binary(self, node: ast.BinOp, left: Value, right: Value) -> Value:
        at = self._expression.behind(node.left)
        sign = self._expression.words[at].text
        if left.is_frames or right.is_frames:
            return self._scaled_frames(at, sign, left, right)
        if sign in "*/":
            self._pairs(at, left, right)
            return self._product(at, sign, left, right)
        if sign == "-":
            right = Value(_each(_Number.times, right.entries, _MINUS_ONE))
        return self._sum(at, left, right)

    def _pairs(self, at: int, left: Value, right: Value) -> np.broadcast:
        """Broadcasts the numbers of two operands; refuses incompatible shapes."""
        try:
            return np.broadcast(left.entries, right.entries)
        except ValueError:
            shapes = f"{amount(left.shape)} and {amount(right.shape)}"
            self._refuse(at, f"expected as many on both sides; there are {shapes}")

    def _sum(self, at: int, left: Value, right: Value) -> Value:
        for one, other in self._pairs(at, left, right):
            if any(one.unit) and any(other.unit) and one.unit != other.unit:
                units = f"{describe(one.unit)} and {describe(other.unit)}"
                self._refuse(at, f"expected one unit on both sides; there are {units}")
        return Value(_each(_Number.plus, left.entries, right.entries))

    def _product(self, at: int, sign: str, left: Value, right: Value) -> Value:
        factor = right.entries
        if sign == "/":
            if not right.is_constant:
                self._refuse(at, "expected a constant behind it")
            if not all(entry.offset for entry in factor.flat):
                self._refuse(at, "expected no 0 behind it")
            factor = _each(_Number.inverse, factor)
        elif not (left.is_constant or right.is_constant):
            reason = "expected a constant on one side: a route adds multiples of what is received"
            self._refuse(at, reason)
        elif left.is_constant:
            left, factor = right, left.entries
        return Value(_each(_Number.times, left.entries, factor))

    def _scaled_frames(self, at: int, sign: str, left: Value, right: Value) -> Value:
        """Frames with positions multiplied by a number: another unit of length."""
        frames, other = (right, left) if right.is_frames and sign == "*" else (left, right)
        if sign in "+-" or not other.is_constant or other.shape or other.is_frames:
            reason = "expected nothing but a number or a length beside frames, as in frames * mm"
            self._refuse(at, reason)
        factor: _Number = other.entries.item()
        if not factor.offset > 0.0:
            self._refuse(at, f"expected a number above 0 beside it; found {factor.offset:g}")
        factor = factor if sign == "*" else factor.inverse()
        entries = frames.entries.copy()
        given = any(any(entry.unit) for entry in entries[..., :3, 3].flat)
        if any(factor.unit) and (given or factor.unit != LENGTH):
            self._refuse(at, f"expected a length beside frames; found {describe(factor.unit)}")
        entries[..., :3, 3] = _each(_Number.times, entries[..., :3, 3], factor)
        return Value(entries, is_frames=True)

    def _pick(self, node: ast.Subscript, value: Value) -> Value:
        bracket, name = self._expression.behind(node.value), self._expression.text_of(node.value)
        if not value.shape:
            self._refuse(bracket, f"expected none: {name} is a single number")
        if value.is_frames and len(value.shape) == 2:
            self._refuse(bracket, f"expected none: {name} is a frame, which cannot be indexed")
        index: Any
        match node.slice:
            case ast.Slice(lower=lower, upper=upper, step=step):
                last = value.shape[0]  # a slice may end after the last one
                index = slice(
                    self._position(lower, value, name, last),
                    self._position(upper, value, name, last),
                    None if step is None else self._integer(step),
                )
                if step is not None and index.step == 0:
                    self._refuse(first_word(step), "expected a step other than 0")
            case ast.Tuple(elts=several):
                last = value.shape[0] - 1
                index = [self._position(each, value, name, last) for each in several]
            case _:
                index = self._position(node.slice, value, name, value.shape[0] - 1)
        entries = np.asarray(value.entries[index], dtype=object)
        if not entries.size:
            self._refuse(bracket, "expected a slice with something in it")
        return Value(entries, value.is_frames)

    def _position(self, node: ast.expr | None, value: Value, name: str, last: int) -> int | None:
        """An index into the first axis, at most `last`."""
        if node is None:
            return None
        number, length = self._integer(node), value.shape[0]
        if not -length <= number <= last:
            many = amount(value.shape) if len(value.shape) == 1 else f"{length} rows"
            wanted = f"0 to {last}, or -1 to {-length} from the end"
            reason = f"expected {wanted}: {name} has {many}"
            self._refuse(first_word(node), reason, len(str(number)))
        return number

    def _integer(self, node: ast.expr) -> int:
        if isinstance(node, ast.UnaryOp):
            return -self._integer(node.operand)
        return int(self._expression.words[first_word(node)].text)

    def _refuse_frames(self, node: ast.expr) -> NoReturn:
        reason = "expected no frames beside it: these cannot be indexed or combined"
        self._refuse(first_word(node), reason)


def amount(shape: tuple[int, ...]) -> str:
    """Describes the size of an array, for messages."""
    if len(shape) > 1:
        return " x ".join(map(str, shape)) + " values"
    count = int(np.prod(shape))
    return "1 value" if count == 1 else f"{count} values"
