"""Dotted keys such as `dynamics.coulomb_friction[1]`, which select values of files to override."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import Any

from .errors import Problem, did_you_mean, nearest

_PART = re.compile(r"([^.\[\]]+)((?:\[\d+\])*)")


def parts_of(key: str) -> list[str | int]:
    """Splits a dotted key into its names and indices, outermost first.

    Raises ValueError if the text is not a dotted key.
    """
    parts: list[str | int] = []
    for text in key.split("."):
        found = _PART.fullmatch(text)
        if found is None:
            raise ValueError("expected names separated by dots, with indices such as [0]")
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
    lists: Mapping[str, int] = MappingProxyType({}),
) -> dict[str, Any]:
    """Returns a copy of a table in which the value of a dotted key is replaced.

    Args:
        table: table to copy, possibly with nested tables and lists.
        parts: parts of the key, beginning with a name. Missing tables are created.
        value: new value. A number replaces every element of a list of numbers.
        built: object that was built from the table. A list that the table lacks is copied from it.
        below: table that this table overrides. Missing lists and frames are first looked up in it.
        n: number of elements that a single number in the table stands for; 0 for a scalar.

    Raises:
        ValueError: a part does not exist.
    """
    changed = dict(table)
    name, *rest = parts
    own = built.get(name) if isinstance(built, Mapping) else getattr(built, str(name), None)
    under = below.get(name) if isinstance(below, Mapping) else None
    # A frame is replaced as a whole; other tables are merged.
    found: Any = table.get(str(name))
    if found is None and (isinstance(under, list) or hasattr(own, "tolist")):
        found = own if under is None else under
    if rest and isinstance(rest[0], str):
        inner = {} if found is None else found
        if not isinstance(inner, Mapping):
            raise ValueError(f"'{name}' is not a table")
        changed[str(name)] = with_value(
            inner, rest, value, built=own, below=under, n=n, lists=lists
        )
        return changed
    if found is None and rest and _is_number(own):
        found = own
    current = found.tolist() if hasattr(found, "tolist") else found
    if rest and current is None and own is None:
        known = {*table, *getattr(type(built), "model_fields", {})}
        if name not in known:
            raise ValueError(f"unknown key{did_you_mean(str(name), known)}")
        raise ValueError(f"'{name}' has no elements yet; set it as a whole")
    if rest:
        if _is_number(current) and n:
            current = [current] * n
        changed[str(name)] = _with_element(current, rest, value, str(name))
    elif _is_number(value) and isinstance(current, list) and all(map(_is_number, current)):
        changed[str(name)] = [value] * len(current)
    elif _is_number(value) and current is None and name in lists:
        changed[str(name)] = [value] * lists[str(name)]
    else:
        changed[str(name)] = value
    return changed


def lacking(
    section: str, name: str, problems: Iterable[Problem], keys: Collection[str], others: list[str]
) -> str | None:
    """Returns an error for a new table that dotted keys create without all required keys, or None.

    For example, `controllers.lrw.stiffness=200` with a misspelled name creates such a table.
    `problems` are the errors of the new table, `keys` are the dotted keys that created it, and
    `others` are the names of the tables in the file.
    """
    for problem in problems:
        place = f"{section}.{name}.{problem.key}."
        if not any(f"{key}.".startswith(place) for key in keys):
            if nearest(name, others):
                return no_table(section, name, others)
            return f"there is no [{section}.{name}], and in a new one, {problem}"
    return None


def no_table(section: str, name: str, others: Iterable[str]) -> str:
    """Returns the message for a missing table, with the most similar name."""
    return f"there is no [{section}.{name}]{did_you_mean(name, others)}"


def _with_element(values: Any, indices: list[str | int], value: Any, name: str) -> Any:
    if not indices:
        return value
    index, *rest = indices
    if not isinstance(values, list):
        raise ValueError(f"'{name}' is not a list; set it as a whole")
    if not isinstance(index, int):
        raise ValueError(f"'{name}' is a list; expected an index, as in {name}[0]")
    if index >= len(values):
        count = len(values)
        raise ValueError(f"'{name}' has no element [{index}]; it has {count}, counted from [0]")
    changed = list(values)
    changed[index] = _with_element(values[index], rest, value, f"{name}[{index}]")
    return changed


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
