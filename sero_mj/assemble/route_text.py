"""The text of a route's origin: its words, and the names among them.

What the names mean is the business of `sero_mj.drive`; a scene only has to know which there are.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

NOT = "not"
# Names hold `-`, `.` and `/` (my-udp.values0, lwr/flange), so these two stand between spaces.
_WORDS = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_./-]*)"
    r"|(?P<sign>[-+*/()\[\],:])"
    r"|(?P<other>[^ \t\r\n])"
)


class Word(NamedTuple):
    """A piece of an origin's text.

    Attributes:
        kind: `number`, `name`, `sign`, or `other` for what has no meaning in a route.
        text: the piece.
        at: index of its first character.
    """

    kind: str
    text: str
    at: int


def words_of(origin: str) -> Iterator[Word]:
    """Yields the pieces of an origin's text."""
    for match in _WORDS.finditer(origin):
        yield Word(match.lastgroup or "other", match.group(), match.start())


def names_in(origin: str) -> list[str]:
    """Returns the names in an origin, each once: events, outputs, frames and units."""
    names = (word.text for word in words_of(origin) if word.kind == "name")
    return [name for name in dict.fromkeys(names) if name != NOT]


def origin_text(origin: Any) -> str:
    """Returns an origin as text: numbers and (nested) lists of numbers are constants.

    Raises:
        ValueError: it is neither text nor finite numbers.
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
    """A number or a list of numbers as text; None where there is anything else."""
    if isinstance(value, list | tuple):
        entries = [_number_text(entry) for entry in value]
        texts = [entry for entry in entries if entry is not None]
        return f"[{', '.join(texts)}]" if len(texts) == len(entries) else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return repr(value) if math.isfinite(value) else None
    except OverflowError:  # an int of hundreds of digits
        return None
