"""Parses expressions of routes and triggers by Python's `ast`; `evaluator` computes them.

origin     = ["not"] expression, or a condition
condition  = comparisons of expressions with `<`, `<=`, `>`, `>=`, `==`, `!=`, and `any(condition)`,
             `all(condition)`, joined by `and`, `or` and `not`
expression = numbers, names, `+ - * /`, parentheses, lists `[a, b]`, indices `a[0]`, `a[0,3,5]`,
             `a[1:4]`, as in Python, and in conditions `abs(a)`, `min(a)`, `max(a)`, `norm(a)`

Names may contain `-`, `.` and `/`, so the operators `-` and `/` need spaces around them. Before
Python parses a text, each token is replaced by a placeholder of fixed width. The position of a node
in this text therefore gives the index of its token.
"""

from __future__ import annotations

import ast
import operator
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NoReturn

from ...base.errors import RouteError, did_you_mean
from ...robots.declared.route_text import FUNCTIONS, JOINING, NOT, Token, tokens_of

_MAX_DEPTH = 40  # maximum depth of nested brackets
_MAX_WORDS = 2000  # maximum number of tokens; the time to parse a sum is quadratic
_ALLOWED = (
    ast.Name, ast.Constant, ast.Load, ast.List, ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div,
    ast.UnaryOp, ast.UAdd, ast.USub, ast.Not, ast.BoolOp, ast.And, ast.Or, ast.Compare,
    ast.Call, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq,
)  # fmt: skip
COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq,
    "!=": operator.ne,
}  # fmt: skip
_CELL = 6  # characters per token


@dataclass(frozen=True)
class Expression:
    """A parsed expression or condition of a route or trigger.

    Attributes:
        negated: whether the expression begins with `not` and is not a condition.
        words: tokens of the text.
    """

    text: str
    negated: bool
    tree: ast.expr
    words: list[Token]
    is_condition: bool = False

    @property
    def name(self) -> str | None:
        """The name, if the expression consists of a single name, else None."""
        word = self.words[first_word(self.tree)]
        return word.text if isinstance(self.tree, ast.Name) and word.kind == "name" else None

    def text_of(self, node: ast.expr) -> str:
        """Returns the text of a node."""
        last = self.words[word_after(node) - 1]
        return self.text[self.words[first_word(node)].at : last.at + len(last.text)]

    def operator_after(self, node: ast.expr) -> int:
        """Returns the index of the operator after an operand and its brackets."""
        at = word_after(node)
        while self.words[at].text == ")":
            at += 1
        return at

    def refuse(self, word: int, reason: str, length: int = 1) -> NoReturn:
        """Raises a RouteError at the word with this index; marks `length` characters."""
        raise RouteError(self.text, self.words[word].at, reason, length)


def parse(text: str) -> Expression:
    """Parses an expression or condition of a route or trigger; raises RouteError."""
    words = list(tokens_of(text))
    if len(words) > _MAX_WORDS:
        word, found = words[_MAX_WORDS], f"found {len(words)}"
        reason = f"expected at most {_MAX_WORDS} numbers, names and signs; {found}"
        raise RouteError(text, word.at, reason, len(word.text))
    functions = [
        word.kind == "name" and following.text == "(" and word.text not in JOINING
        for word, following in pairwise([*words, Token("end", "", len(text))])
    ]
    for word, is_function in zip(words, functions, strict=True):
        if is_function and word.text not in FUNCTIONS:
            reason = f"expected a function{did_you_mean(word.text, FUNCTIONS)}"
            raise RouteError(text, word.at, reason, len(word.text))
    is_condition = any(word.text in (*COMPARISONS, "and", "or", "any", "all") for word in words)
    negated = bool(words) and words[0].text == NOT and not is_condition
    words, functions = words[negated:], functions[negated:]
    depth = 0
    for word in words:
        depth += (word.text in ("(", "[")) - (word.text in (")", "]"))
        if depth > _MAX_DEPTH:
            reason = f"expected at most {_MAX_DEPTH} nested brackets"
            raise RouteError(text, word.at, reason)
    signs = [
        word.text if is_function else _sign_of(word, is_condition)
        for word, is_function in zip(words, functions, strict=True)
    ]
    tree = _tree_of(signs)
    if tree is None:
        counts = range(1, len(words) + 1)
        right = bisect_left(counts, True, key=lambda count: not _is_beginning(signs[:count]))
        word = words[right] if right < len(words) else Token("end", "", len(text))
        raise RouteError(text, word.at, _expected(signs[:right], word), len(word.text))
    return Expression(text, negated, tree, words, is_condition)


def _sign_of(word: Token, is_condition: bool) -> str:
    if word.kind == "sign" or (is_condition and word.text in JOINING):
        return word.text
    if word.kind == "other" or word.text == NOT:
        return "$"
    is_whole = word.text.isdigit() and len(word.text) < 10  # such numbers can be indices
    return "1" if is_whole else "_"


def _tree_of(signs: Sequence[str]) -> ast.expr | None:
    try:
        cells = "".join(sign.ljust(_CELL) for sign in signs)
        tree = ast.parse(f"({cells})", mode="eval").body
    except (SyntaxError, RecursionError, MemoryError):
        return None
    indices: set[ast.AST] = set()
    entries: list[ast.AST]
    for node in ast.walk(tree):
        match node:
            case ast.Subscript(slice=ast.Slice() | ast.Tuple() as index):
                indices.add(index)
                entries = [
                    each for each in ast.iter_child_nodes(index) if isinstance(each, ast.expr)
                ]
            case ast.Subscript(slice=index):
                entries = [index]
            case ast.List(elts=[]) | ast.Tuple(elts=[]) | ast.Call(args=[]):
                return None
            case ast.Call(func=ast.Name(id=name), keywords=[]) if name in FUNCTIONS:
                entries = []
            case ast.Call():
                return None
            case ast.Tuple() | ast.Slice():
                entries = [] if node in indices else [node]
            case _:
                entries = [] if isinstance(node, _ALLOWED) else [node]
        if not all(map(_is_whole, entries)):
            return None
    return tree


def _is_whole(node: ast.AST) -> bool:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        node = node.operand
    return isinstance(node, ast.Constant)


def _is_beginning(signs: Sequence[str]) -> bool:
    opened: list[str] = []
    for sign in signs:
        if sign in "([":
            opened.append(")" if sign == "(" else "]")
        elif sign in ")]" and opened:
            opened.pop()
    return any(_tree_of([*signs, *rest, *reversed(opened)]) is not None for rest in ("", "1"))


def _expected(before: Sequence[str], found: Token) -> str:
    def fits(sign: str) -> bool:
        return _is_beginning([*before, sign])

    if fits("_"):
        hint = f"; '{NOT}' must be the first word" if found.text == NOT else ""
        return f"expected an event such as udp.values0, a number, ( or [{hint}"
    if fits("1"):
        return "expected a whole number" + " or a slice such as 0:7" * (before[-1] == "[")
    if fits("]"):
        return f"expected {' '.join([*filter(fits, ':,'), 'or ]'])}"
    end = ", or )" if fits(")") else ", or the end"
    named = found.kind in ("name", "number") and end != ", or )"
    hint = "; write == to compare" if found.text == "=" else ""
    return f"expected +, -, * or / between spaces{' before it' if named else end}{hint}"


def first_word(node: ast.expr) -> int:
    """Returns the index of the first word of a node."""
    return node.col_offset // _CELL


def word_after(node: ast.expr) -> int:
    """Returns the index of the word after a node."""
    return ((node.end_col_offset or 0) + _CELL - 2) // _CELL
