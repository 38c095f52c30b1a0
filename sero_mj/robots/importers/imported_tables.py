"""The result of reading a file in another format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ...base.errors import DeclarationError

_MAX_NAMED = 8  # in one sentence


class NoJoints(DeclarationError):
    """A file has no movable joint: a table, a tool or a ball, which are objects of a scene."""


@dataclass(frozen=True)
class ImportedTables:
    """A robot or a scene as the tables of a file in our format.

    Attributes:
        tables: as `tomllib` would read them.
        lines: lines of the original file by dotted key of the tables; an error in a missing key is
            reported at the line of the nearest key above it. None for our own files, whose lines
            `toml_file.key_lines` finds when there is an error.
        warnings: what was lost or reinterpreted, a sentence for each.
    """

    tables: dict[str, Any]
    lines: dict[str, int] | None = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def first_of(names: Sequence[str], most: int = _MAX_NAMED) -> str:
    """Names separated by commas; of many only the first, and the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
