"""Converts the origins of routes to text, and splits the text into tokens and names."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

from ...base.errors import did_you_mean, mismatch, problems_of, raise_any

NOT = "not"
JOINING = ("and", "or", NOT)  # logical operators
FUNCTIONS = ("abs", "min", "max", "norm", "any", "all")
_MAX_ORIGIN = 100_000  # maximum length of the text of an origin, characters
_FOR, _BETWEEN = " for ", ";"  # separators in origins for some joints only
_OF_JOINTS = ("from", "joints")
# Names may contain `-`, `.` and `/` (my-udp.values0, lwr/flange), so operators - and / need spaces.
_TOKENS = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_./-]*)"
    r"|(?P<sign>[<>=!]=|[-+*/()\[\],:<>])"
    r"|(?P<other>[^ \t\r\n])"
)


def route_texts(routes: Mapping[str, Any]) -> dict[str, str]:
    """Converts the origins of routes to text.

    Raises DeclarationError if an origin is not a text, a number, a list of numbers, or a table with
    the keys `from` and `joints`.
    """
    texts, problems = {}, []
    for target, origin in routes.items():
        try:
            texts[target] = origin_text(origin)
        except ValueError as error:
            problems += problems_of(error, f"routes.{target}")
    raise_any(problems)
    return texts


class Token(NamedTuple):
    """A token in the text of a route's origin.

    Attributes:
        kind: `number`, `name`, `sign`, or `other` for an invalid character.
        text: characters of the token.
        at: index of the first character.
    """

    kind: str
    text: str
    at: int


def tokens_of(origin: str) -> Iterator[Token]:
    """Yields the tokens in the text of a route's origin."""
    for match in _TOKENS.finditer(origin):
        yield Token(match.lastgroup or "other", match.group(), match.start())


def names_in(origin: str) -> list[str]:
    """Returns the names of events, outputs, frames and units in the origin of a route."""
    words = [*tokens_of(origin), Token("end", "", len(origin))]
    names = (
        word.text
        for word, behind in pairwise(words)
        if word.kind == "name" and not (behind.text == "(" and word.text in FUNCTIONS)
    )
    return [name for name in dict.fromkeys(names) if name not in JOINING]


def origin_text(origin: Any) -> str:
    """Converts the origin of a route to text, for `parts_of_origin` to split.

    Numbers and lists of numbers are constants. A table for some joints is converted to text such as
    `udp.values0 for l_elbow, l_wrist`. Several of these are separated by semicolons. Raises
    ValueError if the origin is invalid.
    """
    if isinstance(origin, Mapping):
        text = _text_for_joints(origin)
    elif isinstance(origin, list | tuple) and any(isinstance(entry, Mapping) for entry in origin):
        text = f"{_BETWEEN} ".join(_text_for_joints(entry) for entry in origin)
    else:
        text = _plain_text(origin)
    if len(text) > _MAX_ORIGIN:
        raise mismatch(len(text), f"at most {_MAX_ORIGIN}", of="characters")
    return text


def _plain_text(origin: Any) -> str:
    if isinstance(origin, str):
        return origin
    plain = origin.tolist() if hasattr(origin, "tolist") else origin
    text = _number_text(plain)
    if text is None:
        hint = ""
        if isinstance(plain, list) and any(isinstance(entry, str) for entry in plain):
            hint = '; put quotes around the whole list: "[udp.values0[0], 1]"'
        raise mismatch(origin, f'an event such as "udp.values0", or numbers{hint}')
    return text


def _text_for_joints(table: Any) -> str:
    example = '{ from = "udp.values0", joints = ["A1", "A2"] }'
    if not isinstance(table, Mapping) or not table.keys() & {*_OF_JOINTS}:
        if not isinstance(table, Mapping):
            raise mismatch(table, example, of="in a list of tables")
        raise mismatch(
            table, 'an event such as "udp.values0", or numbers; put quotes around the whole name'
        )
    if table.keys() != {*_OF_JOINTS}:
        unknown = [f"unknown '{key}'{did_you_mean(key, _OF_JOINTS)}" for key in table
                   if key not in _OF_JOINTS]  # fmt: skip
        missing = [f"no '{key}'" for key in _OF_JOINTS if key not in table]
        raise ValueError(f"found {', '.join([*unknown, *missing])}; expected {example}")
    joints = [table["joints"]] if isinstance(table["joints"], str) else table["joints"]
    names = isinstance(joints, list | tuple) and all(isinstance(each, str) for each in joints)
    if not names or not joints:
        raise mismatch(joints, "names of joints or limbs, in order", key="joints")
    return f"{_plain_text(table['from'])}{_FOR}{', '.join(joints)}"


def parts_of_origin(text: str) -> list[tuple[str, list[str] | None]]:
    """Splits the text of an origin into pairs of origins and joint names, None for all joints."""
    if _FOR not in text:
        return [(text, None)]
    pairs = [part.partition(_FOR) for part in text.split(_BETWEEN)]
    return [
        (origin.strip(), [name.strip() for name in names.split(",")] if is_for else None)
        for origin, is_for, names in pairs
    ]


def _number_text(value: Any) -> str | None:
    if isinstance(value, list | tuple):
        entries = [_number_text(entry) for entry in value]
        texts = [entry for entry in entries if entry is not None]
        return f"[{', '.join(texts)}]" if len(texts) == len(entries) else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return repr(value) if math.isfinite(value) else None
    except OverflowError:  # an int too large for a float
        return None
