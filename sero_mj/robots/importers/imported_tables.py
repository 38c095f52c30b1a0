"""`ImportedTables`: the result of importing a robot or a scene from another file format."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ...base.errors import DeclarationError


class NoJoints(DeclarationError):
    """Raised if a file has no movable joint, so that it describes an object instead of a robot."""


@dataclass(frozen=True)
class ImportedTables:
    """The tables of a TOML file that describe an imported robot or scene.

    Attributes:
        lines: line numbers in the original file by dotted key of the tables. If a key is missing,
            the line of the closest enclosing key is reported. None for a TOML file, in which lines
            are searched for only if there is an error.
        warnings: one sentence for each lost or reinterpreted element of the original file.
    """

    tables: dict[str, Any]
    lines: dict[str, int] | None = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
