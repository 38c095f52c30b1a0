"""Lets extensions act as soon as another package is imported, which sero_mj itself does not import.

They name the package and a function without arguments in the group `sero_mj.when_imported`.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType


def when_imported(package: str) -> None:
    """Calls what extensions name for a package: now, or when the package is imported."""
    if package in sys.modules:
        _act(package)
    elif not any(isinstance(each, _Finder) and each.package == package for each in sys.meta_path):
        sys.meta_path.insert(0, _Finder(package))


def _act(package: str) -> None:
    from .plugins import WHEN_IMPORTED, plugins

    point = plugins(WHEN_IMPORTED).get(package)
    if point is not None:
        point.load()()


class _Finder:  # importlib.abc.MetaPathFinder takes 10 ms to import
    """Finds nothing itself; acts once others have found and imported the package."""

    def __init__(self, package: str) -> None:
        self.package = package

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self.package:
            return None
        from importlib.util import find_spec

        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def execute_and_act(module: ModuleType) -> None:
            execute(module)
            _act(fullname)

        spec.loader.exec_module = execute_and_act  # type: ignore[method-assign]
        return spec
