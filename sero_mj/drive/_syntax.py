"""The grammar of a route's origin, parsed by Python's `ast`.

origin     = ["not"] expression
expression = numbers, names, `+ - * /`, parentheses, lists `[a, b]` and indices `a[0]`,
             `a[0,3,5]`, `a[1:4]`, as in Python

Names hold `-`, `.` and `/`, so these two have spaces about them where they are operators. Python
parses a text in which a single character stands for each name and number.
"""

from __future__ import annotations

import ast
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

from ..assemble.route_text import NOT, Token, tokens_of
from ..errors import RouteError

_MAX_DEPTH = 40  # brackets within each other
_MAX_WORDS = 2000  # their sum takes the square of it
_ALLOWED = (
    ast.Name, ast.Constant, ast.Load, ast.List, ast.BinOp, ast.Add, ast.Sub, ast.Mult, ast.Div,
    ast.UnaryOp, ast.UAdd, ast.USub,
)  # fmt: skip


@dataclass(frozen=True)
class Expression:
    """A parsed origin.

    Attributes:
        text: as it is written.
        negated: whether it begins with `not`.
        tree: of the rest; the k-th word is at column 2 k + 1.
        words: the words of the rest.
    """

    text: str
    negated: bool
    tree: ast.expr
    words: list[Token]

    @property
    def name(self) -> str | None:
        """The name that is all there is, else None."""
        word = self.words[first_word(self.tree)]
        return word.text if isinstance(self.tree, ast.Name) and word.kind == "name" else None

    def text_of(self, node: ast.expr) -> str:
        """A part of the text."""
        last = self.words[word_after(node) - 1]
        return self.text[self.words[first_word(node)].at : last.at + len(last.text)]

    def refuse(self, word: int, reason: str, length: int = 1) -> NoReturn:
        """Raises a RouteError that points at a word.

        Args:
            word: its index.
            reason: what was expected there.
            length: how many characters are wrong.
        """
        raise RouteError(self.text, self.words[word].at, reason, length)


def parse(text: str) -> Expression:
    """Parses an origin.

    Raises:
        RouteError: points at the first word that is wrong.
    """
    words = list(tokens_of(text))
    if len(words) > _MAX_WORDS:
        word, found = words[_MAX_WORDS], f"{len(words)} numbers, names and signs"
        reason = f"expected at most {_MAX_WORDS} before the end; there are {found}"
        raise RouteError(text, word.at, reason, len(word.text))
    negated = bool(words) and words[0].text == NOT
    words = words[negated:]
    depth = 0
    for word in words:
        depth += (word.text in ("(", "[")) - (word.text in (")", "]"))
        if depth > _MAX_DEPTH:
            reason = f"expected at most {_MAX_DEPTH} brackets within each other"
            raise RouteError(text, word.at, reason)
    signs = [_sign_of(word) for word in words]
    tree = _tree_of(signs)
    if tree is None:
        counts = range(1, len(words) + 1)
        right = bisect_left(counts, True, key=lambda count: not _is_beginning(signs[:count]))
        word = words[right] if right < len(words) else Token("end", "", len(text))
        raise RouteError(text, word.at, _expected(signs[:right], word), len(word.text))
    return Expression(text, negated, tree, words)


def _sign_of(word: Token) -> str:
    """What stands for a word in the text that Python parses, one character."""
    if word.kind == "sign":
        return word.text
    if word.kind == "other" or word.text == NOT:
        return "$"
    is_whole = word.text.isdigit() and len(word.text) < 10  # these can be indices
    return "1" if is_whole else "_"


def _tree_of(signs: Sequence[str]) -> ast.expr | None:
    """The tree of an expression; None of anything else."""
    try:
        tree = ast.parse(f"({' '.join(signs)})", mode="eval").body
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
            case ast.List(elts=[]) | ast.Tuple(elts=[]):
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
    """Whether an expression begins so."""
    opened: list[str] = []
    for sign in signs:
        if sign in "([":
            opened.append(")" if sign == "(" else "]")
        elif sign in ")]" and opened:
            opened.pop()
    return any(_tree_of([*signs, *rest, *reversed(opened)]) is not None for rest in ("", "1"))


def _expected(before: Sequence[str], found: Token) -> str:
    """What would be right behind the words before."""

    def fits(sign: str) -> bool:
        return _is_beginning([*before, sign])

    if fits("_"):
        hint = f"; '{NOT}' only stands in front of all" if found.text == NOT else ""
        return f"expected an event such as udp.values0, a number, ( or [{hint}"
    if fits("1"):
        return "expected a whole number" + " or a slice such as 0:7" * (before[-1] == "[")
    if fits("]"):
        return f"expected {' '.join([*filter(fits, ':,'), 'or ]'])}"
    end = ", or )" if fits(")") else ", or the end"
    named = found.kind in ("name", "number") and end != ", or )"
    return f"expected +, -, * or / between spaces{' before it' if named else end}"


def first_word(node: ast.expr) -> int:
    """Index of a part's first word."""
    return node.col_offset // 2


def word_after(node: ast.expr) -> int:
    """Index of the word behind a part."""
    return (node.end_col_offset or 0) // 2
