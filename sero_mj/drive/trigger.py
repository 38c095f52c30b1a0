"""Triggers: a condition on what a scene receives, `abs(lwr.torque_error) > 20`, packet by packet.

condition = comparisons of expressions with `<`, `<=`, `>`, `>=`, `==`, `!=`, joined by `and`, `or`
            and `not`
expression = numbers, names, `+ - * /`, parentheses, indices `a[0]`, `a[1:4]`, and `abs(a)`,
            `min(a)`, `max(a)`, `norm(a)` of numbers, `any(c)`, `all(c)` of comparisons

Names are events of sources (`udp.values0`), inputs that routes lead to (`lwr.torques`) and, of
robots with commanded and measured torque, their difference (`lwr.torque_error`). As in routes they
hold `-`, `.` and `/`, so that these two have spaces about them where they are operators. A
condition on several numbers holds where it holds for any of them; no data fulfils none.

As in `_expression`, Python parses a text in which something short stands for each word.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from ..assemble.scene import JOINING, Scene, Token, tokens_of
from ..errors import RouteError, did_you_mean
from ..frames import Array, Bools
from ..receive.source import SIGNALS
from ._expression import COMPARISONS
from ._units import robot_of
from .route import Origin, Route
from .wiring import Wiring

ERROR = "torque_error"
_CELL = 5  # characters that stand for each word
_MOST_WORDS = 500
_SIGNS: dict[type[ast.cmpop], str] = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
_ARITHMETIC: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_OF_NUMBERS = ("abs", "min", "max", "norm")
_OF_CONDITIONS = ("any", "all")
_FUNCTIONS = (*_OF_NUMBERS, *_OF_CONDITIONS)
Events = Mapping[str, Array]  # event to its numbers over time, (T, ...)


@dataclass(frozen=True, eq=False)
class _Signal:
    """Numbers or truths over time.

    Attributes:
        values: (T, ...).
        labels: of the numbers beside each other, where there are several.
    """

    values: Any
    labels: Sequence[str] = ()


@dataclass(frozen=True, eq=False)
class _Compared:
    """A comparison that was made, for the report."""

    text: str
    sign: str
    left: Array
    right: Array
    holds: Bools
    labels: Sequence[str]


@dataclass(frozen=True, eq=False)
class Hits:
    """Where a condition holds.

    Attributes:
        holds: of every row, (T,).
    """

    holds: Bools
    _compared: tuple[_Compared, ...] = ()
    _text: str = ""

    def describe(self, row: int) -> str:
        """Says what holds in a row: `lwr/A3: abs(lwr.torque_error) = 23.4 > 20`."""
        parts = []
        for each in self._compared:
            holds = np.atleast_1d(each.holds[row]).ravel()
            if not holds.any():
                continue
            left, right = (
                np.broadcast_to(side[row], each.holds[row].shape).ravel()
                for side in (each.left, each.right)
            )
            gap = np.where(holds, np.abs(left - right), -1.0)
            k = int(np.argmax(gap))
            label = f"{each.labels[k]}: " if k < len(each.labels) else ""
            label = "" if label == f"{each.text}: " else label
            parts.append(f"{label}{each.text} = {left[k]:.4g} {each.sign} {right[k]:.4g}")
        return ", ".join(parts) or self._text


class Trigger:
    """A condition on what the sources of a scene receive.

    It keeps the newest values of every source: those of others than the packets that are looked
    at are the last ones that came.

    Args:
        text: the condition.
        scene: whose signals it names.
        wiring: of the scene.

    Attributes:
        text: the condition.

    Raises:
        RouteError: it cannot be parsed, names what is not there, or is no condition; points at it.
    """

    def __init__(self, text: str, scene: Scene, wiring: Wiring) -> None:
        self.text = text
        self._scene = scene
        self._routes = {route.to.target: route for route in [*wiring.routes, *wiring.later]}
        self._sources = wiring.sources
        self._words = list(tokens_of(text))
        self._tree = self._parse()
        self._latest: dict[str, dict[str, Array]] = {}
        self._compared: list[_Compared] = []
        for node in ast.walk(self._tree):
            self._check(node)
        # What does not fit together is told now.
        with np.errstate(all="ignore"):
            found = self._evaluate(self._tree, _Reader(self, {}, 1)).values
        if found.dtype != bool:
            self._refuse(self._tree, "expected a comparison such as abs(lwr.torques) > 20")

    def find(self, source: str, events: Events) -> Hits:
        """Returns in which of the packets of a source the condition holds.

        Args:
            source: its name.
            events: event to its numbers, (T, ...), of good packets in their order.
        """
        count = len(next(iter(events.values()), np.empty(0)))
        if not count:
            return Hits(np.zeros(0, bool))
        reader = _Reader(self, {source: events}, count)
        self._compared = []
        with np.errstate(all="ignore"):
            values = self._evaluate(self._tree, reader).values
        self._latest[source] = {event: array[-1:].copy() for event, array in events.items()}
        holds = np.broadcast_to(values.reshape(len(values), -1).any(axis=1), count)
        compared = tuple(self._compared)
        self._compared = []
        return Hits(np.asarray(holds), compared, self.text)

    # Parsing.

    def _parse(self) -> ast.expr:
        if len(self._words) > _MOST_WORDS:
            word = self._words[_MOST_WORDS]
            raise RouteError(self.text, word.at, f"expected at most {_MOST_WORDS} words")
        for i, word in enumerate(self._words):
            behind = self._words[i + 1].text if i + 1 < len(self._words) else ""
            if behind == "(" and word.kind == "name" and word.text not in (*_FUNCTIONS, *JOINING):
                near = did_you_mean(word.text, _FUNCTIONS)
                raise RouteError(self.text, word.at, f"expected a function{near}", len(word.text))
            if word.kind == "other":
                hint = "; equal is ==" if word.text == "=" else ""
                raise RouteError(self.text, word.at, f"expected a comparison, + - * /{hint}")
        tree = _tree_of(self._words)
        if tree is None:
            # The longest beginning that something can follow.
            for count in range(len(self._words), -1, -1):
                begun = self._words[:count]
                opened = _closing(begun)
                if any(_tree_of([*begun, *more, *opened]) is not None for more in ([], [_ONE])):
                    break
            at = self._words[count].at if count < len(self._words) else len(self.text)
            length = len(self._words[count].text) if count < len(self._words) else 1
            raise RouteError(
                self.text, at, "expected a name, a number, a comparison or a sign between", length
            )
        return tree

    def _word(self, node: ast.AST) -> int:
        return int(getattr(node, "col_offset", _CELL)) // _CELL - 1  # a bracket stands before all

    def _text_of(self, node: ast.expr) -> str:
        first = self._words[self._word(node)]
        last = self._words[((node.end_col_offset or 0) - 1) // _CELL - 1]
        return self.text[first.at : last.at + len(last.text)]

    def _refuse(self, node: ast.AST, reason: str) -> NoReturn:
        word = self._words[min(self._word(node), len(self._words) - 1)]
        raise RouteError(self.text, word.at, reason, len(word.text))

    def _check(self, node: ast.AST) -> None:
        """Refuses what is no part of a condition, and names of nothing."""
        match node:
            case ast.Name() if self._words[self._word(node)].text in _FUNCTIONS:
                return
            case ast.Name():
                self._resolve(node)
            case ast.Call(func=ast.Name(), args=[_], keywords=[]):
                return
            case ast.Call(func=ast.Name()):
                self._refuse(node, "expected one value in brackets behind it")
            case ast.BinOp(op=op) if type(op) not in _ARITHMETIC:
                self._refuse(node, "expected +, -, * or /")
            case ast.Compare() | ast.BoolOp() | ast.BinOp() | ast.UnaryOp() | ast.Constant():
                return
            case ast.Subscript() | ast.Slice() | ast.Load() | ast.boolop() | ast.unaryop():
                return
            case ast.operator() | ast.cmpop():
                return
            case _:
                self._refuse(node, "expected numbers, names, + - * / and comparisons")

    @property
    def names(self) -> list[str]:
        """Names that a condition can have."""
        events = [
            f"{name}.{event}"
            for name, source in self._sources.items()
            for event in source.events
            if event not in SIGNALS
        ]
        robots = [name for name in self._scene.robots if self._has_error(name)]
        return [*self._routes, *(f"{name}.{ERROR}" for name in robots), *events]

    def _has_error(self, robot: str) -> bool:
        return all(f"{robot}.{key}" in self._routes for key in ("torques", "commanded_torques"))

    def _resolve(self, node: ast.Name) -> str:
        """Checks the name of a signal and returns it."""
        word = self._words[self._word(node)]
        name, names = word.text, self.names
        if name in names:
            return name
        robot, _, key = name.partition(".")
        if key == ERROR and robot in self._scene.robots:
            missing = [
                f"{robot}.{each}"
                for each in ("commanded_torques", "torques")
                if f"{robot}.{each}" not in self._routes
            ]
            reason = f"nothing is routed to {' and '.join(missing)}, which it is made of"
            raise RouteError(self.text, word.at, reason, len(name))
        reason = f"expected a signal of scene '{self._scene.name}'{did_you_mean(name, names)}"
        raise RouteError(self.text, word.at, reason, len(name))

    # Evaluation.

    def _evaluate(self, node: ast.expr, reader: _Reader) -> _Signal:
        match node:
            case ast.Constant():
                result = _Signal(np.array([float(self._words[self._word(node)].text)]))
            case ast.Name():
                result = reader.signal(self._resolve(node))
            case ast.UnaryOp(op=op, operand=inner):
                result = self._unary(op, inner, reader)
            case ast.BinOp(op=operation, left=left, right=right):
                a, b = self._number(left, reader), self._number(right, reader)
                result = self._joined(node, _ARITHMETIC[type(operation)], a, b)
            case ast.BoolOp(op=joint, values=parts):
                join = np.logical_and if isinstance(joint, ast.And) else np.logical_or
                result = self._truth(parts[0], reader)
                for part in parts[1:]:
                    result = self._joined(node, join, result, self._truth(part, reader))
            case ast.Compare():
                result = self._compare(node, reader)
            case ast.Call(func=function, args=[inner]):
                result = self._call(self._words[self._word(function)].text, inner, reader)
            case ast.Subscript(value=inner):
                result = self._pick(node, self._evaluate(inner, reader))
            case _:
                self._refuse(node, "expected numbers, names, + - * / and comparisons")
        return result

    def _unary(self, op: ast.unaryop, inner: ast.expr, reader: _Reader) -> _Signal:
        if isinstance(op, ast.Not):
            return _Signal(~self._truth(inner, reader).values)
        found = self._number(inner, reader)
        return found if isinstance(op, ast.UAdd) else _Signal(-found.values, found.labels)

    def _number(self, node: ast.expr, reader: _Reader) -> _Signal:
        found = self._evaluate(node, reader)
        if found.values.dtype == bool:
            self._refuse(node, "expected numbers; comparisons are joined by and, or")
        return found

    def _truth(self, node: ast.expr, reader: _Reader) -> _Signal:
        found = self._evaluate(node, reader)
        if found.values.dtype != bool:
            self._refuse(node, "expected a comparison such as lwr.torques > 20")
        return found

    def _joined(
        self, node: ast.expr, function: Callable[[Any, Any], Any], a: _Signal, b: _Signal
    ) -> _Signal:
        left, right = _same_rank(a.values, b.values)
        try:
            values = function(left, right)
        except ValueError:
            many = " and ".join(" x ".join(map(str, s.values.shape[1:])) for s in (a, b))
            self._refuse(node, f"expected as many on both sides; there are {many}")
        return _Signal(values, a.labels if a.values.ndim >= b.values.ndim else b.labels)

    def _compare(self, node: ast.Compare, reader: _Reader) -> _Signal:
        sides = [self._number(each, reader) for each in (node.left, *node.comparators)]
        nodes = [node.left, *node.comparators]
        result: _Signal | None = None
        for k, op in enumerate(node.ops):
            if type(op) not in _SIGNS:
                self._refuse(node, "expected <, <=, >, >=, == or !=")
            sign = _SIGNS[type(op)]
            function = COMPARISONS[sign]
            a, b = sides[k], sides[k + 1]
            one = self._joined(node, function, a, b)
            known = self._joined(node, lambda x, y: np.isfinite(x) & np.isfinite(y), a, b)
            one = _Signal(one.values & known.values, one.labels)
            left, right = _same_rank(a.values, b.values)
            shape = one.values.shape
            self._compared.append(
                _Compared(self._text_of(nodes[k]), sign, np.broadcast_to(left, shape),
                          np.broadcast_to(right, shape), one.values, one.labels)
            )  # fmt: skip
            result = one if result is None else self._joined(node, np.logical_and, result, one)
        assert result is not None
        return result

    def _call(self, name: str, inner: ast.expr, reader: _Reader) -> _Signal:
        found = (self._truth if name in _OF_CONDITIONS else self._number)(inner, reader)
        values = found.values
        if name == "abs":
            return _Signal(np.abs(values), found.labels)
        flat = values.reshape(len(values), -1)
        if name == "norm":
            return _Signal(np.linalg.norm(flat, axis=1))
        return _Signal(getattr(np, name)(flat, axis=1))

    def _pick(self, node: ast.Subscript, value: _Signal) -> _Signal:
        values = value.values
        if values.ndim < 2:
            self._refuse(node.slice, "expected none: it is a single number")
        index: Any
        if isinstance(node.slice, ast.Slice):
            index = slice(*(None if each is None else self._whole(each) for each in
                            (node.slice.lower, node.slice.upper, node.slice.step)))  # fmt: skip
        else:
            index = self._whole(node.slice)
            if not -values.shape[1] <= index < values.shape[1]:
                self._refuse(
                    node.slice, f"expected 0 to {values.shape[1] - 1}: there are {values.shape[1]}"
                )
        picked = values[:, index]
        if not picked.size and values.size:
            self._refuse(node.slice, "expected a slice with something in it")
        if len(value.labels) != values.shape[1]:
            return _Signal(picked)
        labels = value.labels[index]
        return _Signal(picked, (labels,) if isinstance(labels, str) else labels)

    def _whole(self, node: ast.expr) -> int:
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            return -self._whole(node.operand)
        text = self._words[self._word(node)].text
        if not (isinstance(node, ast.Constant) and text.isdigit() and len(text) < 10):
            self._refuse(node, "expected a whole number")
        return int(text)


class _Reader:
    """Signals while some packets of one source are looked at."""

    def __init__(self, trigger: Trigger, events: Mapping[str, Events], count: int) -> None:
        self._trigger, self._events, self._count = trigger, events, count
        self._inputs: dict[str, Array] = {}

    def signal(self, name: str) -> _Signal:
        """Returns a signal, (T, ...), T being 1 where it does not change meanwhile."""
        trigger = self._trigger
        owner, _, key = name.partition(".")
        if name in trigger._routes:
            route = trigger._routes[name]
            return _Signal(self._input(route), _labels(trigger._scene, route))
        if key == ERROR and owner in trigger._scene.robots:
            commanded, measured = (
                trigger._routes[f"{owner}.{each}"] for each in ("commanded_torques", "torques")
            )
            error = self._input(commanded) - self._input(measured)
            return _Signal(error, _labels(trigger._scene, measured))
        values = self._event(Origin(owner, key, True))
        count = values.shape[1] if values.ndim > 1 else 0
        return _Signal(values, [f"{name}[{k}]" for k in range(count)])

    def _event(self, origin: Origin) -> Array:
        source = self._trigger._sources[origin.name]
        if origin.key in SIGNALS:
            return np.ones((1, 1))  # it receives
        found = self._events.get(origin.name) or self._trigger._latest.get(origin.name)
        if found is None:
            return np.full((1, *source.events[origin.key]), np.nan)
        return np.asarray(found[origin.key], np.float64)

    def _input(self, route: Route) -> Array:
        target = route.to.target
        if target not in self._inputs:

            def numbers_of(origin: Origin) -> Array:
                if origin.is_event:
                    values = self._event(origin)
                else:
                    values = self._input(self._trigger._routes[str(origin)])
                return np.broadcast_to(
                    values.reshape(len(values), -1), (self._count, int(np.prod(values.shape[1:])))
                )

            values = route.value.evaluate(numbers_of)
            rows = values if values.ndim > 1 else values[None]
            if route.condition is not None:
                rows = route.condition(rows)
            if route.to.kind == "toggle" and route.negated:
                rows = 1.0 - (rows != 0)
            self._inputs[target] = rows
        return self._inputs[target]


def _labels(scene: Scene, route: Route) -> list[str]:
    if route.to.kind in ("angles", "values"):
        return [f"{route.to.name}/{joint}" for joint in robot_of(scene, route.to).names]
    if route.to.kind == "vector":
        return [f"{route.to.name}.{axis}" for axis in "xyz"]
    return []


_ONE = Token("number", "1", 0)


def _tree_of(words: Sequence[Token]) -> ast.expr | None:
    """The tree of a condition; None of anything else."""
    if not words:
        return None
    cells = []
    for word in words:
        cell = word.text
        if word.kind == "number":
            cell = "1"
        elif word.kind == "name" and word.text not in (*_FUNCTIONS, *JOINING):
            cell = "_"
        cells.append(cell.ljust(_CELL))
    try:
        return ast.parse("(".ljust(_CELL) + "".join(cells) + ")", mode="eval").body
    except (SyntaxError, RecursionError, MemoryError, ValueError):
        return None


def _closing(words: Sequence[Token]) -> list[Token]:
    opened: list[str] = []
    for word in words:
        if word.text in ("(", "["):
            opened.append(")" if word.text == "(" else "]")
        elif word.text in (")", "]") and opened:
            opened.pop()
    return [Token("sign", sign, 0) for sign in reversed(opened)]


def _same_rank(a: Array, b: Array) -> tuple[Array, Array]:
    """Adds axes behind the fewer, so that numpy's rules for shapes take a number for each."""
    while a.ndim < b.ndim:
        a = a[..., None]
    while b.ndim < a.ndim:
        b = b[..., None]
    return a, b
