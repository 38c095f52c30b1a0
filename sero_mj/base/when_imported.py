"""Calls functions of extensions when a third-party package is imported.

An entry point in the group `sero_mj.when_imported` has the name of the package, and refers to a
function without arguments.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType


def when_imported(package: str) -> None:
    """Calls the function for a package now, or as soon as the package is imported."""
    if package in sys.modules:
        _call(package)
    elif not any(isinstance(each, _Finder) and each.package == package for each in sys.meta_path):
        sys.meta_path.insert(0, _Finder(package))


def _call(package: str) -> None:
    from .plugins import WHEN_IMPORTED, plugins

    point = plugins(WHEN_IMPORTED).get(package)
    if point is not None:
        point.load()()


class _Finder:  # importing importlib.abc.MetaPathFinder would take 10 ms
    """Wraps the loader of a package that another finder has found, and finds no modules itself."""

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

        def execute_and_call(module: ModuleType) -> None:
            execute(module)
            _call(fullname)

        spec.loader.exec_module = execute_and_call  # type: ignore[method-assign]
        return spec
