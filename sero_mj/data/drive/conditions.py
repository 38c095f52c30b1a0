"""Evaluates conditions of routes and triggers: comparisons of numbers, row by row over time.

Arrays are (T, ...): a row for every packet, or a single row for constants. Several numbers are
compared one by one, and a condition holds if it holds for any of them. Missing data satisfies no
comparison.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NoReturn

import numpy as np

from ...base.frames import Array, Bools
from .language import COMPARISONS, Expression, first_word
from .route import Condition
from .values import Evaluator as ValueEvaluator
from .values import Value, amount, finite, joined

_ARITHMETIC: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
}  # fmt: skip
_QUANTIFIERS = ("any", "all")  # functions


@dataclass(frozen=True, eq=False)
class Signal:
    """Numbers or truth values over time.

    Attributes:
        values: (T, ...).
        labels: of the numbers in a row, if there are several.
    """

    values: Any
    labels: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class Compared:
    """An evaluated comparison, for reports.

    Attributes:
        text: of its left side.
        sign: such as `>`.
        left: (T, ...).
        right: likewise.
        holds: likewise.
        labels: of the numbers in a row.
    """

    text: str
    sign: str
    left: Array
    right: Array
    holds: Bools
    labels: Sequence[str]


# The numbers of a part of an expression, if known as a whole; else None.
Leaf = Callable[[ast.expr], Signal | None]


class Conditions:
    """Computes where a condition holds.

    Args:
        expression: result of `parse`.
        leaf: gives the numbers of names, constants, and other known parts.

    Attributes:
        compared: the evaluated comparisons.
    """

    def __init__(self, expression: Expression, leaf: Leaf) -> None:
        self._expression, self._leaf = expression, leaf
        self.compared: list[Compared] = []

    def truth(self, node: ast.expr) -> Signal:
        """Returns the truth values of a part of the condition; refuses numbers."""
        match node:
            case ast.Compare():
                return self._compare(node)
            case ast.BoolOp(op=joint, values=parts):
                join = np.logical_and if isinstance(joint, ast.And) else np.logical_or
                result = self.truth(parts[0])
                for before, part in pairwise(parts):
                    at = self._expression.behind(before)
                    result = self._joined(at, join, result, self.truth(part))
                return result
            case ast.UnaryOp(op=ast.Not(), operand=inner):
                return Signal(~self.truth(inner).values)
            case ast.Call(args=[inner]) if self._word(node) in _QUANTIFIERS:
                values = self.truth(inner).values
                return Signal(getattr(np, self._word(node))(_flat(values), axis=1))
        self._refuse(node, "expected a comparison such as lwr.torques > 20")

    def numbers(self, node: ast.expr) -> Signal:
        """Returns the numbers of a part; refuses truth values."""
        chain: list[ast.BinOp] = []  # a sum of 1,000 terms is a tree of that depth
        while (found := self._leaf(node)) is None and isinstance(node, ast.BinOp):
            chain.append(node)
            node = node.left
        found = self._operand(node) if found is None else found
        for outer in reversed(chain):
            calculate = _ARITHMETIC[type(outer.op)]
            at = self._expression.behind(outer.left)
            found = self._joined(at, calculate, found, self.numbers(outer.right))
        return found

    def _operand(self, node: ast.expr) -> Signal:
        match node:
            case ast.UnaryOp(op=ast.UAdd() | ast.USub() as sign, operand=inner):
                found = self.numbers(inner)
                return found if isinstance(sign, ast.UAdd) else Signal(-found.values, found.labels)
            case ast.Call(args=[inner]) if self._word(node) not in _QUANTIFIERS:
                return self._call(self._word(node), self.numbers(inner))
            case ast.Call(args=[_, other, *_]):
                self._refuse(other, "expected one value in brackets behind a function")
            case ast.Subscript(value=inner):
                return self._pick(node, self.numbers(inner))
            case ast.List(elts=several):
                rows = [_flat(self.numbers(each).values) for each in several]
                count = max(map(len, rows))
                return Signal(np.hstack([np.broadcast_to(r, (count, r.shape[1])) for r in rows]))
        self._refuse(node, "expected numbers; comparisons are joined by and, or")

    def _call(self, name: str, found: Signal) -> Signal:
        if name == "abs":
            return Signal(np.abs(found.values), found.labels)
        if name == "norm":
            return Signal(np.linalg.norm(_flat(found.values), axis=1))
        return Signal(getattr(np, name)(_flat(found.values), axis=1))

    def _joined(self, at: int, function: Callable[[Any, Any], Any], a: Signal, b: Signal) -> Signal:
        """Applies a function to the broadcast numbers of the operands of the operator `at`."""
        left, right = _same_rank(a.values, b.values)
        try:
            values = function(left, right)
        except ValueError:
            many = " and ".join(amount(signal.values.shape[1:]) for signal in (a, b))
            reason = f"expected as many on both sides; there are {many}"
            self._expression.refuse(at, reason, len(self._expression.words[at].text))
        return Signal(values, a.labels if a.values.ndim >= b.values.ndim else b.labels)

    def _compare(self, node: ast.Compare) -> Signal:
        nodes = [node.left, *node.comparators]
        sides = [self.numbers(each) for each in nodes]
        result: Signal | None = None
        for k in range(len(node.ops)):
            a, b = sides[k], sides[k + 1]
            at = self._expression.behind(nodes[k])
            sign = self._expression.words[at].text
            one = self._joined(at, COMPARISONS[sign], a, b)
            known = self._joined(at, lambda x, y: np.isfinite(x) & np.isfinite(y), a, b)
            one = Signal(one.values & known.values, one.labels)
            left, right = _same_rank(a.values, b.values)
            shape = one.values.shape
            self.compared.append(
                Compared(self._expression.text_of(nodes[k]), sign, np.broadcast_to(left, shape),
                         np.broadcast_to(right, shape), one.values, one.labels)
            )  # fmt: skip
            result = one if result is None else self._joined(at, np.logical_and, result, one)
        assert result is not None
        return result

    def _pick(self, node: ast.Subscript, value: Signal) -> Signal:
        values = value.values
        if values.ndim < 2:
            self._refuse(node.slice, "expected none: it is a single number")
        index: Any
        match node.slice:
            case ast.Slice(lower=lower, upper=upper, step=step):
                index = slice(*(each and self._whole(each) for each in (lower, upper, step)))
            case ast.Tuple(elts=several):
                index = [self._position(each, values.shape[1]) for each in several]
            case one:
                index = self._position(one, values.shape[1])
        picked = values[:, index]
        if not picked.size and values.size:
            self._refuse(node.slice, "expected a slice with something in it")
        if len(value.labels) != values.shape[1]:
            return Signal(picked)
        return Signal(picked, np.atleast_1d(np.array(value.labels, object)[index]).tolist())

    def _position(self, node: ast.expr, count: int) -> int:
        index = self._whole(node)
        if not -count <= index < count:
            self._refuse(node, f"expected 0 to {count - 1}: there are {count}")
        return index

    def _whole(self, node: ast.expr) -> int:
        if isinstance(node, ast.UnaryOp):
            return -self._whole(node.operand)
        return int(self._word(node))

    def _word(self, node: ast.expr) -> str:
        return self._expression.words[first_word(node)].text

    def _refuse(self, node: ast.expr, reason: str) -> NoReturn:
        word = first_word(node)
        self._expression.refuse(word, reason, len(self._expression.words[word].text))


def condition_of(expression: Expression, names: Mapping[str, Value]) -> tuple[Value, Condition]:
    """Returns the numbers compared by a route's condition, and the condition on them.

    Args:
        expression: what `parse` returned, a condition.
        names: values by name.

    Raises:
        RouteError: points at the invalid part, with the reason.
    """
    of_values = ValueEvaluator(expression, names)
    parts: dict[int, tuple[Value, slice]] = {}  # by id in the tree, which keeps them alive

    def find(node: ast.expr) -> Signal | None:
        """Collects the largest parts that are linear in received numbers: these have units."""
        if not isinstance(node, ast.Name | ast.Constant) and not _is_linear(
            node, expression, names
        ):
            return None
        value = of_values.evaluate(node)
        if value.is_frames:
            of_values.check_comparison(node, value, value)
        first = max((own.stop for _, own in parts.values()), default=0)
        parts[id(node)] = value, slice(first, first + value.entries.size)
        return Signal(np.zeros((1, *value.shape)))

    def given(numbers: Array) -> Leaf:
        def leaf(node: ast.expr) -> Signal | None:
            if id(node) not in parts:
                return None
            value, own = parts[id(node)]
            return Signal(numbers[:, own].reshape(len(numbers), *value.shape))

        return leaf

    with np.errstate(all="ignore"):
        Conditions(expression, find).truth(expression.tree)
        for node in ast.walk(expression.tree):
            if isinstance(node, ast.Compare):
                nodes = [node.left, *node.comparators]
                for one, other in pairwise(nodes):
                    if id(one) in parts and id(other) in parts:
                        of_values.check_comparison(one, parts[id(one)][0], parts[id(other)][0])
    compared = finite(joined([value for value, _ in parts.values()]), expression, names)

    def truths(numbers: Array) -> Any:
        return Conditions(expression, given(numbers)).truth(expression.tree).values

    return compared, Condition(truths)


def _is_linear(node: ast.expr, expression: Expression, names: Mapping[str, Value]) -> bool:
    """Whether a part has no functions and no products of received numbers."""

    def is_constant(part: ast.expr) -> bool:
        words = (expression.words[first_word(n)] for n in ast.walk(part) if isinstance(n, ast.Name))
        return all(word.kind != "name" or names[word.text].is_constant for word in words)

    for each in ast.walk(node):
        match each:
            case ast.Call() | ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
                return False
            case ast.BinOp(op=ast.Mult(), left=left, right=right):
                if not (is_constant(left) or is_constant(right)):
                    return False
            case ast.BinOp(op=ast.Div(), right=right) if not is_constant(right):
                return False
    return True


def _flat(values: Array) -> Array:
    return np.asarray(values).reshape(len(values), -1)


def _same_rank(a: Array, b: Array) -> tuple[Array, Array]:
    """Appends axes to the array with fewer, so that numbers are broadcast per row."""
    while a.ndim < b.ndim:
        a = a[..., None]
    while b.ndim < a.ndim:
        b = b[..., None]
    return a, b
