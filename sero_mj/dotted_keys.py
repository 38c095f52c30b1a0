"""Dotted keys, `dynamics.coulomb_friction[1]`, by which options set values over those of files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from .errors import did_you_mean

_PART = re.compile(r"([^.\[\]]+)((?:\[\d+\])*)")


def parts_of(key: str) -> list[str | int]:
    """Returns names and indices of a dotted key, outermost first.

    Raises:
        ValueError: it is none.
    """
    parts: list[str | int] = []
    for text in key.split("."):
        found = _PART.fullmatch(text)
        if found is None:
            raise ValueError("expected names with dots, and indices such as [0]")
        parts += [found[1], *map(int, re.findall(r"\d+", found[2]))]
    return parts


def with_value(
    table: Mapping[str, Any],
    parts: list[str | int],
    value: Any,
    *,
    built: Any = None,
    below: Any = None,
    n: int = 0,
) -> dict[str, Any]:
    """Returns a table in which a dotted key has a value; nothing that was handed in is changed.

    Args:
        table: with other tables and lists in it.
        parts: of the key, a name first; tables on the way are made where there are none.
        value: a number becomes one for each element where a list of numbers stands.
        built: what was made of the table; lists that the table does not have are its arrays.
        below: another table, over which this one is laid; lists and frames that this one does not
            have are as they stand there.
        n: number of elements that one number in the table stands for; 0 where it is only that.

    Raises:
        ValueError: a part is in no table or list.
    """
    changed = dict(table)
    name, *rest = parts
    own = built.get(name) if isinstance(built, Mapping) else getattr(built, str(name), None)
    under = below.get(name) if isinstance(below, Mapping) else None
    # A frame is replaced as a whole; of other tables what is set here is laid over the rest.
    found: Any = table.get(str(name))
    if found is None and (isinstance(under, list) or hasattr(own, "tolist")):
        found = own if under is None else under
    if rest and isinstance(rest[0], str):
        inner = {} if found is None else found
        if not isinstance(inner, Mapping):
            raise ValueError(f"'{name}' is no table")
        changed[str(name)] = with_value(inner, rest, value, built=own, below=under, n=n)
        return changed
    current = found.tolist() if hasattr(found, "tolist") else found
    if rest and current is None and own is None:
        known = {*table, *getattr(type(built), "model_fields", {})}
        if name not in known:
            raise ValueError(f"no list '{name}'{did_you_mean(str(name), known)}")
        raise ValueError(f"'{name}' has no elements yet; set it as a whole")
    if rest:
        if _is_number(current) and n:
            current = [current] * n
        changed[str(name)] = _with_element(current, rest, value, str(name))
    elif _is_number(value) and isinstance(current, list) and all(map(_is_number, current)):
        changed[str(name)] = [value] * len(current)
    else:
        changed[str(name)] = value
    return changed


def check_tables(table: Any, parts: list[str | int]) -> None:
    """Checks that all tables on the way to a key are there.

    Raises:
        ValueError: one is not, with the nearest name.
    """
    names = [part for part in parts if isinstance(part, str)]
    for k, name in enumerate(names[:-1]):
        if not isinstance(table, Mapping) or name not in table:
            near = did_you_mean(name, table) if isinstance(table, Mapping) and table else ""
            raise ValueError(f"there is no [{'.'.join(names[: k + 1])}]{near}")
        table = table[name]


def _with_element(values: Any, indices: list[str | int], value: Any, name: str) -> Any:
    """Returns lists with one element replaced."""
    if not indices:
        return value
    index, *rest = indices
    if not isinstance(values, list):
        raise ValueError(f"'{name}' is no list; set it as a whole")
    if not isinstance(index, int):
        raise ValueError(f"'{name}' is a list; expected an index, as in {name}[0]")
    if index >= len(values):
        raise ValueError(f"no element [{index}] of '{name}'; it has {len(values)}, from [0] on")
    changed = list(values)
    changed[index] = _with_element(values[index], rest, value, f"{name}[{index}]")
    return changed


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
