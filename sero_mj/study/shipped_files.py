"""Files that an `Engine` copies to its workers, below another root folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..base.errors import Problem, UsageError


def files_in(path: Path) -> list[Path]:
    """Returns a file, or all files in a folder; raises UsageError if there is none."""
    found = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
    if not found:
        raise UsageError(Problem("--ship", "no file or folder with files", found=str(path)))
    return [each.absolute() for each in found]


def below(root: Path, value: Any) -> Any:
    """Returns a value with the names of all files that exist below the root redirected there."""
    if isinstance(value, str) and value.startswith("/") and (root / value[1:]).exists():
        return f"{root}{value}"
    if isinstance(value, list | tuple):
        return [below(root, each) for each in value]
    if isinstance(value, Mapping):
        return {key: below(root, each) for key, each in value.items()}
    return value
