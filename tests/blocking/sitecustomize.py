"""Blocks all extensions in every process that has this folder in `PYTHONPATH`, see `make core`."""

from __future__ import annotations

import importlib.metadata
import sys
from collections.abc import Sequence
from typing import Any

_BLOCKED = "sero_mj.extensions"
_entry_points = importlib.metadata.entry_points


class _Blocker:
    def find_spec(self, name: str, path: Sequence[str] | None, target: Any = None) -> None:
        if name == _BLOCKED or name.startswith(f"{_BLOCKED}."):
            raise ModuleNotFoundError(f"{name} is blocked", name=name)


class _Points:
    def select(self, **wanted: Any) -> list[importlib.metadata.EntryPoint]:
        return [each for each in _entry_points(**wanted) if not each.value.startswith(_BLOCKED)]


def _without_extensions(**wanted: Any) -> Any:
    return _Points().select(**wanted) if wanted else _Points()


sys.meta_path.insert(0, _Blocker())  # type: ignore[arg-type]
importlib.metadata.entry_points = _without_extensions
