"""Tables of files whose `kind` says what they declare."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, TypeVar

from .errors import DeclarationError, Problem, did_you_mean

T = TypeVar("T")


def by_kind(table: Any, kinds: Mapping[str, type[T]], base: type[T]) -> T:
    """Builds the declaration that a table's `kind` names; one of class `base` is one already.

    Args:
        table: as a file has it.
        kinds: name to class; each has a field `kind`.
        base: of all of these classes.

    Raises:
        DeclarationError: there is no such kind, or fields are wrong.
    """
    return table if isinstance(table, base) else kinds[kind_of(table, kinds)](**table)


def kind_of(table: Any, kinds: Collection[str]) -> str:
    """The `kind` that a table names.

    Raises:
        DeclarationError: it is no table, or there is no such kind.
    """
    if not isinstance(table, Mapping):
        raise DeclarationError([Problem("", f"found {table!r}; expected a table with `kind`")])
    kind = table.get("kind")
    if isinstance(kind, str) and kind in kinds:
        return kind
    if kind is None:
        *others, last = map(repr, kinds)
        message = f"is required; expected {', '.join(others)} or {last}"
        raise DeclarationError([Problem("kind", message)])
    raise DeclarationError([Problem("kind", f"no kind {kind!r}{did_you_mean(str(kind), kinds)}")])
