"""The grammar of a route's origin: text to a tree, without knowing what the names mean.

origin  = ["not"] sum
sum     = product { ("+" | "-") product }
product = signed { ("*" | "/") signed }
signed  = { "-" | "+" } value { "[" pick "]" }
value   = number | name | "(" sum ")" | "[" sum { "," sum } "]"
pick    = integer { "," integer } | [integer] ":" [integer] [":" [integer]]

Names hold `-`, `.` and `/`, so these two have spaces about them where they are operators.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

from ..assemble.route_text import NOT, Word, words_of
from ..errors import RouteError

_DEEPEST = 40  # brackets within each other
_MOST_WORDS = 2000  # compiling them takes the square of it: 2 s
_BEFORE = "expected +, -, * or / between spaces before it"
_AFTER = "expected +, -, * or / between spaces, or the end"


@dataclass(frozen=True)
class Number:
    """A number as it is written."""

    at: int
    value: float


@dataclass(frozen=True)
class Name:
    """An event, an output, a frame or a unit."""

    at: int
    text: str


@dataclass(frozen=True)
class Chain:
    """A sum or a product; `rest` are the operators, where they stand, and what follows them."""

    at: int
    first: Node
    rest: tuple[tuple[str, int, Node], ...]


@dataclass(frozen=True)
class Minus:
    """The negative of something."""

    at: int
    of: Node


@dataclass(frozen=True)
class Join:
    """A list: the numbers of several things one after the other."""

    at: int
    items: tuple[Node, ...]


@dataclass(frozen=True)
class Pick:
    """Some entries of something.

    Attributes:
        at: where `of` begins.
        of: what they are picked from.
        bracket: where the `[` stands.
        index: one number, several, or a slice.
        places: where each number stands, with its value.
    """

    at: int
    of: Node
    bracket: int
    index: int | tuple[int, ...] | slice
    places: tuple[tuple[int, int], ...]


Node = Number | Name | Chain | Minus | Join | Pick


def parse(text: str) -> tuple[bool, Node]:
    """Parses an origin.

    Returns:
        whether it begins with `not`, and the tree of the rest.

    Raises:
        RouteError: points at the first word that is wrong.
    """
    parser = _Parser(text)
    parser.check_length()
    negated = parser.takes(NOT)
    tree = parser.sum()
    if parser.word is not None:
        parser.refuse(_BEFORE if parser.word.kind in ("name", "number") else _AFTER)
    return negated, tree


class _Parser:
    def __init__(self, text: str) -> None:
        self._text = text
        self._words = list(words_of(text))
        self._next = 0
        self._depth = 0

    @property
    def word(self) -> Word | None:
        return self._words[self._next] if self._next < len(self._words) else None

    def refuse(self, reason: str) -> NoReturn:
        if self.word is None:
            raise RouteError(self._text, len(self._text), reason)
        raise RouteError(self._text, self.word.at, reason, len(self.word.text))

    def check_length(self) -> None:
        """Refuses what would take too long to be compiled."""
        if len(self._words) > _MOST_WORDS:
            self._next = _MOST_WORDS
            found = f"{len(self._words)} numbers, names and signs"
            self.refuse(f"expected at most {_MOST_WORDS} before the end; there are {found}")

    def takes(self, *texts: str) -> bool:
        """Goes on, if the next word is one of these."""
        found = self.word is not None and self.word.text in texts
        self._next += found
        return found

    def _take(self, text: str, reason: str) -> None:
        if not self.takes(text):
            self.refuse(reason)

    def sum(self) -> Node:
        return self._chain(("+", "-"))

    def _chain(self, signs: tuple[str, str]) -> Node:
        def part() -> Node:
            return self._chain(("*", "/")) if signs == ("+", "-") else self._signed()

        first = part()
        rest = []
        while self.takes(*signs):
            sign = self._words[self._next - 1]
            rest.append((sign.text, sign.at, part()))
        return Chain(first.at, first, tuple(rest)) if rest else first

    def _signed(self) -> Node:
        at, negative = None, False
        while self.takes("-", "+"):
            sign = self._words[self._next - 1]
            at = sign.at if at is None else at
            negative ^= sign.text == "-"
        node = self._value()
        while self.word is not None and self.word.text == "[":
            node = self._pick(node)
        return Minus(node.at if at is None else at, node) if negative else node

    def _value(self) -> Node:
        word = self.word
        if word is None or word.kind == "other" or word.text == NOT:
            hint = f"; '{NOT}' only stands in front of all" if word and word.text == NOT else ""
            self.refuse(f"expected an event such as udp.values0, a number, ( or [{hint}")
        self._next += 1
        if word.kind == "number":
            value = float(word.text)
            if value == float("inf"):
                self._next -= 1
                self.refuse("expected a smaller number")
            return Number(word.at, value)
        if word.kind == "name":
            return Name(word.at, word.text)
        if word.text not in ("(", "["):
            self._next -= 1
            self.refuse("expected an event such as udp.values0, a number, ( or [")
        self._depth += 1
        if self._depth > _DEEPEST:
            self._next -= 1
            self.refuse(f"expected at most {_DEEPEST} brackets within each other")
        node = self._in_parentheses() if word.text == "(" else self._list(word.at)
        self._depth -= 1
        return node

    def _in_parentheses(self) -> Node:
        node = self.sum()
        self._take(")", "expected +, -, * or / between spaces, or )")
        return node

    def _list(self, at: int) -> Node:
        items = [self.sum()]
        while self.takes(","):
            if self.word is not None and self.word.text == "]":
                break
            items.append(self.sum())
        self._take("]", "expected , or ]")
        return Join(at, tuple(items))

    def _pick(self, of: Node) -> Pick:
        bracket = self._words[self._next].at
        self._next += 1
        places: list[tuple[int, int]] = []
        first = self._integer(places)
        index: int | tuple[int, ...] | slice
        if self.takes(":"):
            stop = self._integer(places)
            step = self._integer(places) if self.takes(":") else None
            if step == 0:
                raise RouteError(self._text, places[-1][0], "expected a step other than 0")
            index = slice(first, stop, step)
            self._take("]", "expected a whole number, : or ]")
            if step is not None:
                places.pop()  # only those that must be in range
        elif first is None:
            self.refuse("expected a whole number or a slice such as 0:7")
        else:
            several = False
            while self.takes(","):
                several = True
                if self.word is not None and self.word.text == "]":
                    break
                if self._integer(places) is None:
                    self.refuse("expected a whole number")
            self._take("]", "expected a whole number, , : or ]" if several else "expected : , or ]")
            index = tuple(value for _, value in places) if several else first
        return Pick(of.at, of, bracket, index, tuple(places))

    def _integer(self, places: list[tuple[int, int]]) -> int | None:
        """The whole number that comes next, if one does."""
        start = self._next
        negative = self.takes("-")
        word = self.word
        if word is None or word.kind != "number":
            self._next = start
            return None
        if not word.text.isdigit() or len(word.text) > 9:
            self.refuse("expected a whole number")
        self._next += 1
        value = -int(word.text) if negative else int(word.text)
        places.append((self._words[start].at, value))
        return value
