"""Tables of files whose `kind` says what they declare."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from .errors import DeclarationError, Problem, did_you_mean

T = TypeVar("T")


def by_kind(table: Any, kinds: Mapping[str, type[T]], base: type[T]) -> T:
    """Builds the declaration that a table's `kind` names; one of class `base` is one already.

    Raises:
        DeclarationError: there is no such kind, or fields are wrong.
    """
    if isinstance(table, base):
        return table
    if not isinstance(table, Mapping):
        raise DeclarationError([Problem("", f"found {table!r}; expected a table with `kind`")])
    fields = dict(table)
    kind = fields.get("kind")
    if kind is None:
        raise DeclarationError([Problem("kind", f"is required; expected {_listed(kinds)}")])
    if not isinstance(kind, str) or kind not in kinds:
        near = did_you_mean(str(kind), kinds)
        raise DeclarationError([Problem("kind", f"no kind {kind!r}{near}")])
    return kinds[kind](**fields)


def _listed(kinds: Mapping[str, Any]) -> str:
    names = [repr(kind) for kind in kinds]
    return f"{', '.join(names[:-1])} or {names[-1]}"
