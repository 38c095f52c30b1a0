"""Computes expressions and conditions of routes and triggers over time.

Arrays have the shape (T, ...), with one row per packet, or a single row for constants. To check and
compile a route, the same evaluator computes one row of `Number` objects.

- Indices apply to the first axis: `udp.vectors0[0]` is the first vector, `[0][2]` its z.
- Operands have the same shape or are broadcast as in NumPy.
- A list concatenates the numbers of its entries.
- Matrices cannot be combined. An index selects one of several matrices, and a factor changes the
  unit of length of their positions, as in `udp.matrices0 * mm`.
- Conditions compare elementwise. Comparisons with missing data are false.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import isfinite
from typing import Any, NoReturn

import numpy as np

from ...base.errors import RouteError
from ...base.frames import Array, Bools
from .language import COMPARISONS, Expression, first_word
from .route import Condition
from .units import LENGTH, describe
from .values import Impossible, Number, Value, constant, joined

_ARITHMETIC: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
}  # fmt: skip
_QUANTIFIERS = ("any", "all")


@dataclass(frozen=True, eq=False)
class Rows:
    """Numbers or truth values over time, with one row per packet.

    Attributes:
        values: array, shape (T, ...).
        labels: names of the numbers in a row, for reports.
        is_frames: whether the numbers are frames of a route, which cannot be combined.
    """

    values: Any
    labels: Sequence[str] = ()
    is_frames: bool = False


@dataclass(frozen=True, eq=False)
class Compared:
    """The result of a comparison such as `left > right`, for reports, with one row per packet."""

    text: str
    sign: str
    left: Array
    right: Array
    holds: Bools
    labels: Sequence[str]


# A function that returns the numbers of a node, or None if the evaluator must compute them.
Leaf = Callable[[ast.expr], Rows | None]


class Evaluator:
    """An evaluator of an expression; `leaf` returns the numbers of names and constants."""

    def __init__(self, expression: Expression, leaf: Leaf, *, is_route: bool = False) -> None:
        self._expression, self._leaf, self._is_route = expression, leaf, is_route
        self.compared: list[Compared] = []

    def truth(self, node: ast.expr) -> Rows:
        """Returns the truth values of a node; raises RouteError for numbers."""
        match node:
            case ast.Compare():
                return self._compare(node)
            case ast.BoolOp(op=joint, values=parts):
                join = np.logical_and if isinstance(joint, ast.And) else np.logical_or
                result = self.truth(parts[0])
                for before, part in pairwise(parts):
                    at = self._expression.operator_after(before)
                    result = self._joined(at, join, result, self.truth(part))
                return result
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return Rows(~self.truth(inner).values)
            case ast.Call(args=[inner]) if self._word(node) in _QUANTIFIERS:
                values = self.truth(inner).values
                return Rows(getattr(np, self._word(node))(_flat(values), axis=1))
        self._refuse(node, "expected a comparison such as lwr.torques > 20")

    def numbers(self, node: ast.expr) -> Rows:
        """Returns the numbers of a node; raises RouteError for truth values."""
        chain: list[ast.BinOp | ast.UnaryOp | ast.Subscript] = []
        while (found := self._leaf(node)) is None:  # a loop, because the tree of a sum is deep
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
        found = self._operand(node) if found is None else found
        for outer in reversed(chain):
            match outer:
                case ast.BinOp():
                    found = self._calculate(outer, found, self.numbers(outer.right))
                case ast.Subscript():
                    found = self._pick(outer, found)
                case ast.UnaryOp(op=ast.USub()):
                    self._refuse_frames(outer, found)
                    found = Rows(-found.values, found.labels)
        return found

    def check_comparison(self, node: ast.expr, left: Value, right: Value) -> None:
        """Raises RouteError if two values cannot be compared.

        Frames, values with different units, and different counts of numbers cannot be compared.
        """
        rows = [_rows_of(value) for value in (left, right)]
        for each in rows:
            self._refuse_frames(node, each)
        self._joined(self._expression.operator_after(node), operator.add, *rows)

    def _operand(self, node: ast.expr) -> Rows:
        if isinstance(node, ast.List):
            entries = [self.numbers(each) for each in node.elts]
            for entry in entries:
                self._refuse_frames(node, entry)
            flat = [_flat(entry.values) for entry in entries]
            count = max(map(len, flat))
            return Rows(np.hstack([np.broadcast_to(r, (count, r.shape[1])) for r in flat]))
        if self._is_route:
            reason = "expected numbers, names, + - * /; only toggles take functions and comparisons"
            self._expression.refuse(first_word(node), reason)
        match node:
            case ast.Call(args=[inner]) if (name := self._word(node)) not in _QUANTIFIERS:
                found = self.numbers(inner)
                if name == "abs":
                    return Rows(np.abs(found.values), found.labels)
                function = np.linalg.norm if name == "norm" else getattr(np, name)
                return Rows(function(_flat(found.values), axis=1))
            case ast.Call(args=[_, other, *_]):
                self._refuse(other, "expected a function with one argument")
        self._refuse(node, "expected numbers; combine comparisons with 'and' or 'or'")

    def _calculate(self, node: ast.BinOp, left: Rows, right: Rows) -> Rows:
        at = self._expression.operator_after(node.left)
        sign = self._expression.words[at].text
        if left.is_frames or right.is_frames:
            return self._scaled_frames(at, sign, left, right)
        return self._joined(at, _ARITHMETIC[sign], left, right)

    def _joined(self, at: int, function: Callable[[Any, Any], Any], a: Rows, b: Rows) -> Rows:
        left, right = _same_rank(a.values, b.values)
        try:
            np.broadcast(left, right)
        except ValueError:
            many = " and ".join(amount(each.values.shape[1:]) for each in (a, b))
            reason = f"expected equal sizes on both sides; found {many}"
            self._expression.refuse(at, reason, len(self._expression.words[at].text))
        try:
            values = function(left, right)
        except Impossible as error:
            self._expression.refuse(at, str(error))
        return Rows(values, a.labels if a.values.ndim >= b.values.ndim else b.labels)

    def _scaled_frames(self, at: int, sign: str, left: Rows, right: Rows) -> Rows:
        frames, other = (right, left) if right.is_frames and sign == "*" else (left, right)
        is_number = other.values.shape == (1,) and not other.values.item().terms
        if sign in "+-" or other.is_frames or not is_number:
            reason = "frames can only be multiplied by a number or a length, as in frames * mm"
            self._expression.refuse(at, reason)
        factor: Number = other.values.item()
        if not factor.offset > 0.0:
            reason = f"expected a factor above 0; found {factor.offset:g}"
            self._expression.refuse(at, reason)
        factor = factor if sign == "*" else Number(1.0) / factor
        entries = frames.values.copy()
        has_unit = any(any(entry.unit) for entry in entries[..., :3, 3].flat)
        if any(factor.unit) and (has_unit or factor.unit != LENGTH):
            reason = f"expected a length as the factor of frames; found {describe(factor.unit)}"
            self._expression.refuse(at, reason)
        entries[..., :3, 3] *= factor
        return Rows(entries, is_frames=True)

    def _compare(self, node: ast.Compare) -> Rows:
        nodes = [node.left, *node.comparators]
        sides = [self.numbers(each) for each in nodes]
        result: Rows | None = None
        for k in range(len(node.ops)):
            a, b = sides[k], sides[k + 1]
            at = self._expression.operator_after(nodes[k])
            sign = self._expression.words[at].text
            one = self._joined(at, COMPARISONS[sign], a, b)
            left, right = _same_rank(a.values, b.values)
            one = Rows(one.values & np.isfinite(left) & np.isfinite(right), one.labels)
            left, right = (np.broadcast_to(side, one.values.shape) for side in (left, right))
            text = self._expression.text_of(nodes[k])
            self.compared.append(Compared(text, sign, left, right, one.values, one.labels))
            result = one if result is None else self._joined(at, np.logical_and, result, one)
        assert result is not None
        return result

    def _pick(self, node: ast.Subscript, found: Rows) -> Rows:
        values, name = found.values, self._expression.text_of(node.value)
        bracket = self._expression.operator_after(node.value)
        if values.ndim < 2:
            self._expression.refuse(bracket, f"{name} is a single number, which has no index")
        if found.is_frames and values.ndim == 3:
            reason = f"{name} is a frame, which cannot be indexed"
            self._expression.refuse(bracket, reason)
        index: Any
        match node.slice:
            case ast.Slice(lower=lower, upper=upper, step=step):
                first, last = (
                    None if each is None else self._position(each, values, name, values.shape[1])
                    for each in (lower, upper)
                )
                index = slice(first, last, None if step is None else self._whole(step))
                if step is not None and index.step == 0:
                    self._expression.refuse(first_word(step), "expected a step other than 0")
            case ast.Tuple(elts=several):
                index = [self._position(each, values, name) for each in several]
            case one:
                index = self._position(one, values, name)
        picked = values[:, index]
        if not picked.size and values.size:
            self._expression.refuse(bracket, "the slice is empty")
        labels: Sequence[str] = ()
        if len(found.labels) == values.shape[1]:
            labels = np.atleast_1d(np.array(found.labels, object)[index]).tolist()
        return Rows(picked, labels, found.is_frames)

    def _position(self, node: ast.expr, values: Any, name: str, last: int | None = None) -> int:
        number, length = self._whole(node), values.shape[1]
        last = length - 1 if last is None else last
        if not -length <= number <= last:
            many = amount(values.shape[1:]) if values.ndim == 2 else f"{length} rows"
            reason = f"expected 0 to {last}, or -1 to {-length} from the end: {name} has {many}"
            self._expression.refuse(first_word(node), reason, len(str(number)))
        return number

    def _whole(self, node: ast.expr) -> int:
        if isinstance(node, ast.UnaryOp):
            return -self._whole(node.operand)
        return int(self._word(node))

    def _word(self, node: ast.expr) -> str:
        return self._expression.words[first_word(node)].text

    def _refuse(self, node: ast.expr, reason: str) -> NoReturn:
        self._expression.refuse(first_word(node), reason, len(self._word(node)))

    def _refuse_frames(self, node: ast.expr, found: Rows) -> None:
        if found.is_frames:
            reason = "frames cannot be indexed or combined"
            self._expression.refuse(first_word(node), reason)


def evaluate(expression: Expression, names: Mapping[str, Value]) -> Value:
    """Evaluates the expression of a route; raises RouteError."""
    with np.errstate(all="ignore"):  # `_finite` reports numbers that are not finite
        rows = _of_route(expression, names).numbers(expression.tree)
    return _finite(_value_of(rows), expression, names)


def condition_of(expression: Expression, names: Mapping[str, Value]) -> tuple[Value, Condition]:
    """Returns the numbers that a condition compares, and the condition; raises RouteError."""
    of_route = _of_route(expression, names)
    parts: dict[int, tuple[Value, slice]] = {}  # value of a node and range of its numbers, by id

    def find(node: ast.expr) -> Rows | None:
        # Collects the largest nodes that are linear in received numbers, and therefore have units.
        try:
            value = _value_of(of_route.numbers(node))
        except RouteError:
            if isinstance(node, ast.Name | ast.Constant):
                raise
            return None  # errors are reported for the operands
        if value.is_frames:
            of_route.check_comparison(node, value, value)
        first = max((own.stop for _, own in parts.values()), default=0)
        parts[id(node)] = value, slice(first, first + value.entries.size)
        return Rows(np.zeros((1, *value.shape)))

    def leaf_of(numbers: Array) -> Leaf:
        def leaf(node: ast.expr) -> Rows | None:
            if id(node) not in parts:
                return None
            value, own = parts[id(node)]
            return Rows(numbers[:, own].reshape(len(numbers), *value.shape))

        return leaf

    with np.errstate(all="ignore"):
        Evaluator(expression, find).truth(expression.tree)
        for node in ast.walk(expression.tree):
            if isinstance(node, ast.Compare):
                for one, other in pairwise([node.left, *node.comparators]):
                    if id(one) in parts and id(other) in parts:
                        of_route.check_comparison(one, parts[id(one)][0], parts[id(other)][0])
    compared = _finite(joined([value for value, _ in parts.values()]), expression, names)

    def truths(numbers: Array) -> Any:
        return Evaluator(expression, leaf_of(numbers)).truth(expression.tree).values

    return compared, Condition(truths)


def _of_route(expression: Expression, names: Mapping[str, Value]) -> Evaluator:
    def leaf(node: ast.expr) -> Rows | None:
        if not isinstance(node, ast.Name | ast.Constant):
            return None
        word = expression.words[first_word(node)]
        if word.kind == "name":
            return _rows_of(names[word.text])
        if not isfinite(number := float(word.text)):
            expression.refuse(first_word(node), "expected a smaller number", len(word.text))
        return _rows_of(constant(number))

    return Evaluator(expression, leaf, is_route=True)


def _rows_of(value: Value) -> Rows:
    return Rows(value.entries[None], is_frames=value.is_frames)


def _value_of(rows: Rows) -> Value:
    return Value(np.asarray(rows.values[0], dtype=object), rows.is_frames)


def _finite(value: Value, expression: Expression, names: Mapping[str, Value]) -> Value:
    for entry in value.entries.flat:
        if not all(map(isfinite, (entry.offset, *(times for _, _, times in entry.terms)))):
            raise RouteError(expression.text, 0, "expected finite numbers", len(expression.text))
    sizes = {origin: size for each in names.values() for origin, size in each.sizes.items()}
    return replace(value, sizes=sizes)


def amount(shape: tuple[int, ...]) -> str:
    """Returns the size of an array as text, such as `7 values`."""
    if len(shape) > 1:
        return " x ".join(map(str, shape)) + " values"
    count = int(np.prod(shape))
    return "1 value" if count == 1 else f"{count} values"


def _flat(values: Array) -> Array:
    return np.asarray(values).reshape(len(values), -1)


def _same_rank(a: Array, b: Array) -> tuple[Array, Array]:
    rank = max(a.ndim, b.ndim)
    left, right = (
        each.reshape(len(each), *[1] * (rank - each.ndim), *each.shape[1:]) for each in (a, b)
    )
    return left, right
