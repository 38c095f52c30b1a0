"""The kinds of sources that a scene can name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..errors import DeclarationError, Problem, nearest
from ..record.replay import Replay
from .live import LIVE
from .receiver import Receiver
from .source import Source

KINDS: dict[str, type[Receiver]] = {**LIVE, "replay": Replay}


def make_source(name: str, declared: Mapping[str, Any] | Source) -> Source:
    """Builds a source from a scene's table; a source object passes through.

    Raises:
        DeclarationError: no such kind, or wrong fields.
    """
    if not isinstance(declared, Mapping):
        if not hasattr(declared, "events"):
            message = f"found {declared!r}; expected a table with kind, or a source"
            raise DeclarationError([Problem("", message)])
        return declared
    fields = dict(declared)
    kind = fields.pop("kind", None)
    if "name" in fields:
        raise DeclarationError([Problem("name", "is what stands in the header; leave it out")])
    if not isinstance(kind, str) or kind not in KINDS:
        if kind is None:
            message = f"is required; expected {' or '.join(map(repr, KINDS))}"
        else:
            message = f"found {kind!r}; expected {' or '.join(map(repr, KINDS))}"
            near = nearest(kind, KINDS) if isinstance(kind, str) else None
            message += f"; did you mean '{near}'?" if near else ""
        raise DeclarationError([Problem("kind", message)])
    return KINDS[kind](**{**fields, "name": name})
