"""The result of importing a robot or a scene from a file of another format."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ...base.errors import DeclarationError


class NoJoints(DeclarationError):
    """The file has no movable joint. It describes an object of a scene and not a robot."""


@dataclass(frozen=True)
class ImportedTables:
    """A robot or a scene as the tables of a TOML file.

    Attributes:
        lines: mapping from dotted keys of the tables to line numbers of the original file. For a
            missing key, errors are reported at the line of the closest enclosing key. None for TOML
            files, whose lines are searched for only if there is an error.
        warnings: one sentence for each lost or reinterpreted element of the original file.
    """

    tables: dict[str, Any]
    lines: dict[str, int] | None = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
