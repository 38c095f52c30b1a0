"""Tokens and names in the text of a route's origin.

`sero_mj.drive` interprets the names; a scene only needs to know which are used.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

NOT = "not"
# Names contain `-`, `.` and `/` (my-udp.values0, lwr/flange), so the operators - and / need spaces.
_TOKENS = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_./-]*)"
    r"|(?P<sign>[-+*/()\[\],:])"
    r"|(?P<other>[^ \t\r\n])"
)


class Token(NamedTuple):
    """A token of an origin's text.

    Attributes:
        kind: `number`, `name`, `sign`, or `other` for characters that are invalid in a route.
        text: its characters.
        at: index of its first character.
    """

    kind: str
    text: str
    at: int


def tokens_of(origin: str) -> Iterator[Token]:
    """Yields the tokens of an origin's text."""
    for match in _TOKENS.finditer(origin):
        yield Token(match.lastgroup or "other", match.group(), match.start())


def names_in(origin: str) -> list[str]:
    """Returns the distinct names in an origin: events, outputs, frames and units."""
    names = (word.text for word in tokens_of(origin) if word.kind == "name")
    return [name for name in dict.fromkeys(names) if name != NOT]


def origin_text(origin: Any) -> str:
    """Returns an origin as text; numbers and (nested) lists of numbers are constants.

    Raises:
        ValueError: the origin is neither text nor finite numbers.
    """
    if isinstance(origin, str):
        return origin
    plain = origin.tolist() if hasattr(origin, "tolist") else origin
    text = _number_text(plain)
    if text is None:
        hint = "; put quotes about the whole name" if isinstance(origin, dict) else ""
        if isinstance(plain, list) and any(isinstance(entry, str) for entry in plain):
            hint = '; put quotes about the whole list: "[udp.values0[0], 1]"'
        message = f'found {origin!r}; expected an event such as "udp.values0", or numbers{hint}'
        raise ValueError(message)
    return text


def _number_text(value: Any) -> str | None:
    """Returns a number or a list of numbers as text; None for anything else."""
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
