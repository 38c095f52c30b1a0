"""The columns of a table as the numbers of packets, whose names `export` writes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...base.errors import CsvError, did_you_mean
from ...base.frames import Array
from ..receive.structure import Structure
from .csv_files import column_names
from .table import Table


def has_numbers(table: Table, events: Mapping[str, tuple[int, ...]]) -> bool:
    """Whether any column is called like a number of an event: `joints[0]`."""
    return not set(table.columns).isdisjoint(column_names(events))


def events_of(table: Table, structure: Structure) -> dict[str, Array]:
    """Returns the events of packets that are in a table; raises CsvError.

    Columns are called like the numbers of the packet, as `export` writes them: `joints[0]`. A
    table without names, or with others, has all numbers of the packet, in order. Events may be left
    out as a whole.

    Returns:
        event to its values, (T, ...) in the event's shape.
    """
    names, columns = column_names(structure.events), [*table.columns]
    places = dict(zip(columns, columns, strict=True))
    if not has_numbers(table, structure.events):
        if len(columns) != len(names):
            has = f"found {len(columns)} columns beside time: {', '.join(columns[:4])}, ..."
            wanted = ", ".join(names[:3])
            reason = f"{has}; expected {len(names)} for '{structure.text}', or {wanted}, ..."
            raise CsvError(table.path, reason)
        places = dict(zip(names, columns, strict=True))
    for name in places:
        if name not in names:
            near = did_you_mean(name, names)
            reason = f"'{structure.text}' has no such number{near}"
            raise CsvError(table.path, reason, column=name)
    found: dict[str, Array] = {}
    for event, shape in structure.events.items():
        own = column_names({event: shape})
        missing = [name for name in own if name not in places]
        if 0 < len(missing) < len(own):  # the others would be invented
            few = ", ".join(missing[:4]) + (", ..." if len(missing) > 4 else "")
            has = f"has {len(own) - len(missing)} of the {len(own)} numbers of {event}"
            raise CsvError(table.path, f"{has}; no column is called {few}")
        if not missing:
            numbers = np.stack([table.column(places[name]) for name in own], axis=1)
            found[event] = numbers.reshape(-1, *shape)
    return found
