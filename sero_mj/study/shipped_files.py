"""Files that the workers of an `Engine` are given, below another root."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..base.errors import Problem, UsageError


def files_in(path: Path) -> list[Path]:
    """A file, or all files in a folder; raises UsageError where there is none."""
    found = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
    if not found:
        raise UsageError(Problem("--ship", "no file or folder with files", found=str(path)))
    return [each.absolute() for each in found]


def below(root: Path, value: Any) -> Any:
    """A value in which names of files that were unpacked lead to the root; others are as before."""
    if isinstance(value, str) and value.startswith("/") and (root / value[1:]).exists():
        return f"{root}{value}"
    if isinstance(value, list | tuple):
        return [below(root, each) for each in value]
    if isinstance(value, Mapping):
        return {key: below(root, each) for key, each in value.items()}
    return value
