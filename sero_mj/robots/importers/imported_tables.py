"""What a reader of a foreign file returns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from ...base.errors import DeclarationError

_MAX_NAMED = 8  # in one sentence


class NoJoints(DeclarationError):
    """A file has no joint that moves: a table, a tool, a ball, which are objects of a scene."""


@dataclass(frozen=True)
class ImportedTables:
    """A robot or a scene as the tables of our own file of it.

    Attributes:
        tables: as `tomllib` would read them.
        lines: lines of the foreign file by dotted key of the tables; an error in a key that is not
            there is at the line of the nearest key above it. None of a file of ours, where
            `toml_file.key_lines` finds them once something is wrong.
        warnings: what was lost or taken for something else, a sentence for each.
    """

    tables: dict[str, Any]
    lines: dict[str, int] | None = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def first_of(names: Sequence[str]) -> str:
    """Names with commas, of many the first and how many more."""
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return ", ".join(names[:_MAX_NAMED]) + more
